"""Values that recipes are made of: whole numbers, shares, rates. Errors are a `RecipeError` of one line."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator

from retract_env.config import Frozen, Range, brief, refusal
from retract_env.errors import ConfigError


class RecipeError(ConfigError):
    """A recipe that cannot be used; the message is one line."""


class Part(Frozen):
    """A part of a recipe. Constructors and `from_data` raise `RecipeError`."""

    error_type: ClassVar[type[ConfigError]] = RecipeError


def whole(low: int, high: int) -> BeforeValidator:
    """Marks an int field that takes a whole number in [low, high]; 1e6 is one."""

    def check(value: Any) -> int:
        number = Range(low, high).check(value)
        if number != int(number):
            raise refusal(f" = {brief(value)}, not a whole number")
        return int(number)

    return BeforeValidator(check)


Count = Annotated[int, whole(1, 10**9)]
Steps = Annotated[int, whole(0, 10**9)]
Rate = Annotated[float, Range(0.0, 1.0, "", "(]")]
Share = Annotated[float, Range(0.0, 1.0)]
Weight = Annotated[float, Range(0.0, 1e3)]
