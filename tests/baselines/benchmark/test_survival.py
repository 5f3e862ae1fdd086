"""What plans survive, and how firmly they would have to be held."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baselines.benchmark import attempts, survival
from baselines.benchmark.contest import compete
from baselines.benchmark.methods import Method, work_item
from baselines.benchmark.splits import load_benchmark
from baselines.benchmark.survival import (
    ENOUGH,
    MOST,
    firmer,
    lightest_part,
    made_firm,
    share_by_rod,
    survived,
)
from baselines.paper.survival import ROD_SEED
from planners import certify, plan
from planners.certify import Robust
from planners.paths import ctc
from planners.swift.planner import SEED
from retract_env.grasp import Grasp
from retract_env.scenarios import draws
from retract_env.scene import Uncertainty
from retract_env.task import SLICES, default_scene

ASKED = {"draws": 40, "seed": 53_000_001, "judged": 1}


def test_draws_are_nobody_elses() -> None:
    """Whoever planned on them would survive them."""
    benchmark = load_benchmark("benchmark")
    first, most = benchmark.survival.seed, max(split.count for split in benchmark.splits.values())
    assert not {SEED, ROD_SEED, Robust().seed} & set(range(first, first + most))
    assert first > 52_100_000 + 1000  # the study's own


@pytest.mark.parametrize("needed", [0.23, 0.5, 0.9])
def test_the_lightest_part_is_just_above_what_survives(needed: float) -> None:
    asked: list[float] = []

    def survival_of(part: float) -> float:
        asked.append(part)
        return 0.995 if part >= needed else 0.9

    part = lightest_part(survival_of, [1.6, 1.25, 1.0, 0.8, 0.63, 0.5, 0.4, 0.3, 0.2])
    assert part is not None and needed <= part <= 1.1 * needed
    assert lightest_part(lambda _: 0.5, [2.0, 1.0]) is None
    assert lightest_part(lambda part: float(part < 2), [2.0, 1.5, 1.0]) == 1.0


def test_a_firmer_grip_goes_the_same_way() -> None:
    scene = default_scene()
    grasp = Grasp(-0.03, 0.2 * scene.tissue.height)
    path = ctc(scene, grasp)
    held = firmer(scene, grasp, path, 1.5)
    assert held is not None
    grip, way = held
    assert grip == Grasp(grasp.x, 1.5 * grasp.compression)
    assert way.poses[:, :3] == pytest.approx(path.poses[:, :3], abs=1e-12)
    height = scene.tissue.height
    assert height - way.poses[:, 3] == pytest.approx(1.5 * (height - path.poses[:, 3]), abs=1e-12)
    assert firmer(scene, grasp, path, 1.01 * MOST / 0.2) is None
    pressed = firmer(scene, Grasp(-0.03, force=0.01), path, 2.0)
    assert pressed is not None and pressed[0] == Grasp(-0.03, force=0.02) and pressed[1] == path


def test_a_light_plan_fails_on_draws_and_a_firmer_grip_holds_on_them() -> None:
    scene = default_scene()
    best = plan(scene, "eased", "coarse", workers=1)
    grasp, path, history = best.grasp, best.path, best.certificate.history
    z = draws(100, 53_000_001)
    found = survived(scene, grasp, path, history, z, 1)
    assert (found.draws, found.judged) == (100, 1) and found.undecided > 0
    # by one draw at most, which finite elements judge, is it another word than the rod's
    assert found.share == pytest.approx(share_by_rod(scene, grasp, path, history, z), abs=0.0101)
    assert 0.2 < found.share < ENOUGH
    firm = made_firm(scene, grasp, path, history, z, 1, "coarse")
    assert firm is not None
    part, strain = firm
    assert part > 1.05 and best.certificate.max_strain < strain < 2 * best.certificate.max_strain
    held = firmer(scene, grasp, path, part)
    assert held is not None
    again = certify(scene, *held, "coarse")
    assert again.certified and again.max_strain == strain
    assert survived(scene, *held, again.history, z, 1).share >= ENOUGH


def test_a_few_draws_cannot_tell_that_nearly_all_survive(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of those that finite elements judge hold, where the rod cannot follow the plan."""
    monkeypatch.setattr(survival, "corrected_by", lambda *_: None)
    monkeypatch.setattr(survival, "outcome", lambda *_: "ok")
    scene, grasp = default_scene(), Grasp(-0.03, 1e-3)
    found = survived(scene, grasp, ctc(scene, grasp), {}, draws(100, 53_000_001), 4)
    assert (found.share, found.draws, found.nearly_all) == (1.0, 4, False)


