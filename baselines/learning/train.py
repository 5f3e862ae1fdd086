"""Training: one loop for all algorithms, in legs that end with a checkpoint, some with an evaluation.

A run is a folder: run.json (recipe, seed, what it began from), checkpoint.pt, curve.csv, policy/ (the best
one so far on the validation split) and tensorboard/. A run that was killed goes on from its last checkpoint
and ends as it would have ended.
"""

from __future__ import annotations

import csv
import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from baselines.jobs.files import write_json, written_whole
from baselines.learning.agents import Agent
from baselines.learning.checkpoints import CheckpointError, read_checkpoint, write_checkpoint
from baselines.learning.envs import judge, make_envs, play_on_fem
from baselines.learning.fields import RecipeError
from baselines.learning.policies import Policy, content_of, load_policy, save_policy
from baselines.learning.recipe import Recipe
from retract_env.errors import ConfigError, FlapRefused
from retract_env.given import read_scene
from retract_env.mesh.jaws import jaw_range
from retract_env.physics.registry import PHYSICS

RUN, CHECKPOINT, CURVE, POLICY, LOG = "run.json", "checkpoint.pt", "curve.csv", "policy", "tensorboard"

BROKEN = ("strain", "slip", "release", "contact")
"""How episodes end in which a limit was broken."""

Scenes = Sequence[Mapping[str, Any] | None]


class RunError(ConfigError):
    """A folder that holds no run to go on with; the message is one line."""


@dataclass(frozen=True)
class Run:
    """What decides a training run, kept in run.json."""

    recipe: Recipe
    seed: int
    envs: int
    """environments side by side"""
    scenes: Scenes
    """plain data of those that it is judged on; None is the environment's own"""
    start: str | None = None
    """folder of the policy that it begins from"""
    demos: int | None = None
    """episodes of the data set that are learned from; None is all"""
    command: str = ""
    contents: Mapping[str, str] = field(default_factory=dict)
    """hashes of the policy and the data set that it names, `start` and `dataset`, once it has begun"""

    def to_json(self) -> dict[str, Any]:
        """Plain data; `hash` is that of all that decides the result."""
        data = {
            "recipe": self.recipe.dump(),
            "seed": self.seed,
            "envs": self.envs,
            "scenes": list(self.scenes),
            "start": self.start,
            "demos": self.demos,
            "contents": dict(self.contents),
        }
        text = json.dumps(data, sort_keys=True, separators=(",", ":"))
        return {**data, "command": self.command, "hash": hashlib.sha256(text.encode()).hexdigest()}


@dataclass(frozen=True)
class Progress:
    """How far a run has come."""

    steps: int
    total: int
    last: Mapping[str, Any] | None
    """the newest line of the curve"""


OnProgress = Callable[[Progress], None]


def open_run(folder: Path) -> Run:
    """The run that a folder holds. Raises RunError, or RecipeError."""
    file = folder / RUN
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        kept = {key: data[key] for key in ("seed", "envs", "scenes", "start", "demos", "command")}
        run = Run(recipe=Recipe.from_data(data["recipe"]), contents=dict(data["contents"]), **kept)
    except FileNotFoundError:
        raise RunError(f"{folder}: holds no training run") from None
    except RecipeError:
        raise
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        raise RunError(f"{file}: not readable as a training run: {error}") from None
    if run.to_json()["hash"] != data.get("hash"):
        raise RunError(f"{file}: its content does not match its hash")
    return run


@dataclass
class _Course:
    """How a run has gone so far; with the agent's state, all that a checkpoint holds."""

    curve: list[dict[str, Any]] = field(default_factory=list)
    best: float = -np.inf
    """quality of the policy that is kept"""
    seconds: float = 0.0


def train(run: Run, folder: Path, on_progress: OnProgress = lambda _: None) -> Policy:
    """Train to the end, from the checkpoint in the folder if there is one; returns the best policy.

    What cannot be trained is refused before anything is written. Raises RecipeError, DemosError, PolicyError,
    CheckpointError, RunError where what the run names has changed since it began, SceneError, ImportError for
    a physics that is not installed, OSError.
    """
    run = replace(run, recipe=with_its_scene(run.recipe))
    envs = make_envs(run.recipe, run.envs)
    try:
        module, _, name = run.recipe.learner.AGENT.partition(":")
        kind: type[Agent] = getattr(import_module(module), name)
        agent = kind.of(run.recipe, envs, run.seed, run.demos)
        run = _held_to(run, agent.contents)
        course = _resumed(run, agent, folder)
        if course is None:
            course = _Course()
            if run.start is not None:
                agent.begin_from(load_policy(run.start))
                run = _held_to(run, {"start": content_of(run.start)})
            folder.mkdir(parents=True, exist_ok=True)
            with written_whole(folder / RUN) as temporary:
                write_json(temporary, run.to_json())
        agent.log_to(folder / LOG)
        return _legs(run, folder, agent, course, on_progress)
    finally:
        envs.close()


def with_its_scene(recipe: Recipe) -> Recipe:
    """The recipe with its scene in the place of a file's name: a run goes on as it began, whatever becomes of
    the file.

    Raises SceneError, ImportError, or RecipeError for one whose environment cannot be made here.
    """
    settings = recipe.task
    kind = PHYSICS[settings.physics]
    resolution = settings.resolution or kind.resolution
    kind.check(resolution)
    scene = kind.accepted(read_scene(settings.scene))
    if isinstance(scene, str):
        return recipe
    try:
        kind.make(scene, sum(jaw_range(scene.tissue.length, scene.jaws.width)) / 2, resolution).close()
    except FlapRefused as error:
        raise RecipeError(f"task.scene: {error}") from None
    except ValueError:
        pass  # there; elsewhere it may be grasped
    data = recipe.dump()
    return Recipe.from_data(data | {"task": data["task"] | {"scene": scene.dump()}})


