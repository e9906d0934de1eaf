"""Notices pictures that come late: what piles up on its way is old when it is decoded, whatever the clock says then."""

from __future__ import annotations

_WINDOW_S = 30.0


class StreamLag:
    """Compares when pictures come with when the camera says that it took them.

    The two clocks have nothing in common, so the least delay lately counts as none. Clocks that drift apart are
    forgiven by forgetting it after half a minute to a minute.
    """

    def __init__(self) -> None:
        self._least: list[float] = []  # of this window and of the one before, seconds between the clocks
        self._began_s = 0.0

    def note(self, media_s: float, now_s: float) -> float:
        """Return by how many seconds a picture is late.

        Args:
            media_s: When it was taken, the stream's clock.
            now_s: When it came, monotonic clock.
        """
        offset_s = now_s - media_s
        if not self._least or now_s - self._began_s > _WINDOW_S:
            self._least, self._began_s = [offset_s, *self._least[:1]], now_s
        self._least[0] = min(self._least[0], offset_s)
        return offset_s - min(self._least)
