"""Loops that numba compiles: how, and the types of their arrays.

They are compiled for one signature when their module is imported, or read from numba's cache, so that no tick waits for
the compiler. They release the GIL, and look at no bounds. Numbers follow IEEE in the order in which they are written,
so that float32 stays what numpy would make of it.

numba compiles anew what its own file changes: a loop uses no loop and no constant of another file, and after a change
here, the cached ones must be deleted. Imports numba only.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable
from typing import Any, TypeVar

from numba import boolean, float32, float64, int64, njit, types

logger = logging.getLogger(__name__)

_Function = TypeVar("_Function", bound=Callable[..., Any])

IMAGE: Any = float32[:, ::1]
"""(h, w), as all of these without gaps, row after row."""
MASK: Any = boolean[:, ::1]
"""(h, w)."""
FLOATS: Any = float64[:, ::1]
"""(h, w)."""
NUMBERS: Any = int64[:, ::1]
"""(h, w)."""
LINE: Any = float32[::1]
"""(N,)."""


def compiled(result: Any, *arguments: Any) -> Callable[[_Function], _Function]:
    """Compile a function for the numba types of its result, None if it has none, and of its arguments."""
    signature = (types.void if result is None else result)(*arguments)

    def compile_(function: _Function) -> _Function:
        try:
            return njit(signature, nogil=True, error_model="numpy", cache=True)(function)  # type: ignore[no-any-return]
        except RuntimeError:  # numba finds no folder for its cache
            _tell_of_no_cache()
            return njit(signature, nogil=True, error_model="numpy")(function)  # type: ignore[no-any-return]

    return compile_


@functools.cache
def _tell_of_no_cache() -> None:
    logger.warning(
        "compiling at every start, which takes seconds: no folder for the result can be written to; "
        "NUMBA_CACHE_DIR can name one"
    )


def tuple_of(*members: Any) -> Any:
    """Return the type of a tuple."""
    return types.Tuple(members)  # type: ignore[no-untyped-call]


def named_tuple_of(kind: type, *members: Any) -> Any:
    """Return the type of a named tuple."""
    if len(set(members)) == 1:
        return types.NamedUniTuple(members[0], len(members), kind)  # type: ignore[no-untyped-call]
    return types.NamedTuple(members, kind)  # type: ignore[no-untyped-call]
