"""What every physics does, and what it answers with: the state of the tissue and of the jaws after a move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from retract_env.objectives import Verdict, verdict

if TYPE_CHECKING:
    from retract_env.mesh import SectionMesh
    from retract_env.scene import Limits

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TissueState:
    """The flap in equilibrium with one pose of the jaws.

    All arrays belong to the drawn section, the plane of symmetry z = 0, unless said otherwise.
    """

    points: Array
    """(n, 2) m, where the section's nodes are now."""
    strain: Array
    """(m,) mean strain of each section triangle, over the depth too."""
    jaws: Array
    """(4,) m, (x1, y1, x2, y2): lower and upper jaw."""
    reactions: Array
    """(2, 2) N, force of the tissue on the lower and on the upper jaw, over the whole depth."""
    normals: Array
    """(2, 2) unit vectors, from each jaw into the tissue."""
    worst_strain: float
    """eps_1%, the mean strain of the 1 % of volume that is strained most. Sec. III-C."""
    worst_at: Array
    """(2,) m, rest position of the most strained spot."""
    required_friction: Array
    """(2,) least Coulomb coefficient that holds each jaw; inf where the jaw would pull."""
    clearance: float
    """m, signed distance of the lowest tissue node to AB; negative while tissue lies below it."""
    progress: float
    """How far along the path, in waypoints; 0 at rest, 1 squeezed."""
    crease: float = 0.0
    """m^2, of the section, that tissue covers twice: nothing keeps it from passing through itself."""
    overlap: bool = False
    """Whether that is more than a jaw's sharp edge explains, or tissue lies inside the block that holds the
    fixed end."""

    @property
    def asked_friction(self) -> float:
        """What the jaw needs that needs more; 0 while they close: security is asked of closed jaws."""
        return float(self.required_friction.max()) if self.progress >= 1 else 0.0

    def verdict(self, limits: Limits) -> Verdict | None:
        """What has become of a retraction in this state; see `objectives.verdict`."""
        return verdict(
            self.worst_strain,
            self.asked_friction,
            self.clearance,
            limits.strain,
            limits.friction,
            limits.clearance,
            self.overlap,
        )


class Physics(Protocol):
    """One flap and the two jaws that hold it; `registry.PhysicsKind.source` says how it is made.

    After `reset` the same moves lead to the same states, to the last bit: copies of an episode rely on it.

    One that is made with a force has jaws that hold by it: each move ends with the separation at which the
    mean of both jaws' normal reactions is that force, whatever separation its pose has.
    """

    @property
    def section(self) -> SectionMesh:
        """The mesh that the states refer to."""

    def reset(self) -> TissueState:
        """Let the flap rest on its bed between open jaws. Raises Diverged."""

    def move_to(self, pose: Array, progress: float | None = None) -> TissueState:
        """Move the jaws straight to a pose (4,) x, y, theta, separation.

        progress: where this is on a path, in waypoints; None off any path. Jaws that hold by a force press
        with that part of it while they close, where it is below 1. Raises Diverged; the state is then still
        the last good one.
        """

    def state(self) -> TissueState:
        """The last good state."""

    def close(self) -> None:
        """Give back what it holds; may be called again."""


@runtime_checkable
class Restorable(Protocol):
    """What a physics may do besides: tell where it stands, and go back there.

    Episodes use the pair where a physics has it, for copies and for `TissueRetractEnv.set_state`; with any
    other they make the episode's moves again.
    """

    def get_state(self) -> object:
        """Where the flap stands and all that its next moves depend on, down to their last bit.

        It can be pickled and does not change when the flap goes on; getting it leaves no trace in how the
        flap goes on. Also after `close`.
        """

    def set_state(self, state: object) -> None:
        """Stand where a physics stood that was made with the same arguments, be it in another process.

        The same moves then lead to the same states as there, to the last bit. A state may be set any number
        of times, whatever was done before, also before the first `reset`. Raises TypeError for what is no
        state of such a physics, ValueError for that of another flap.
        """
