"""What rigid patches leave out: jaws whose every node slips by itself, by Coulomb's law, and may let go.

The certifier has both patches move with the jaws as a whole and judges slip by each jaw's resultant. Here the
patches' nodes are free; each pad pushes them away by a stiff penalty, and drags each along by a penalty up to
the coefficient of friction times what it is pushed by (Simo and Laursen 1992; the pushes that bound friction
are those of the equilibrium before, until they change no more). What has slipped stays slipped, so that the
patch creeps along the pad. Free along the depth, and without the sides of the pads, which a patch does not
slide off: it creeps by a fraction of its width.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from retract_env.errors import Diverged
from retract_env.fem.linear import Factor, cholesky
from retract_env.fem.model import FlapModel
from retract_env.fem.solver import factorize_shifted
from retract_env.mesh import RESOLUTIONS, Resolution
from retract_env.mesh.outlines import resolved_section
from retract_env.mesh.section import edge_lengths
from retract_env.physics.base import TissueState
from retract_env.physics.measures import Measures
from retract_env.scene import Scene

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STIFFNESS = 1000.0
"""Of both penalties per area, in E of the tissue over the jaws' width: pushes of a fifth of E give by a
five-thousandth of the width. With a third of it the surface of a firmly gripped flap creases under the end of
a pad, where several equilibria exist on fine meshes; with more it does not."""
SETTLED = 1e-4
"""Pushes have settled once none changes friction by more than this part of all friction."""
MOST_ROUNDS, MOST_ITERATIONS = 60, 200
LEAST_WEIGHT = 0.1
"""Of the latest pushes, where these swing."""
FIRST_SHIFT = 1e-4
"""Of a tangent that is not positive definite, over the mean of its diagonal."""
STILL = 1e-12
"""Energy that a step may still release at an equilibrium, over E times the jaws' width to the third."""
SMALLEST_CUT = 1 / 64
"""Part of an increment below which it is not cut any further."""
_TOWARDS = np.array([-1.0, 1.0])
"""Along the jaw axis, into which direction tissue presses on the lower and the upper pad."""


