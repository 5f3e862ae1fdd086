"""A motion of flaps as rods, for whatever code solves it, and this project's code.

A flap of plain tissue lies on its bed, its right end clamped; jaws that clamp its left end roll it up, pose
after pose. Lengths are in flap heights h, forces in E h d, as in `retract_env.rod`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from retract_env.rod import chain, equilibrium
from retract_env.rod.chain import LANES

Array = NDArray[np.float64]

STRETCH, BEND, SHEAR = 1.0, 1 / 12, 5 / 6 / (2 * (1 + 0.45))
"""stiffness of a section of plain tissue, Poisson's ratio 0.45"""
LENGTH = 0.025 / 0.0044
"""between the clamps: the paper's flap, held half-way"""
WEIGHT = 1000 * 9.8 * 0.0044 / 40e3
"""per length, of the paper's flap"""
BED = 0.3
"""stiffness per length"""
UNSHEARABLE = 10.0
"""stiffness against shear, against which a flap shears by 1/35 of what tissue does"""
POSES = 12
STRAIGHT = np.array([-LENGTH, 0.5, 0.0])
"""x, y and angle of the left clamp at rest; the right one is at (0, 1/2)"""


@dataclass(frozen=True)
class Motion:
    """What the codes are to compute."""

    elements: int
    """between the clamps"""
    clamps: Array
    """(poses, flaps, 3) x, y, angle of the left clamp"""

    @property
    def flaps(self) -> int:
        found: int = self.clamps.shape[1]
        return found


def rolled(elements: int, flaps: int) -> Motion:
    """Jaws on the arcs that bending alone would lead them along, but turned less and a little squeezed.

    Each flap is rolled up less far than the next, the last one by 2 rad.
    """
    turn = np.outer(np.linspace(0, 1, POSES + 1)[1:], np.linspace(1, 2, flaps) if flaps > 1 else [2.0])
    arc = 0.98 * LENGTH / turn
    clamps = np.stack([-arc * np.sin(turn), 0.5 + arc * (1 - np.cos(turn)), -0.8 * turn], axis=-1)
    return Motion(elements, clamps)


def eased(share: Array) -> Array:
    """How much of the jaws' motion the guess gives to a place, by its share of the way from the fixed end."""
    share = np.clip(share, 0, 1)
    return share**2 * (3 - 2 * share)


@dataclass(frozen=True)
class Shapes:
    """A pose's equilibria by a code with staggered unknowns: nodes, and a cross-section between each two.

    Its clamps hold the first and the last cross-section, so that an element more is needed, half of it beyond
    either clamp.
    """

    nodes: Array
    """(flaps, elements + 2, 2)"""
    angles: Array
    """(flaps, elements + 1)"""

    @property
    def sections(self) -> Array:
        """(flaps, elements + 1, 2) places of the cross-sections"""
        return (self.nodes[:, 1:] + self.nodes[:, :-1]) / 2

    @staticmethod
    def straight(motion: Motion) -> Shapes:
        place = (np.arange(motion.elements + 2) - 0.5) / motion.elements - 1
        nodes = np.stack([LENGTH * place, np.full_like(place, 0.5)], axis=-1)
        return Shapes(np.tile(nodes, (motion.flaps, 1, 1)), np.zeros((motion.flaps, motion.elements + 1)))

    def guess(self, motion: Motion, before: Array, after: Array) -> Shapes:
        """Its clamps moved from one pose (flaps, 3) to another, and what is between them smoothly along."""
        share = 1 - (np.arange(motion.elements + 2) - 0.5) / motion.elements
        nodes = self.nodes + eased(share)[None, :, None] * (after - before)[:, None, :2]
        angles = self.angles + eased((share[1:] + share[:-1]) / 2) * (after - before)[:, 2:]
        half = LENGTH / motion.elements / 2
        along = half * np.stack([np.cos(after[:, 2]), np.sin(after[:, 2])], axis=-1)
        nodes[:, 0], nodes[:, 1] = after[:, :2] - along, after[:, :2] + along
        nodes[:, -2:] = [[-half, 0.5], [half, 0.5]]
        angles[:, -1] = 0
        return Shapes(nodes, angles)


