"""What every part of the settings has in common."""

from __future__ import annotations

from collections.abc import Callable

import pydantic

from revnm_client.errors import RevnmError


class Section(pydantic.BaseModel):
    """A part of the settings; unknown keys are errors."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def reraised(check: Callable[[str], object], value: str) -> None:
    """Run one of our checks inside pydantic, which understands ValueError only.

    Raises:
        ValueError: The check refused the value.
    """
    try:
        check(value)
    except RevnmError as error:
        raise ValueError(str(error)) from None