class SlidingFlap(FlapModel):
    """A flap between pads at given jaws (4,) m, to which its patches' nodes are bound by friction alone."""

    def __init__(self, scene: Scene, jaw_x: float, resolution: Resolution, friction: float):
        """friction: Coulomb's coefficient of every node. Raises ValueError for jaws narrower than the flap is
        deep, whose edge shares a level of nodes with what is free."""
        if scene.jaws.depth is not None and scene.jaws.depth < scene.tissue.depth:
            raise ValueError(f"jaws.depth = {scene.jaws.depth:g} m, allowed the flap's depth here")
        section = resolved_section(scene, jaw_x, resolution)
        nobody = np.empty(0, np.int32)
        super().__init__(scene, replace(section, patches=(nobody, nobody)), jaw_x, resolution)
        self.friction, prism, tissue = friction, self.prism, scene.tissue
        every = np.arange(prism.levels)
        along, area, at, pad = [], [], [], []
        for k, patch in enumerate(section.patches):
            edges = section.boundary[np.isin(section.boundary, patch).all(axis=1)]
            length = edge_lengths(section.points, edges)[patch]
            along.append(np.tile(section.points[patch, 0] - jaw_x, prism.levels))
            area.append(np.outer(prism.depth_weight, length).ravel())
            at.append(prism.x(patch, every))
            pad.append(np.full(len(at[-1]), k))
        self.along, self.pad = np.concatenate(along), np.concatenate(pad)
        """(s,) of every node of a patch: m, from the middle of its pad, at rest; 0 for the lower pad's, or
        1"""
        self.area = np.concatenate(area)
        """(s,) m^2, over half the depth"""
        self._x = np.concatenate(at)
        self._rest = np.stack([self.along + jaw_x, self.pad * tissue.height], axis=-1)
        self._stiffness = STIFFNESS * tissue.modulus / scene.jaws.width * self.area
        number = np.full(prism.size, -1)
        number[self.free] = np.arange(len(self.free))
        self._rows = self.assembly.indptr[number[self._x]], self.assembly.indptr[number[self._x + 1]]
        beside = ~np.isin(self._bed, self._x + 1)  # between the bed and the patch is the lower jaw
        self._bed, self._bed_stiffness = self._bed[beside], self._bed_stiffness[beside]
        self._bed_diagonal = self._bed_diagonal[beside]
        self.slipped, self.most, self._welded = np.zeros_like(self.along), np.zeros_like(self.along), False
        """(s,) m, how far nodes have slipped along their pads; (s,) N, the most that friction may hold"""
        self.sliding = np.zeros(len(self.along), bool)
        """(s,) whether friction held a node no more when all was last let slip"""
        self.put(np.array([jaw_x, 0.0, jaw_x, tissue.height]))

    def put(self, jaws: Array) -> None:
        """Put the pads where jaws (4,) m say."""
        axis = jaws[2:] - jaws[:2]
        self._axis = axis / np.hypot(*axis)
        self._tangent = np.array([self._axis[1], -self._axis[0]])
        self._middles = jaws.reshape(2, 2)[self.pad] + self.along[:, None] * self._tangent

    def places(self, u: Array) -> tuple[Array, Array]:
        """(s,) m, how far nodes are from where they were at rest on their pad, along it, and into it."""
        off = self._rest + np.stack([u[self._x], u[self._x + 1]], axis=-1) - self._middles
        return off @ self._tangent, off @ self._axis * _TOWARDS[self.pad]

    def weld(self, u: Array) -> None:
        """Have springs hold every node where it is on its pad."""
        self._welded = True
        self._anchor = self.places(u)

    def let_go(self) -> None:
        """Have friction hold the nodes again."""
        self._welded = False

    def holding(self, u: Array) -> tuple[Array, Array]:
        """(s,) N, what nodes drag their pads by, along them, and press with, over half the depth."""
        along, into = self.places(u)
        k = self._stiffness
        if self._welded:
            return k * (along - self._anchor[0]), k * (into - self._anchor[1])
        return np.clip(k * (along - self.slipped), -self.most, self.most), k * np.maximum(into, 0.0)

    def slides(self, u: Array) -> Flags:
        """(s,) whether friction holds a node no more."""
        along, _ = self.places(u)
        return np.asarray(self._stiffness * np.abs(along - self.slipped) >= self.most)

    def slip(self, u: Array) -> None:
        """Let nodes stay where they have slid to."""
        (along, _), (drag, _) = self.places(u), self.holding(u)
        self.sliding = np.abs(drag) >= (1 - 10 * SETTLED) * self.most
        self.slipped = along - drag / self._stiffness

    def _bound(self, u: Array) -> tuple[Array, Array]:
        """(s,) N/m, stiffness of what holds the nodes, along the pads and into them."""
        k = self._stiffness
        if self._welded:
            return k, k
        return np.where(self.slides(u), 0.0, k), np.where(self.places(u)[1] > 0, k, 0.0)

    def residual(self, u: Array) -> tuple[float, Array]:
        energy, force = super().residual(u)
        drag, push = self.holding(u)
        k = self._stiffness
        # of friction at its limit c: c |slip| - c^2 / 2 k
        along, _ = self.places(u)
        beyond = 0.0 if self._welded else np.abs(drag) * (np.abs(along - self.slipped) - np.abs(drag) / k)
        energy += float(((drag**2 + push**2) / (2 * k) + beyond).sum())
        pull = self._pull(drag, push)
        force[self._x] += pull[:, 0]
        force[self._x + 1] += pull[:, 1]
        return energy, force

    def tangent(self, u: Array, held: Flags | None = None) -> Array:
        values = super().tangent(u, held)
        stiff, hard = self._bound(u)
        (tx, ty), (ax, ay) = self._tangent, self._axis
        x, y = self._rows
        values[x] += stiff * tx * tx + hard * ax * ax
        values[x + 1] += stiff * tx * ty + hard * ax * ay
        values[y] += stiff * ty * ty + hard * ay * ay
        return values

    def on_jaws(self, u: Array) -> Array:
        """(2, 2) N, force of the tissue on the lower and the upper jaw over the whole depth."""
        pull = self._pull(*self.holding(u))
        return np.array([2 * pull[self.pad == k].sum(axis=0) for k in range(2)])

    def _pull(self, drag: Array, push: Array) -> Array:
        """(s, 2) N, what nodes pull at their pads with that drag and press so."""
        pull: Array = drag[:, None] * self._tangent + (push * _TOWARDS[self.pad])[:, None] * self._axis
        return pull


@dataclass(frozen=True)
class Slid:
    """A retraction whose patches may creep."""

    max_strain: float
    required_friction: float
    """the greatest of either jaw's resultant once they have closed"""
    clearance: float
    """m, at the end"""
    creep: float
    """m, the farthest that a node has slipped since the jaws closed"""
    sliding: float
    """part of the worse patch's area that slides at the end"""
    lifted: float
    """part of the worse patch's area that has left its pad"""


