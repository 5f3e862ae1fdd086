"""One method on one scene, judged: the work of the benchmark, for `run_tasks`.

The certifier judges all alike. Planners work in a process beside this one, which is ended where they take
longer than the limit; a method from elsewhere in a fresh one for each scene, where it may do what it likes
and loses no row but its own. What that one hands in may take the certifier for ever, too, so that it is
judged beside this process and within a limit.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from baselines.benchmark.attempts import NOTHING_FOUND, HandedIn, hand_in, played_on_draws, transferred
from baselines.benchmark.external import check_importable, found_at
from baselines.benchmark.methods import Method, method_of
from baselines.benchmark.splits import BenchmarkError
from baselines.benchmark.survival import made_firm, survived
from baselines.jobs.apart import STARTING, Answer, Apart, in_one_line
from baselines.jobs.journal import Row, WorkItem
from baselines.jobs.version import code_version
from planners.certify import Certificate, certify
from retract_env.errors import Diverged, MeshError
from retract_env.grasp import Grasp, JawPath
from retract_env.scenarios import draws
from retract_env.scene import Scene

TROUBLES = ("time", "raised", "returned", "died")
"""Why nothing that a method handed in could be judged: it took too long, raised, returned nonsense, or its
process died."""
REASONS = (*NOTHING_FOUND, *TROUBLES)
"""Why a row is not certified."""
ACT = ("policy", "external")
"""Kinds of methods that may be policies, and are then played on the other physics and on draws too."""

JUDGING = 3600.0
"""s, at most, until a plan from elsewhere is judged, draws included; those of our planners take minutes."""

_BESIDE = Apart()
"""Where our own code works that may take too long: planners, and the judge of what comes from elsewhere."""
atexit.register(_BESIDE.close)

Ask = Callable[[Callable[[Any], Any], Any, float], Answer]
"""For a piece of work on a task, within a limit, s."""


@contextmanager
def _where(method: Method) -> Iterator[Ask]:
    """Where a method does its work."""
    if method.kind == "planner":
        yield _BESIDE.call
    elif method.kind == "external":
        with Apart(silent=True, may_fork=True) as own:
            yield own.call
    else:
        yield _here


def _here(work: Callable[[Any], Any], task: Any, _: float) -> Answer:
    """In this process, without a limit: an episode has an end, and a network's numbers run nothing.

    A flap that the physics cannot take costs its own row alone.
    """
    try:
        return Answer(work(task))
    except (MeshError, Diverged) as error:
        return Answer(trouble="raised", detail=in_one_line(error))


def compete(task: WorkItem) -> Row:
    """One method on one scene, judged. The row's `timing` alone differs from run to run, and what takes about
    as long as the limit. task: see `work_item`. Raises BenchmarkError where it is for other code, ApartError
    where no process can be begun for it."""
    method, scene = method_of(task), Scene.from_data(task["scene"])
    _check_same_code(task["code"])
    _check_same_method(method)
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
    with _where(method) as ask:
        _checked(ask(_check_there, task, STARTING))
        handed = _handed(ask(hand_in, task, task["limit"]), task["limit"])
        row |= {"reason": handed.reason, "detail": handed.detail}
        if method.kind in ACT and handed.decisions:
            if task["transfer"]:
                _also(row, ask, transferred, task)
            if task["played"]:
                _also(row, ask, played_on_draws, task)
    row |= {"evaluations": handed.evaluations, "decisions": handed.decisions}
    if handed.grasp is not None and handed.path is not None:
        found = _judged_beside(handed, task) if method.kind == "external" else _verdict_on(handed, task)
        row |= found | {"detail": "; ".join(filter(None, (found.get("detail"), row["detail"])))}
    ended = handed.reason in ("raised", "died")  # which says nothing of how long it takes
    row["timing"] = {
        "seconds": None if ended else handed.seconds,
        "decision_seconds": handed.decision_seconds,
    }
    return row


def _check_same_code(code: str) -> None:
    """Rows are kept by the code that made them: a cluster that was not updated, or sources that were changed
    during the run, would make others. Raises BenchmarkError."""
    if code not in ("", code_version()):
        raise BenchmarkError(f"a worker runs retract {code_version()}, the work is for {code}")


def _check_same_method(method: Method) -> None:
    """Likewise for the files of a method from elsewhere."""
    if method.kind == "external" and found_at(method.name, Path(method.folder))[1] != method.content:
        raise BenchmarkError(
            f"{method.name}: its files have changed since the run began; start again, with its rows anew"
        )


def _check_there(task: WorkItem) -> None:
    """All of that where a method is about to work: a process has the sources as they were when it began."""
    method = method_of(task)
    _check_same_code(task["code"])
    _check_same_method(method)
    if method.kind == "external":
        check_importable(method.name, Path(method.folder))


def _checked(answer: Answer) -> None:
    """What another process says of such a check. Raises BenchmarkError."""
    if answer.trouble:
        raise BenchmarkError(f"a process for the benchmark: {answer.trouble} {answer.detail}")


def _handed(answer: Answer, limit: float) -> HandedIn:
    if answer.trouble:
        return HandedIn(reason=answer.trouble, detail=answer.detail, seconds=limit)
    return HandedIn.from_json(answer.value)


def _also(row: Row, ask: Ask, work: Callable[[WorkItem], Row], task: WorkItem) -> None:
    """Ask what else a policy is asked for, within a limit of its own; what went wrong is a failure there, and
    told in the row's detail."""
    answer = ask(work, task, task["limit"])
    if not answer.trouble:
        row |= answer.value
        return
    name, failed = ("transfer", answer.trouble) if work is transferred else ("closed_loop", 0.0)
    said = f"{name.replace('_', ' ')}: {answer.trouble} {answer.detail}"
    row |= {name: failed, "detail": "; ".join(filter(None, (row["detail"], said)))}


def _judged_beside(handed: HandedIn, task: WorkItem) -> Row:
    """`_verdict_on`, in the other process. What cannot be judged there within the limit is not certified."""
    _checked(_BESIDE.call(_check_same_code, task["code"], STARTING))
    answer = _BESIDE.call(_verdict_there, {"handed": handed.to_json(), "task": task}, JUDGING)
    if answer.trouble:
        return {"reason": "returned", "detail": f"the certifier: {answer.trouble} {answer.detail}"}
    row: Row = answer.value
    return row


def _verdict_there(asked: Mapping[str, Any]) -> Row:
    return _verdict_on(HandedIn.from_json(asked["handed"]), asked["task"])


def _verdict_on(handed: HandedIn, task: WorkItem) -> Row:
    """What the certifier says of what was handed in, and what the plan survives."""
    scene, grasp, path = Scene.from_data(task["scene"]), handed.grasp, handed.path
    assert grasp is not None and path is not None
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
    if found.nearly_all:
        return row | {"firm_part": 1.0, "firm_strain": judged.max_strain}
    firm = made_firm(scene, grasp, path, judged.history, z, asked["judged"], task["resolution"])
    return row if firm is None else row | {"firm_part": firm[0], "firm_strain": firm[1]}
