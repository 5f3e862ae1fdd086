"""One method on one scene, judged: the work of the benchmark, for `run_tasks`.

The certifier judges all alike. Planners work in a process of their own beside this one, which is ended where
they take longer than the limit; a method from elsewhere in a fresh one for each scene, where it may do what
it likes and loses no row but its own.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from baselines.benchmark.attempts import HandedIn, hand_in, played_on_draws, transferred
from baselines.benchmark.external import found_at
from baselines.benchmark.methods import Method
from baselines.benchmark.splits import BenchmarkError
from baselines.benchmark.survival import ENOUGH, made_firm, survived
from baselines.jobs.apart import Answer, Apart
from baselines.jobs.journal import Row, WorkItem
from baselines.jobs.version import code_version
from planners.certify import FAILURES, Certificate, certify
from retract_env.grasp import Grasp, JawPath
from retract_env.scenarios import draws
from retract_env.scene import Scene

TROUBLES = ("time", "raised", "returned", "died")
"""Why nothing that a method handed in could be judged: it took too long, raised, returned nonsense, or its
process died."""
REASONS = (*FAILURES, *TROUBLES)
"""Why a row is not certified; a planner that found nothing may give others."""
ACT = ("policy", "external")
"""Kinds of methods that may be policies, and are then played on the other physics and on draws too."""

_PLANNING = Apart()
atexit.register(_PLANNING.close)

Ask = Callable[[Callable[[WorkItem], Row], WorkItem], Answer]


@contextmanager
def _where(method: Method, limit: float) -> Iterator[Ask]:
    """Where a method does its work."""
    if method.kind == "planner":
        yield lambda work, task: _PLANNING.call(work, task, limit)
    elif method.kind == "external":
        with Apart(silent=True, may_fork=True) as own:
            yield lambda work, task: own.call(work, task, limit)
    else:  # an episode has an end, and a network's numbers run nothing
        yield lambda work, task: Answer(work(task))


def compete(task: WorkItem) -> Row:
    """One method on one scene, judged. The row's `timing` alone differs from run to run, and what takes about
    as long as the limit. task: see `work_item`. Raises BenchmarkError where it is for other code."""
    method, scene = Method(**task["method"]), Scene.from_data(task["scene"])
    _check_same_code(method, task)
    row: Row = {
        "method": method.name,
        "run": method.run,
        **{name: task[name] for name in ("split", "split_version", "split_hash", "number")},
        "scene_hash": scene.hash,
        "code": task["code"],
        "certified": False,
        "reason": "",
        "detail": "",
        "max_strain": None,
        "required_friction": None,
        "clearance": None,
        "strain_limit": scene.limits.strain,
        "friction_limit": scene.limits.friction,
        "survival": None if task["survival"] is None else 0.0,
        "survival_draws": 0,
        "survival_judged": 0,
        "survival_undecided": 0,
        "firm_strain": None,
        "firm_part": None,
        "closed_loop": None,
        "evaluations": 0,
        "decisions": 0,
        "transfer": None,
    }
    with _where(method, task["limit"]) as ask:
        handed = _handed(ask(hand_in, task), task["limit"])
        if method.kind in ACT and handed.decisions:
            row["transfer"] = _also(ask, transferred, task, "transfer") if task["transfer"] else None
            row["closed_loop"] = _also(ask, played_on_draws, task, "closed_loop") if task["played"] else None
    row |= {"reason": handed.reason, "detail": handed.detail}
    row |= {"evaluations": handed.evaluations, "decisions": handed.decisions}
    if handed.grasp is not None and handed.path is not None:
        row |= _judged(scene, handed.grasp, handed.path, task)
    ended = handed.reason in ("raised", "died")  # which says nothing of how long it takes
    row["timing"] = {
        "seconds": None if ended else handed.seconds,
        "decision_seconds": handed.decision_seconds,
    }
    return row


def _check_same_code(method: Method, task: WorkItem) -> None:
    """Rows are kept by the code that made them: a cluster that was not updated, or sources that were changed
    during the run, would make others."""
    if task["code"] not in ("", code_version()):
        raise BenchmarkError(f"a worker runs retract {code_version()}, the work is for {task['code']}")
    if method.kind == "external" and found_at(method.name, Path(method.folder))[1] != method.content:
        raise BenchmarkError(
            f"{method.name}: its files have changed since the run began; start again, with its rows anew"
        )


def _handed(answer: Answer, limit: float) -> HandedIn:
    if answer.trouble:
        return HandedIn(reason=answer.trouble, detail=answer.detail, seconds=limit)
    return HandedIn.from_json(answer.value)


def _also(ask: Ask, work: Callable[[WorkItem], Row], task: WorkItem, name: str) -> Any:
    """What else a policy is asked for: what came of it, or what went wrong. None where it has no answer."""
    answer = ask(work, task)
    if answer.trouble:
        return answer.trouble if name == "transfer" else 0.0
    return answer.value[name]


def _judged(scene: Scene, grasp: Grasp, path: JawPath, task: WorkItem) -> Row:
    """What the certifier says, and what the plan survives."""
    try:
        judged = certify(scene, grasp, path, task["resolution"])
    except ValueError as problem:  # off the flap, not from there, or nothing that can be meshed
        return {"reason": "returned", "detail": str(problem)}
    row: Row = {
        "certified": judged.certified,
        "reason": judged.reason,
        "max_strain": judged.max_strain,
        "required_friction": min(judged.required_friction, 1e9),  # JSON has no infinity
        "clearance": judged.clearance,
    }
    if task["survival"] is None or not judged.certified:
        return row
    return row | _survival(scene, grasp, path, judged, task)


def _survival(scene: Scene, grasp: Grasp, path: JawPath, judged: Certificate, task: WorkItem) -> Row:
    """What a plan survives, and its strain where it is held as firmly as nearly everything asks for."""
    asked = task["survival"]
    z = draws(asked["draws"], asked["seed"] + task["number"])
    found = survived(scene, grasp, path, judged.history, z, asked["judged"])
    row: Row = {
        "survival": found.share,
        "survival_draws": found.draws,
        "survival_judged": found.judged,
        "survival_undecided": found.undecided,
    }
    if found.share >= ENOUGH:
        return row | {"firm_part": 1.0, "firm_strain": judged.max_strain}
    firm = made_firm(scene, grasp, path, judged.history, z, asked["judged"], task["resolution"])
    return row if firm is None else row | {"firm_part": firm[0], "firm_strain": firm[1]}
