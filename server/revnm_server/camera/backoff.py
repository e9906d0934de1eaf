"""How long to wait before a camera is tried again.

A stream must be back within 5 s of its camera: the pause, a time-out that has just begun (2 s) and the handshake
together stay below that. Pauses differ, so that cameras that went down together are not tried together.
"""

from __future__ import annotations

import numpy as np

FIRST_S = 0.5
LONGEST_S = 1.5
LOGIN_S = 30.0
"""Cameras lock out who tries a wrong password often."""


class Backoff:
    """The pauses of one camera, each between half of a length and all of it; the length doubles with every failure.

    Args:
        rng: Draws them.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._length_s = FIRST_S

    def pause_s(self, *, worked: bool, refused: bool = False) -> float:
        """Return the next pause.

        Args:
            worked: Pictures came before it failed.
            refused: It refused the login.
        """
        length_s = FIRST_S if worked else self._length_s
        self._length_s = min(2.0 * length_s, LONGEST_S)
        return float(self._rng.uniform(0.5, 1.0)) * (LOGIN_S if refused else length_s)
