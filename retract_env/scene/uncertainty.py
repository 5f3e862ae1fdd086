"""What is not known of a retraction: a prior over the flap, the grip and the line of sight.

Each unknown is uniform within its range and independent of the others. docs/robustness.md says where the
default ranges come from.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, model_validator

from retract_env.config import Frozen, Range, brief, refusal
from retract_env.errors import ConfigError, SceneError

UNKNOWNS = (
    "modulus", "vein_modulus", "poisson", "weight", "thickness", "friction", "grasp", "closing", "force",
    "jaw_width", "target",
)  # fmt: skip
"""Names of what may be unknown, in the order in which draws have them."""

Share = Annotated[float, Range(0.0, 0.9)]


def _ends(value: Any) -> Any:
    """None, or [least, greatest]."""
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise refusal(f" = {brief(value)}, allowed [least, greatest] or null")
    low, high = (Range(0.0, 0.49).check(end) for end in value)
    if low > high:
        raise refusal(f" = {brief(value)}, allowed [least, greatest], ascending")
    return low, high


class Uncertainty(Frozen):
    """By how much each quantity may differ from what the scene, or the plan, says: half of its range.

    A scene may also say `uncertainty: none`, which is `Uncertainty.none()`.
    """

    error_type: ClassVar[type[ConfigError]] = SceneError

    modulus: Share = 0.3
    """Young's modulus of tissue and veins alike, part of it."""
    vein_modulus: Share = 0.2
    """Of all veins against the tissue, part of it."""
    poisson: Annotated[tuple[float, float] | None, BeforeValidator(_ends)] = (0.40, 0.49)
    """Least and greatest, of tissue and veins; null: known to be the scene's."""
    weight: Share = 0.1
    """Density, part of it."""
    thickness: Share = 0.05
    """Height of the flap, part of it; veins are stretched with it."""
    friction: Share = 0.1
    """Of jaw on tissue, part of the limit."""
    grasp: Annotated[float, Range(0.0, 0.05, "m")] = 5e-4
    """m, along the flap: the whole jaw path is shifted by it."""
    closing: Annotated[float, Range(0.0, 0.02, "m")] = 1e-4
    """m, of the jaws' separation, where they are closed by position."""
    force: Share = 0.1
    """Of the grip, part of it, where the jaws are closed by force."""
    force_floor: Annotated[float, Range(0.0, 1.0, "N")] = 1e-3
    """N, least half range of the force: what a sensor resolves."""
    jaw_width: Share = 0.0
    """Part of it; a machined part is known."""
    target: Annotated[float, Range(0.0, 0.05, "m")] = 5e-4
    """m, of B along the bed."""

    @model_validator(mode="before")
    @classmethod
    def _known_in_a_word(cls, data: Any) -> Any:
        if not isinstance(data, str):
            return data
        if data != "none":
            raise refusal(f" = {brief(data)}, allowed none or a mapping of {', '.join(cls.model_fields)}")
        return cls._nothing()

    @classmethod
    def _nothing(cls) -> dict[str, Any]:
        return {**dict.fromkeys((*UNKNOWNS, "force_floor"), 0.0), "poisson": None}

    @classmethod
    def none(cls) -> Uncertainty:
        """All is as the scene and the plan say."""
        return cls(**cls._nothing())