def _held_to(run: Run, contents: Mapping[str, str]) -> Run:
    """The run with the hashes of what it names. Raises RunError where it began with others."""
    for name, content in contents.items():
        if (begun := run.contents.get(name, content)) != content:
            raise RunError(f"{name}: its content is {content}, allowed {begun}, which the run began with")
    return replace(run, contents={**run.contents, **contents})


def _legs(run: Run, folder: Path, agent: Agent, course: _Course, on_progress: OnProgress) -> Policy:
    total, every = run.recipe.steps, run.recipe.evaluation.every
    leg = run.recipe.evaluation.checkpoint or every
    curve = course.curve
    last = curve[-1] if curve else None

    def told(done: int) -> None:
        on_progress(Progress(done, total, last))

    told(agent.steps)
    while agent.steps < total:
        begin, earlier = time.perf_counter(), course.seconds
        due = min((last["steps"] if last else 0) + every, total)
        agent.learn(min(leg, due - agent.steps), told)
        if agent.steps >= due:
            policy = agent.policy()
            last = _judged(run, agent, policy)
            last["seconds"] = round(earlier + time.perf_counter() - begin, 1)
            curve.append(last)
            shown = {k: v for k, v in last.items() if k not in ("steps", "seconds") and v is not None}
            agent.record({f"validation/{name}": value for name, value in shown.items()})
            if last["quality"] > course.best or len(curve) == 1:
                course.best = last["quality"]
                save_policy(_described(run, policy, curve), folder / POLICY)
            _write_curve(folder / CURVE, curve)
        course.seconds = earlier + time.perf_counter() - begin
        state = {"run": run.to_json()["hash"], "agent": agent.state(), **vars(course)}
        write_checkpoint(folder / CHECKPOINT, state)
        on_progress(Progress(agent.steps, total, last))
    kept = load_policy(folder / POLICY)
    kept = replace(kept, training={**kept.training, "curve": curve})  # what came after it too
    save_policy(kept, folder / POLICY)
    return kept


def _resumed(run: Run, agent: Agent, folder: Path) -> _Course | None:
    """Bring the agent to the last checkpoint, if there is one, and say how the run had gone."""
    file = folder / CHECKPOINT
    if not file.exists():
        return None
    state = read_checkpoint(file)
    if state.get("run") != run.to_json()["hash"]:
        raise CheckpointError(f"{file}: belongs to another run than {folder / RUN}")
    try:
        agent.restore(state["agent"])
        return _Course(list(state["curve"]), float(state["best"]), float(state["seconds"]))
    except (KeyError, ValueError, TypeError, RuntimeError) as error:
        raise CheckpointError(f"{file}: not of this agent: {str(error).splitlines()[0]}") from None


def _judged(run: Run, agent: Agent, policy: Policy) -> dict[str, Any]:
    """A line of the curve. Its quality is the mean of 1 - strain / limit where it succeeds, 0 elsewhere.

    `broken` is the share of episodes since the last checkpoint, exploration and all, that broke a limit; None
    where none ended, as none does in cloning. What begins with `fem_` is of the same policy on coarse finite
    elements, on the first of the scenes: `fem_gap` by how much of itself strain is greater there, on average,
    where it succeeds on both.
    """
    outcomes = judge(agent.envs, policy, run.scenes)
    good = [o for o in outcomes if o["success"]]
    ended = agent.ended.total()
    line = {
        "steps": agent.steps,
        **_summary(outcomes),
        "quality": float(sum(1 - o["strain"] for o in good)) / len(outcomes),
        "total": float(np.mean([o["total"] for o in outcomes])),
        "length": float(np.mean([o["steps"] for o in outcomes])),
        "broken": sum(agent.ended[reason] for reason in BROKEN) / ended if ended else None,
    }
    if run.recipe.task.physics != "fem" and run.recipe.evaluation.fem:
        beside = play_on_fem(policy, run.scenes[: run.recipe.evaluation.fem])
        line |= {f"fem_{name}": value for name, value in _summary(beside).items()}
        both = [
            f["strain"] / r["strain"]
            for f, r in zip(beside, outcomes, strict=False)
            if f["success"] and r["success"]
        ]
        line["fem_gap"] = float(np.mean(both)) - 1 if both else 0.0
    return line


def _summary(outcomes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Share of episodes that succeed, and their mean strain over its limit, 1 where none does."""
    strains = [o["strain"] for o in outcomes if o["success"]]
    return {
        "success": len(strains) / len(outcomes),
        "strain": float(np.mean(strains)) if strains else 1.0,
    }


def _described(run: Run, policy: Policy, curve: list[dict[str, Any]]) -> Policy:
    about = run.to_json()
    del about["scenes"]
    return replace(
        policy,
        training={**about, "steps": curve[-1]["steps"], "curve": curve},
        scores={"validation": curve[-1]},
    )


def _write_curve(path: Path, curve: list[dict[str, Any]]) -> None:
    with written_whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(curve[0]))
        writer.writeheader()
        writer.writerows(curve)
