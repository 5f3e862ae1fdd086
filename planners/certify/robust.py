"""What a certificate says of flaps that are not quite what the scene says: the robust statement.

Fresh draws of what is not known (`retract_env.scenarios`) are followed by the rod, corrected by what finite
elements felt along the plan on the scene's own flap. A draw counts as held where it holds even if the rod is
worse off by a margin that, as measured, finite elements exceed in one case out of a hundred; as failing where
it fails even if the rod is better off by as much; finite elements judge what is in between. What follows for
the probability that the plan fails, and what is assumed, is derived in docs/robustness.md.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.certify.certificate import Certificate
from planners.certify.retraction import Retraction
from planners.correction import Correction, correction
from planners.side_by_side import Stop, side_by_side
from planners.whatif import Flaps
from retract_env.errors import MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.rod.follow import CLEAR, STRAIN, TOUCHES
from retract_env.scenarios import PLANNERS_SEED, draws, scenario
from retract_env.scene import UNKNOWNS, Scene, Uncertainty
from retract_env.threads import cores

OnJudged = Callable[[int, int], None]
"""Called with how many draws finite elements have judged, and of how many; from any thread."""
Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MEASURED = Path(__file__).with_name("scenarios.json")
STRAIN_UNIT, FRICTION_UNIT, CLEARANCE_UNIT = 0.05, 0.01, 0.001
"""Margins of level 1: of eps_1%, part of it; of the needed friction; of clearance over the flap's length. The
first is generous, as plans that spare the tissue strain it by far less than allowed."""
LEVELS = np.geomspace(0.25, 64.0, 33)
"""Margins that are told apart."""
RARE = 0.01
"""A margin is enough where finite elements exceed it at most this often."""
MOST_JUDGED = 32
"""Draws that finite elements judge, at most; what is then still in between counts as failing."""
WORST = 3
"""Draws that are told of, those that fail or are nearest to it."""
PROBE = 0.01
"""Of a range, for derivatives by central differences."""


@dataclass(frozen=True)
class Robust:
    """What is to be said: P(the plan fails) <= eps, wrong at most with probability beta."""

    eps: float = 0.01
    beta: float = 1e-3
    samples: int = 1000
    seed: int = 0
    """of the draws; not one that a planner draws with"""

    def __post_init__(self) -> None:
        for name in ("eps", "beta"):
            value = getattr(self, name)
            if not 0 < value < 1:
                raise ValueError(f"robust.{name} = {value:g}, allowed (0, 1)")
        if not 10 <= self.samples <= 1_000_000:
            raise ValueError(f"robust.samples = {self.samples}, allowed 10 to 1000000")
        if self.seed == PLANNERS_SEED:
            raise ValueError(f"robust.seed = {self.seed}, allowed another: planners draw with it")


def upper_bound(failures: int, samples: int, beta: float) -> float:
    """Clopper and Pearson's upper bound of a probability, wrong at most with probability beta."""
    if failures >= samples:
        return 1.0
    if failures == 0:
        return float(1.0 - beta ** (1.0 / samples))
    from scipy.special import betaincinv

    return float(betaincinv(failures + 1, samples - failures, 1.0 - beta))


@lru_cache(maxsize=1)
def _scores() -> Array:
    """Levels that finite elements needed on other plans and draws, ascending."""
    return np.array(json.loads(MEASURED.read_text("utf-8"))["scores"])


def exceeded(level: Array) -> Array:
    """How often finite elements exceed a margin of that level, at most: a split-conformal p-value."""
    scores = _scores()
    above = len(scores) - np.searchsorted(scores, np.asarray(level) + 1e-12, side="left")
    return np.asarray((1 + above) / (len(scores) + 1))


