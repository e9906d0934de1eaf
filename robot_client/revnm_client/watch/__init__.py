"""The live view of a drive in a terminal: what the robot hears and says, without touching its control loop."""

from revnm_client.watch.keeper import ViewKeeper
from revnm_client.watch.picture import Size, View, draw
from revnm_client.watch.screen import Screen

__all__ = ["Screen", "Size", "View", "ViewKeeper", "draw"]
