"""Loops that numba compiles: how, and the names of their arrays' types.

They are compiled for one signature when their module is imported, or read from numba's cache, so that no tick waits for
the compiler. They release the GIL. Numbers follow IEEE in the order in which they are written, so that float32 stays
what numpy would make of it. Imports numba only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import boolean, float32, float64, int64, njit, types

_Function = TypeVar("_Function", bound=Callable[..., Any])

IMAGE: Any = float32[:, ::1]
LINE: Any = float32[::1]
MASK: Any = boolean[:, ::1]
FLOATS: Any = float64[:, ::1]
NUMBERS: Any = int64[:, ::1]


def compiled(result: Any, *arguments: Any) -> Callable[[_Function], _Function]:
    """Compile a function for numba types; None as its result is none."""
    signature = (types.void if result is None else result)(*arguments)
    return njit(signature, cache=True, nogil=True, error_model="numpy")  # type: ignore[no-any-return, unused-ignore]


def several(*members: Any) -> Any:
    """Return the type of a tuple."""
    return types.Tuple(members)  # type: ignore[no-untyped-call]


def named(kind: type, *members: Any) -> Any:
    """Return the type of a named tuple."""
    return types.NamedTuple(members, kind)  # type: ignore[no-untyped-call]