@dataclass(frozen=True)
class Followed:
    """A plan on n flaps by the rod, corrected."""

    strain: Array
    """(n, t) eps_1%"""
    friction: Array
    """(n, t) needed"""
    limit: Array
    """(n,) of friction"""
    clearance: Array
    """(n, t) m"""
    touches: Flags
    """(n, t)"""
    closed: Flags
    """(n,) whether the jaws close on the flap at all"""
    scene: Scene

    def at(self, level: float) -> tuple[NDArray[np.int64], Array, Array, NDArray[np.object_]]:
        """Where the target comes into view (n,), the greatest strain and friction until then, and what
        becomes of the retraction, if the rod is worse off by a level; better off by a negative one."""
        n, t = self.strain.shape
        scene = self.scene
        clear = self.clearance - level * CLEARANCE_UNIT * scene.tissue.length
        in_view = clear >= scene.limits.clearance
        shown = np.where(in_view.any(-1), in_view.argmax(-1), t)
        until = np.arange(t) <= shown[:, None]
        lost = np.isnan(self.strain) & until
        with np.errstate(invalid="ignore"):
            strain = np.fmax.reduce(np.where(until, self.strain * (1 + level * STRAIN_UNIT), 0.0), axis=-1)
            needed = np.where(until, self.friction + level * FRICTION_UNIT, 0.0)
            friction, needed = np.fmax.reduce(needed, axis=-1), np.where(lost, 0.0, needed).max(-1)
        reason = np.full(n, "ok", object)
        reason[shown == t] = "not_visible"
        reason[lost.any(-1)] = "diverged"  # unless a limit was broken before
        reason[(self.touches & until).any(-1)] = "contact"
        reason[needed > self.limit] = "slip"
        reason[np.isinf(needed) | ~self.closed] = "release"
        reason[strain > scene.limits.strain] = "strain"
        return shown, strain, friction, reason


def followed(scene: Scene, grasp: Grasp, path: JawPath, flaps: Flaps, corrected: Correction) -> Followed:
    """A plan on some flaps of its scene."""
    poses = path.poses[1:][None]
    force = None if grasp.force is None else [grasp.force]
    # on until the target is in view even by the largest margin
    goal = scene.limits.clearance + LEVELS[-1] * CLEARANCE_UNIT * scene.tissue.length
    goal -= min(0.0, float(corrected.clearance.min()))
    done = flaps.follow([grasp.x], poses, goal, force)
    felt = corrected.apply(done.felt)
    return Followed(
        felt[..., STRAIN],
        corrected.needed_friction(felt),
        flaps.friction,
        felt[..., CLEAR],
        felt[..., TOUCHES] > 0,
        np.ones(len(felt), bool) if force is None else flaps.pressing(force)[:, 0] > 0,
        scene,
    )


def corrected_by(scene: Scene, grasp: Grasp, path: JawPath, history: Any) -> Correction | None:
    """What finite elements felt along a plan more than the rod; None where the rod cannot follow it."""
    force = None if grasp.force is None else [grasp.force]
    rod = Flaps(scene).follow([grasp.x], path.poses[1:][None], force=force)
    reached = int(rod.reached[0])
    if reached < 2:
        return None
    progress = np.arange(1.0, path.last + 1)
    found = correction(scene, progress[:reached], rod.felt[0, :reached], history)
    return None if found is None else found.padded(path.last - reached)


def levels(f: Followed) -> tuple[Array, NDArray[np.object_]]:
    """(n,) the greatest level with which each retraction holds, -1 where it holds with none, and -2 where it
    fails with any that may be needed; and what becomes of it by the rod."""
    holds = np.stack([f.at(level)[3] == "ok" for level in LEVELS], axis=-1)
    # all of the lower ones, too
    count = np.where(holds.all(-1), len(LEVELS), (~holds).argmax(-1))
    out = np.where(count > 0, LEVELS[np.maximum(count - 1, 0)], -1.0)
    enough = LEVELS[exceeded(LEVELS) <= RARE]
    surely = f.at(-enough[0])[3] != "ok" if len(enough) else np.zeros(len(out), bool)
    return np.where(surely, -2.0, out), f.at(0.0)[3]


