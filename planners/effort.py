"""How much work a planner spends on one retraction before it gives up, counted so that it repeats exactly."""

from __future__ import annotations

from collections.abc import Callable

from planners.certify import Retraction

MOST_ITERATIONS = 2_000
"""Newton iterations for one retraction, or for one optimisation on its poses. Retractions of random flaps
took up to 900, with light grips and far wider ranges than `sample_scene`'s, and optimisations up to 520."""


class TooCostly(Exception):
    """A retraction took more than MOST_ITERATIONS."""


def within_budget(retraction: Retraction, on_increment: Callable[[], None]) -> Callable[[], None]:
    """on_increment of a retraction that also raises TooCostly once it has taken too many iterations."""

    def watched() -> None:
        on_increment()
        check(iterations(retraction))

    return watched


def iterations(retraction: Retraction) -> int:
    """Newton iterations since the flap was laid on its bed."""
    return 0 if retraction.physics is None else retraction.physics.equilibrium.counts["iterations"]


def check(spent: int) -> None:
    """Raises TooCostly for more than MOST_ITERATIONS."""
    if spent > MOST_ITERATIONS:
        raise TooCostly(f"{spent} iterations, allowed {MOST_ITERATIONS}")


def retract(retraction: Retraction, on_increment: Callable[[], None]) -> None:
    """Squeeze and move a planner's own retraction to its end. Raises TooCostly, MeshError."""
    watched = within_budget(retraction, on_increment)
    retraction.squeeze(watched)
    if not retraction.ended:
        retraction.move(on_increment=watched)
