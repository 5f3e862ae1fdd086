"""Values that recipes are made of: whole numbers, shares, rates. Errors are a `RecipeError` of one line."""

from __future__ import annotations

from typing import Annotated, ClassVar

from retract_env.config import Frozen, Range, whole
from retract_env.errors import ConfigError


class RecipeError(ConfigError):
    """A recipe that cannot be used; the message is one line."""


class Part(Frozen):
    """A part of a recipe. Constructors and `from_data` raise `RecipeError`."""

    error_type: ClassVar[type[ConfigError]] = RecipeError


Count = Annotated[int, whole(1, 10**9)]
Steps = Annotated[int, whole(0, 10**9)]
Rate = Annotated[float, Range(0.0, 1.0, "", "(]")]
Share = Annotated[float, Range(0.0, 1.0)]
Weight = Annotated[float, Range(0.0, 1e3)]