def check_statable(scene: Scene) -> None:
    """Raise SceneError for tissue of which nothing can be stated: distances of rod and finite elements were
    measured on the neo-Hookean law."""
    scene.needs_neo_hookean("for a robust statement")


def statement(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    certificate: Certificate,
    asked: Robust,
    on_increment: Callable[[], None] = lambda: None,
    on_judged: OnJudged = lambda done, of: None,  # noqa: ARG005
) -> dict[str, Any]:
    """What is said of a plan whose certificate is known; plain data.

    Finite elements are those of the certificate's mesh. Where the rod cannot follow the plan they judge
    MOST_JUDGED draws, and all others count as failing. Raises SceneError for tissue of another law than the
    rod's.
    """
    check_statable(scene)
    z = draws(asked.samples, asked.seed)
    corrected = corrected_by(scene, grasp, path, certificate.history)
    if corrected is None:
        level, reason = np.full(len(z), -1.0), np.full(len(z), "diverged", object)
    else:
        flaps = Flaps(scene, z)
        level, reason = levels(followed(scene, grasp, path, flaps, corrected))
    missed = np.where(level > 0, exceeded(np.maximum(level, 0.0)), 0.0)
    held = (level > 0) & (missed <= RARE)
    fails = level == -2.0
    between = np.flatnonzero(~held & ~fails)
    missed[~held] = 0.0
    judged: dict[int, str] = {}
    resolution = certificate.mesh["resolution"]
    in_question = between[:MOST_JUDGED].tolist()
    stop = Stop()

    def step() -> None:
        stop()
        on_increment()

    def judge(i: int) -> None:
        judged[i] = outcome(scene, grasp, path, z[i], resolution, step)
        on_judged(len(judged), len(in_question))

    on_judged(0, len(in_question))
    side_by_side(judge, in_question, cores(), stop)
    undecided = len(between) - len(judged)
    failures = Counter(map(str, reason[fails])) + Counter(end for end in judged.values() if end != "ok")
    if undecided:
        failures["undecided"] = undecided
    count = sum(failures.values())
    sampled, overlooked = upper_bound(count, asked.samples, asked.beta), float(missed.mean())
    bound = min(1.0, sampled + overlooked)
    order = sorted(range(len(z)), key=lambda i: (judged.get(i, "ok") == "ok", float(level[i]), i))
    return {
        "holds": certificate.certified and bound <= asked.eps,
        "eps": asked.eps,
        "beta": asked.beta,
        "samples": asked.samples,
        "seed": asked.seed,
        "failures": dict(sorted(failures.items())),
        "bound": bound,
        "sampled": sampled,
        "missed": overlooked,
        "judged": {
            "rod": asked.samples - len(between),
            "finite_elements": len(judged),
            "undecided": undecided,
        },
        "prior": scene.uncertainty.model_dump(mode="json"),
        "worst": [_told(z[i], judged.get(i, str(reason[i]))) for i in order[:WORST]],
        "sensitivities": None if corrected is None else sensitivities(scene, grasp, path, corrected),
    }


def outcome(
    scene: Scene,
    grasp: Grasp,
    path: JawPath,
    z: Array,
    resolution: str,
    on_increment: Callable[[], None] = lambda: None,
) -> str:
    """What becomes of a plan on one draw (UNKNOWNS,), by finite elements."""
    there = scenario(scene, grasp, path, z)
    if there is None:
        return "release"
    try:
        retraction = Retraction(*there, resolution=resolution)
        retraction.squeeze(on_increment)
        retraction.move(on_increment=on_increment)
    except MeshError:
        return "diverged"
    assert retraction.reason is not None
    return retraction.reason


def _told(z: Array, reason: str) -> dict[str, Any]:
    return {"draw": dict(zip(UNKNOWNS, z.tolist(), strict=True)), "reason": reason}