class Relaxing(Protocol):
    """A code that goes towards equilibrium in steps."""

    def place(self, shapes: Shapes) -> None:
        """Start at rest from there; clamps stay where they are in it."""

    def advance(self) -> None:
        """Some steps."""

    def shapes(self) -> Shapes:
        """Where it is."""


def settled(code: Relaxing, motion: Motion, most: int, still: float) -> list[Shapes]:
    """Each pose's equilibria: when an advance moves no node by more than `still`, or after `most` of them."""
    found, shapes, before = [], Shapes.straight(motion), np.tile(STRAIGHT, (motion.flaps, 1))
    for after in motion.clamps:
        code.place(shapes.guess(motion, before, after))
        shapes, before = code.shapes(), after
        for _ in range(most):
            code.advance()
            last, shapes = shapes, code.shapes()
            if not np.abs(shapes.nodes - last.nodes).max() > still:
                break
        found.append(shapes)
    return found


def timed(
    code: Relaxing, motion: Motion, rest: list[Shapes], tolerance: float, most: int
) -> tuple[float, int]:
    """Seconds and advances of all poses, each from the equilibria before it until it is close to its own.

    Close: every node within `tolerance` of where it comes to rest. A code that has to find out by itself that
    it is close takes longer. Infinite where `most` advances of a pose do not lead there.
    """
    seconds, advances, before = 0.0, 0, np.tile(STRAIGHT, (motion.flaps, 1))
    shapes = Shapes.straight(motion)
    for after, there in zip(motion.clamps, rest, strict=True):
        code.place(shapes.guess(motion, before, after))
        for _ in range(most):
            start = time.perf_counter()
            code.advance()
            seconds += time.perf_counter() - start
            advances += 1
            if np.abs(code.shapes().nodes - there.nodes).max() <= tolerance:
                break
        else:
            return np.inf, advances
        shapes, before = there, after
    return seconds, advances


def with_retract(motion: Motion, bed: float = BED, shear: float = SHEAR) -> tuple[float, Array]:
    """Seconds of all poses by this project's code, and (poses, flaps, elements + 1, 3) nodes."""
    elements, lanes = motion.elements, np.minimum(np.arange(LANES), motion.flaps - 1)
    P = np.zeros((chain.parameters_rows(elements), LANES))
    P[chain.LENGTH], P[chain.WEIGHT], P[chain.BED] = LENGTH / elements, WEIGHT, bed
    P[chain.STIFFNESS :: 4], P[chain.STIFFNESS + 2 :: 4], P[chain.STIFFNESS + 3 :: 4] = STRETCH, BEND, shear
    share = np.linspace(1, 0, elements + 1)
    nodes = np.empty((elements + 1, 3, LANES))
    nodes[:] = (share[:, None] * (STRAIGHT - [0, 0.5, 0]) + [0, 0.5, 0])[:, :, None]
    parameters, todo, done = P.ravel(), np.arange(LANES) < motion.flaps, np.zeros(LANES, bool)
    W, Z = np.zeros(chain.SCRATCH * LANES), np.zeros(chain.factor_rows(elements) * LANES)
    seconds, found, before = 0.0, [], np.tile(STRAIGHT, (motion.flaps, 1))
    for after in motion.clamps:
        nodes += eased(share)[:, None, None] * (after - before)[lanes].T
        nodes[0] = after[lanes].T
        U = nodes.ravel()
        start = time.perf_counter()
        equilibrium.equilibrate(parameters, U, W, Z, elements, True, todo, done)
        seconds += time.perf_counter() - start
        if not done[: motion.flaps].all():
            raise ValueError("no equilibrium found")
        nodes, before = U.reshape(nodes.shape), after
        found.append(nodes[:, :, : motion.flaps].transpose(2, 0, 1).copy())
    return seconds, np.array(found)
