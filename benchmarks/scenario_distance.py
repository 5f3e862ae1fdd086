"""How far the corrected rod is from fine finite elements on flaps that are not quite as the scene says:
python -m benchmarks.scenario_distance.

For plans of four kinds on random flaps, finite elements follow the plan on the scene's own flap, which
corrects the rod, and on draws from the default prior. Each draw gives a score: the least level of the margins
(`planners.certify.robust`) with which the rod is not better off than the finite elements. Flaps of even seeds
give planners/certify/scenarios.json, which the robust statement uses; with those of odd seeds it says how
often the margins are exceeded.

A line of out/scenarios/MESH.jsonl is one plan. What is there already is not computed again.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import machine, on_one_thread, table
from planners import paths
from planners.certify import robust
from planners.certify.retraction import Retraction
from planners.eased import FIRST, PLACES, RADII, eased
from planners.swift.planner import Search
from planners.whatif import Flaps
from retract_env.errors import MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import jaw_range
from retract_env.scenarios import draws, scenario
from retract_env.scene import Limits, Scene, sample_scene
from retract_env.spring import SpringModel
from retract_env.threads import cores

FOLDER = Path("out/scenarios")
FIRST_SEED, FLAPS = 70_000, 200
KINDS = ("swift", "swift_force", "ctc", "eased")
DRAWS = 2
"""for each plan"""
HISTORY = ("progress", "strain", "friction", "reactions", "jaws", "clearance")
LENIENT = Limits(strain=0.99, friction=5.0)
"""so that what happens past a limit is known too"""


def plan_of(scene: Scene, kind: str, rng: np.random.Generator) -> tuple[Grasp, JawPath]:
    """A plan of that kind, by the rod or by rule."""
    tissue, line = scene.tissue, scene.line_of_sight
    if kind.startswith("swift"):
        search = Search(scene, kind == "swift_force")
        return search.plan_of(search.ranked()[0].unknowns)
    if kind == "ctc":
        stable = SpringModel(tissue).stable_grasps(scene.limits.strain, scene.jaws.width)
        chosen = stable[int(rng.integers(len(stable)))]
        grasp = Grasp(chosen.x, chosen.compression * rng.uniform(0.4, 1.0))
        return grasp, paths.ctc(scene, grasp)
    radius = paths.goal_radius(line.camera, line.target) / tissue.length
    place, first = (float(np.interp(radius, RADII, values)) for values in (PLACES, FIRST))
    low, high = jaw_range(tissue.length, scene.jaws.width)
    x = float(np.clip(-place * tissue.length * rng.uniform(0.9, 1.1), low, high))
    grasp = Grasp(x, first * tissue.height * rng.uniform(1.2, 2.2))
    return grasp, eased(scene, grasp)


def followed(scene: Scene, grasp: Grasp, path: JawPath, mesh: str) -> Retraction | None:
    """By finite elements, to its end whatever it strains."""
    retraction = Retraction(scene, grasp, path, mesh, LENIENT)
    try:
        retraction.squeeze()
        retraction.move()
    except MeshError:
        return None
    return retraction


def measured(mesh: str, item: tuple[int, str]) -> dict[str, Any]:
    """One plan as plain data: the history on its own flap, and what became of the draws."""
    seed, kind = item
    scene = sample_scene(np.random.default_rng(seed))
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    grasp, path = plan_of(scene, kind, rng)
    found: dict[str, Any] = {
        "seed": seed,
        "kind": kind,
        "grasp": {"x": grasp.x, **grasp.firmness},
        "path": path.to_json(),
        "history": None,
        "draws": [],
    }
    own = followed(scene, grasp, path, mesh)
    if own is None or own.reason != "ok":
        return found
    history = own.history()
    found["history"] = {
        name: history[name] for name in ("progress", "strain", "friction", "reactions", "jaws", "clearance")
    }
    for z in draws(DRAWS, seed):
        there = scenario(scene, grasp, path, z)
        if there is None:
            continue
        end = followed(there[0].model_copy(update={"limits": LENIENT}), there[1], there[2], mesh)
        if end is None or end.reason not in ("ok", "not_visible"):
            continue
        exposed = end.frames[-1].progress if end.reason == "ok" else math.inf
        told = [z.tolist(), exposed, end.max_strain, end.required_friction]
        found["draws"].append(told)
    return found


def scores(plan: dict[str, Any]) -> list[float]:
    """Of each draw; inf where the rod cannot follow."""
    scene = sample_scene(np.random.default_rng(plan["seed"]))
    grasp, path = Grasp(**plan["grasp"]), JawPath.from_json(plan["path"])
    if not plan["draws"]:
        return []
    corrected = robust.corrected_by(scene, grasp, path, plan["history"])
    if corrected is None:
        return [math.inf] * len(plan["draws"])
    z = np.array([d[0] for d in plan["draws"]])
    flaps = Flaps(scene, z)
    exposed, strain, friction = (np.array([d[k] for d in plan["draws"]]) for k in (1, 2, 3))
    rod = robust.followed(scene, grasp, path, flaps, corrected)
    found: list[float] = robust.scores(rod, exposed.tolist(), strain, friction).tolist()
    return found


def stored(mesh: str) -> list[dict[str, Any]]:
    """The plans that are on disk."""
    file = FOLDER / f"{mesh}.jsonl"
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []


def _on_one_core() -> None:
    """Have a worker use no more threads than it has cores."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[os.getpid() % cores()]})


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flaps", type=int, default=FLAPS)
    parser.add_argument("--mesh", default="fine")
    parser.add_argument("--workers", type=int, default=cores())
    options = parser.parse_args(arguments)
    print(machine())
    FOLDER.mkdir(parents=True, exist_ok=True)
    there = {(p["seed"], p["kind"]) for p in stored(options.mesh)}
    seeds = range(FIRST_SEED, FIRST_SEED + options.flaps)
    work = [item for item in ((s, k) for s in seeds for k in KINDS) if item not in there]
    start = time.perf_counter()
    with (
        (FOLDER / f"{options.mesh}.jsonl").open("a", encoding="utf-8") as file,
        ProcessPoolExecutor(options.workers, initializer=_on_one_core) as pool,
    ):
        for done, found in enumerate(pool.map(partial(measured, options.mesh), work), 1):
            file.write(json.dumps(found) + "\n")
            file.flush()
            if done % 20 == 0:
                left = (time.perf_counter() - start) / done * (len(work) - done) / 60
                print(f"{done} of {len(work)} plans, {left:.0f} min left", file=sys.stderr, flush=True)

    plans = stored(options.mesh)
    by_half = [[s for p in plans if p["seed"] % 2 == odd for s in scores(p)] for odd in (0, 1)]
    kept = sorted(min(s, 1e9) for s in by_half[0])
    text = json.dumps(
        {"mesh": options.mesh, "flaps": options.flaps // 2, "scores": [round(s, 4) for s in kept]}
    )
    if options.mesh == "fine":
        robust.MEASURED.write_text(text + "\n", "utf-8")
    rows = []
    for level in (0.5, 0.8, 0.9, 0.95, 0.99):
        margin = float(np.quantile(kept, level, method="higher"))
        rows.append([f"{level:.0%}", margin, float(np.mean(np.array(by_half[1]) <= margin))])
    print(table(["level", "margin", "covered on other flaps"], rows))
    for kind in KINDS:
        of_kind = [s for p in plans if p["kind"] == kind for s in scores(p)]
        print(kind, len(of_kind), *(f"{q:.0%} {np.quantile(of_kind, q):.2f}" for q in (0.5, 0.9, 0.95, 0.99)))


if __name__ == "__main__":
    on_one_thread("benchmarks.scenario_distance", sys.argv[1:])
    main()