def drawn(told: dict[str, Any]) -> Array:
    """(UNKNOWNS,) the draw that one of the worst cases is, for `scenario`."""
    return np.array([told["draw"][name] for name in UNKNOWNS])


def sensitivities(
    scene: Scene, grasp: Grasp, path: JawPath, corrected: Correction
) -> dict[str, dict[str, float]]:
    """Derivatives of the greatest strain and friction, and of the clearance at the end, by each unknown.

    By parts of the nominal value or by metres, as the prior has them; `half_range` is the prior's, so that
    derivative times half_range is what that ignorance costs. By central differences on the rod.
    """
    probed = probe(scene)
    base = _origin(probed)
    steps = PROBE * np.eye(len(UNKNOWNS))
    z = np.concatenate([base + steps, base - steps, base[None]])
    f = followed(probed, grasp, path, Flaps(probed, z), corrected)
    shown = min(int(f.at(0.0)[0][-1]), f.strain.shape[1] - 1)
    n = len(UNKNOWNS)
    values = np.stack(
        [
            f.strain[:, : shown + 1].max(-1),
            np.minimum(f.friction[:, : shown + 1].max(-1), 1e6),
            f.clearance[:, shown],
        ]
    )
    slopes = (values[:, :n] - values[:, n : 2 * n]) / (2 * PROBE)
    out: dict[str, dict[str, float]] = {}
    for i, name in enumerate(UNKNOWNS):
        unit = _half_range(probed.uncertainty, name)
        strain, friction, clearance = (slopes[:, i] / unit).tolist()
        out[name] = {
            "half_range": _half_range(scene.uncertainty, name),
            "strain": strain,
            "friction": friction,
            "clearance": clearance,
        }
    return out


def probe(scene: Scene) -> Scene:
    """The scene with ranges over which derivatives are taken, whatever its own are."""
    tissue = scene.tissue
    small = 0.01 * tissue.height
    nu = min(max(tissue.poisson, 0.05), 0.44)
    shares = dict.fromkeys(("modulus", "vein_modulus", "weight", "thickness", "friction", "force"), 0.1)
    lengths = dict.fromkeys(("grasp", "closing", "target"), small)
    ranges = Uncertainty(**shares, **lengths, jaw_width=0.1, poisson=(nu - 0.05, nu + 0.05), force_floor=0.0)
    return scene.model_copy(update={"uncertainty": ranges})


def _origin(scene: Scene) -> Array:
    """(UNKNOWNS,) the draw that is the scene itself."""
    z = np.zeros(len(UNKNOWNS))
    if scene.uncertainty.poisson is not None:
        low, high = scene.uncertainty.poisson
        z[UNKNOWNS.index("poisson")] = (scene.tissue.poisson - (low + high) / 2) / ((high - low) / 2)
    return z


def _half_range(uncertainty: Uncertainty, name: str) -> float:
    value = getattr(uncertainty, name)
    if name == "poisson":
        return 0.0 if value is None else (value[1] - value[0]) / 2
    return float(value)


def scores(f: Followed, exposed: Sequence[float], strain: Array, friction: Array) -> Array:
    """(n,) the least level with which the rod is not better off than finite elements were.

    exposed: (n,) progress in waypoints at which their target came into view, inf: never; strain, friction:
    (n,) the greatest until then. How far beyond a limit does not matter.
    """
    out, hidden = np.full(len(exposed), np.inf), np.isinf(exposed)
    strain = np.minimum(strain, f.scene.limits.strain)
    friction = np.minimum(friction, f.limit)
    for level in LEVELS[::-1]:
        shown, rod_strain, rod_friction, _ = f.at(float(level))
        covers = (rod_strain >= strain) & (rod_friction >= friction)
        covers &= ~hidden | (shown == f.strain.shape[1])
        out = np.where(covers, level, out)
    return out