def test_where_all_is_known_a_certified_plan_survives() -> None:
    scene = default_scene().model_copy(update={"uncertainty": Uncertainty.none()})
    task = work_item(
        method=Method("planner", "eased"), scene=scene.dump(), resolution="coarse", survival=ASKED
    )
    row = compete(task)
    assert row["certified"] and row["survival"] == 1.0
    assert (row["firm_part"], row["firm_strain"]) == (1.0, row["max_strain"])


def test_what_is_not_certified_survives_nothing() -> None:
    task = work_item(
        method=Method("nothing", "nothing"),
        scene=default_scene().dump(),
        resolution="coarse",
        survival=ASKED,
    )
    row = compete(task)
    assert (row["certified"], row["survival"], row["firm_strain"]) == (False, 0.0, None)


def test_a_policy_is_played_on_the_first_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """The draws are the environment's to know, not the policy's; on every second one it succeeds."""
    seen: list[Any] = []

    class Stub:
        unwrapped = property(lambda self: self)

        def reset(self, seed: int | None, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
            seen.append(options)
            return np.zeros(3), {}

        def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
            good = len(seen) % 2 == 0
            return np.zeros(3), 0.0, True, False, {"is_success": good, "failure": None}

        def close(self) -> None:
            """Holds no resources."""

    def make(name: str, **given: Any) -> Stub:
        assert given == {"resolution": "coarse", "disable_env_checker": True}
        return Stub()

    made: list[Any] = []

    def acting(*asked: Any) -> Any:
        made.append(really_acting(*asked))
        return made[-1]

    really_acting = attempts.acting
    monkeypatch.setattr(attempts, "acting", acting)
    monkeypatch.setattr(attempts, "gym", SimpleNamespace(make=make))
    task = work_item(
        method=Method("nothing", "nothing"),
        scene=default_scene().dump(),
        number=3,
        survival=ASKED,
        played=4,
    )
    assert attempts.played_on_draws(task) == {"closed_loop": 0.5}
    assert len(made) == 4  # new for each draw, and no more
    assert np.array([options["unknowns"] for options in seen]) == pytest.approx(draws(40, 53_000_004)[:4])


@pytest.mark.parametrize("given_as", [lambda policy: policy, attempts._Sane], ids=["ours", "from elsewhere"])
def test_a_policy_plays_by_its_own_grip_and_sensors(given_as: Callable[[Any], Any]) -> None:
    """What its jaws did is a grasp by force, and it is not shown what its sensors do not have."""
    kwargs = {"scene": "random", "grip": "force", "sensors": {"hide": ["strain"]}, "unknowns": True}
    seen: list[Any] = []

    class Still:
        env = {"id": "TissueRetractRod-v0", "kwargs": kwargs}  # noqa: RUF012

        def __call__(self, observation: Any) -> Any:
            seen.append(observation[SLICES["strain"]][0])
            return np.zeros(3, np.float32)

    task = work_item(method=Method("nothing", "nothing"), scene=default_scene().dump())
    handed = attempts._played(given_as(Still()), default_scene(), task)
    assert handed.grasp is not None and handed.grasp.force is not None
    assert len(seen) == 64 and not any(seen)
