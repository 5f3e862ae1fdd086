"""What verification reports is right: extrapolation, splitting, tolerances, the page."""

from __future__ import annotations

import json
import math
from itertools import product
from typing import Any

import pytest

from baselines.paper.studies import study
from baselines.paper.study import page
from baselines.verification import code
from baselines.verification.assumptions import CHANGES, MOTIONS, SLIDING, changed
from baselines.verification.code import CHECKS
from baselines.verification.flaps import HEIGHT, flap, square_vein
from baselines.verification.solution import (
    CASES,
    CERTIFIED,
    QUANTITIES,
    RATIO,
    SAFETY,
    SPLITS,
    SplitMesh,
    convergence,
)
from retract_env.scene import Scene

TESTED_ELSEWHERE = ("manufactured", "cantilever")
"""in tests/retract_env/fem/test_convergence.py"""


@pytest.mark.parametrize(("order", "limit"), list(product([0.7, 1.0, 2.0, 2.9], [0.3, -2.0])))
def test_what_converges_at_an_order_is_found_to(order: float, limit: float) -> None:
    values = [limit + 0.05 * (RATIO**-k) ** order for k in SPLITS]
    found = convergence(values, limit + 0.01, scale=2.0)
    assert found.order == pytest.approx(order)
    assert found.limit == pytest.approx(limit)
    assert found.index == pytest.approx(SAFETY * abs(values[-1] - limit) / 2.0)
    assert found.off == pytest.approx(0.005)


def test_what_does_not_tend_to_one_side_has_no_order_and_an_honest_index() -> None:
    found = convergence([1.0, 1.2, 1.1], 1.1, scale=1.0)
    assert math.isnan(found.order)
    assert found.limit == 1.1 and found.index == pytest.approx(SAFETY * 0.2)
    slow = convergence([1.0, 1.1, 1.19], 1.1, scale=1.0)  # of order .15
    assert slow.limit == 1.19 and slow.index == pytest.approx(SAFETY * 0.19)
    assert convergence([1.0, 1.0, 1.0], 1.0, scale=1.0).index == 0


def test_split_meshes_cover_the_same_flap_with_the_same_veins() -> None:
    scene = flap(length=0.02, veins=[square_vein(-0.006, 0.002, 0.0008)])
    coarse, fine = (SplitMesh(scene, -0.01, splits) for splits in (0, 1))
    assert len(fine.section.triangles) == 4 * len(coarse.section.triangles)
    for physics in (coarse, fine):
        area = physics.section.corners
        (ax, ay), (bx, by) = (area[:, 1] - area[:, 0]).T, (area[:, 2] - area[:, 0]).T
        double = ax * by - ay * bx
        assert double.sum() / 2 == pytest.approx(0.02 * HEIGHT)
        assert double[physics.section.vein == 0].sum() / 2 == pytest.approx(0.0016**2)
    for a, b in zip(coarse.section.patches, fine.section.patches, strict=True):
        assert len(b) == 2 * len(a) - 1
    assert fine.section.bottom_length.sum() == pytest.approx(coarse.section.bottom_length.sum())


@pytest.mark.parametrize(
    "check", [c for c in CHECKS if not c[0].startswith(TESTED_ELSEWHERE)], ids=lambda c: c[0]
)
def test_the_code_passes_its_checks(check: code.Check) -> None:
    _, function, arguments, _ = check
    row = function(resolution="coarse", **arguments)
    assert row["least"] <= row["value"] <= row["most"]


def test_each_assumption_changes_the_scene() -> None:
    for name in CHANGES:
        assert (changed(flap(), name) == flap()) == (name == "as it is")


def test_relaxed_moduli_are_those_of_tissue_and_veins() -> None:
    scene = flap(veins=[square_vein(-0.02, 0.002, 0.0008)])
    relaxed = changed(scene, "held until half of the stiffness has relaxed")
    assert relaxed.tissue.modulus == scene.tissue.modulus / 2
    assert relaxed.tissue.veins[0].modulus == scene.tissue.veins[0].modulus / 2
    assert relaxed.tissue.veins[0].outline == scene.tissue.veins[0].outline


def test_every_experiment_goes_through_json() -> None:
    experiments = study("verification").experiments()
    works = [json.dumps(one.work("fine"), sort_keys=True) for one in experiments]
    assert len(set(works)) == len(works)
    solution, assumed = len(CASES) * (len(SPLITS) + 1), 2 * len(CHANGES) + 2 * len(MOTIONS) + len(SLIDING)
    assert len(works) == len(CHECKS) + solution + assumed


def rows(off: float) -> list[dict[str, Any]]:
    """As the experiments would come to, with the mesh of certificates off by a part of each quantity."""
    out = []
    for one in study("verification").experiments():
        label = dict(one.label)
        if label["group"] == "code":
            row: dict[str, Any] = {"value": 1.0, "least": "-inf", "most": 2.0}
        else:
            k = label.get("splits", CERTIFIED)
            part = (
                off if k == CERTIFIED and label["group"] == "solution" else 0.01 * 4.0**-k if k >= 0 else 0.0
            )
            row = {"reason": "not_visible", "unknowns": 1000, "length": 0.05}
            row |= dict.fromkeys(QUANTITIES, 0.3 * (1 + part))
            row |= {"speed": 0.01, "strain_slow": 0.2, "friction_slow": 0.25}
            row |= {"strain_rigid": 0.2, "friction_rigid": 0.25, "clearance_rigid": 0.2}
            row |= {"creep": 1e-5, "sliding": 0.5, "lifted": 0.1}
        out.append({**label, **row})
    return out


@pytest.mark.parametrize(("off", "agrees"), [(0.02, "yes"), (0.2, "no")])
def test_the_page_says_what_is_within_its_tolerance(off: float, agrees: str) -> None:
    asked = study("verification")
    report = asked.report(rows(off))
    strain = next(claim for claim in report.claims if claim.said.startswith("eps_max"))
    assert strain.agrees == agrees and f"{100 * off / (1 + off):.2g} %" in strain.found
    by_node = report.claims[-1]
    assert by_node.said.startswith("Patches that slip") and by_node.found == "at most 20 %"
    assert by_node.agrees == "no"
    text = page(asked, report, "fine")
    in_time = text.partition("### In time")[2].splitlines()
    assert sum(line.endswith("| 10 | +50.0 % | +0.050 | +300.00 |") for line in in_time) == 2 * len(MOTIONS)
    told = text.partition("### Node by node")[2].splitlines()
    assert sum(line.endswith("| +50.0 % | +0.050 | 10 | 50 % | 10 % | +100.00 |") for line in told) == 4
    assert "## Code" in text and "## Solution" in text and "## Model" in text and "nan" not in text
    assert {line["holds"] for line in report.table if line["group"] == "code"} == {"yes"}


def test_scenes_of_cases_are_sound() -> None:
    for case in CASES.values():
        scene = case.scene()
        assert Scene.from_data(scene.dump()) == scene
        assert case.path(scene, case.grasp).last > 10