def slid(scene: Scene, frames: Sequence[TissueState], friction: float, resolution: str = "fine") -> Slid:
    """Make the motion of a certificate's frames again with patches that slip node by node.

    friction: Coulomb's coefficient. Raises Diverged where a patch slides off its pad, or no equilibrium is
    found.
    """
    before = frames[0].jaws
    model = SlidingFlap(scene, float(before[0]), RESOLUTIONS[resolution], friction)
    measures = Measures.of_layers(scene, model.section, model.assembly, len(model.prism.blocks))
    factor = cholesky(model.assembly.indptr, model.assembly.indices)
    model.weld(np.zeros(model.prism.size))  # open jaws hold it where they touch, as in certificates
    u = _equilibrium(model, factor, model.at_rest())
    closed, states = model.slipped, []
    for frame in frames[1:]:
        u = _moved(model, factor, u, before, frame.jaws)
        before = frame.jaws
        if np.abs(model.slipped).max() > scene.jaws.width:
            raise Diverged(f"a patch slid off its pad at progress {frame.progress:g}")
        if frame.progress <= 1:
            closed = model.slipped
        levels = np.array([model.positions(u, k) for k in range(model.prism.levels)])
        states.append(measures.state(u, frame.jaws, model.on_jaws(u), levels, frame.progress))
    push = model.holding(u)[1]

    def most(which: Flags) -> float:
        return max(
            float(model.area[(model.pad == k) & which].sum() / model.area[model.pad == k].sum())
            for k in (0, 1)
        )

    return Slid(
        max(state.worst_strain for state in states),
        max(float(state.required_friction.max()) for state in states if state.progress >= 1),
        states[-1].clearance,
        float(np.abs(model.slipped - closed).max()),
        most(model.sliding & (push > 0)),
        most(push <= 0),
    )


def _moved(model: SlidingFlap, factor: Factor, u: Array, begin: Array, end: Array) -> Array:
    """The equilibrium (n,) m after the pads went straight from jaws (4,) to others, in parts where needed.

    Raises Diverged.
    """
    done, part = 0.0, 1.0
    while done < 1:
        share = min(done + part, 1.0)
        kept = model.slipped, model.most
        try:
            u = _settled(model, factor, u, begin + share * (end - begin))
            done = share
        except Diverged:
            model.slipped, model.most = kept
            model.put(begin + done * (end - begin))
            part /= 2
            if part < SMALLEST_CUT:
                raise
    return u


def _settled(model: SlidingFlap, factor: Factor, u: Array, jaws: Array) -> Array:
    """The equilibrium with pads there: nodes are first taken along as they are, then let go."""
    model.weld(u)
    model.put(jaws)
    try:
        u = _equilibrium(model, factor, u)
        model.most = model.friction * np.maximum(model.holding(u)[1], 0.0)
    finally:
        model.let_go()
    weight = 1.0
    off: Array | None = None
    for _ in range(MOST_ROUNDS):
        u = _equilibrium(model, factor, u)
        most = model.friction * model.holding(u)[1]
        before, off = off, most - model.most
        if np.abs(off).sum() <= SETTLED * most.sum():
            model.slip(u)
            return u
        if before is not None and (off != before).any():
            swing = off - before  # Aitken's relaxation: pushes that swing are followed less
            weight = float(np.clip(-weight * (before @ swing) / (swing @ swing), LEAST_WEIGHT, 1.0))
        model.most = model.most + weight * off
    raise Diverged("friction does not settle")


def _equilibrium(model: SlidingFlap, factor: Factor, u: Array) -> Array:
    """Near u (n,) m, by Newton's method; steps are cut until they lower the energy, so that where nodes begin
    to slide and stick again it goes back and forth no more than energy allows. Raises Diverged."""
    free, diagonal, counts = model.free, model.assembly.indptr[:-1], Counter[str]()
    scale = model.scene.tissue.modulus * model.scene.jaws.width**3
    energy, force = model.residual(u)
    if not np.isfinite(energy):
        raise Diverged("the first guess turns elements inside out")
    for _ in range(MOST_ITERATIONS):
        factorize_shifted(factor, model.tangent(u), diagonal, FIRST_SHIFT, counts)
        step = np.zeros_like(u)
        step[free] = -factor.solve(force[free])
        slope = float(force @ step)
        if -slope < STILL * scale:
            return u
        length = 1.0
        while True:
            trial = u + length * step
            trial_energy, trial_force = model.residual(trial)
            if trial_energy <= energy + 1e-4 * length * slope:
                break
            length /= 2
            if length < 1e-9:
                raise Diverged("the line search found no lower energy")
        u, energy, force = trial, trial_energy, trial_force
    raise Diverged(f"no equilibrium in {MOST_ITERATIONS} iterations")
