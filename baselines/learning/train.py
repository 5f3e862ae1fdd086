"""Training: one loop for all algorithms, in legs that end with an evaluation and a checkpoint.

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
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from baselines.jobs.files import write_json, written_whole
from baselines.learning.agents import Agent
from baselines.learning.checkpoints import CheckpointError, read_checkpoint, write_checkpoint
from baselines.learning.cloning import Cloner
from baselines.learning.demos import load_demos
from baselines.learning.envs import judge, make_envs
from baselines.learning.policies import Policy, load_policy, save_policy
from baselines.learning.recipe import BC, Recipe
from retract_env.errors import ConfigError

RUN, CHECKPOINT, CURVE, POLICY, LOG = "run.json", "checkpoint.pt", "curve.csv", "policy", "tensorboard"

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

    def to_json(self) -> dict[str, Any]:
        """Plain data; `hash` is that of all that decides the result."""
        data = {
            "recipe": self.recipe.dump(),
            "seed": self.seed,
            "envs": self.envs,
            "scenes": list(self.scenes),
            "start": self.start,
            "demos": self.demos,
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
        run = Run(recipe=Recipe.from_data(data["recipe"]), **kept)
    except FileNotFoundError:
        raise RunError(f"{folder}: holds no training run") from None
    except (OSError, json.JSONDecodeError, KeyError, TypeError) as error:
        raise RunError(f"{file}: not readable as a training run: {error}") from None
    if run.to_json()["hash"] != data.get("hash"):
        raise RunError(f"{file}: its content does not match its hash")
    return run


def train(run: Run, folder: Path, on_progress: OnProgress = lambda _: None) -> Policy:
    """Train to the end, from the checkpoint in the folder if there is one; returns the best policy.

    Raises RecipeError, DemosError, PolicyError, CheckpointError, OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    envs = make_envs(run.recipe, run.envs)
    try:
        agent = _agent(run, folder, envs)
        curve, best = _resumed(run, agent, folder)
        if not curve:
            with written_whole(folder / RUN) as temporary:
                write_json(temporary, run.to_json())
            if run.start is not None:
                agent.begin_from(load_policy(run.start))
        return _legs(run, folder, agent, curve, best, on_progress)
    finally:
        envs.close()


def _legs(
    run: Run,
    folder: Path,
    agent: Agent,
    curve: list[dict[str, Any]],
    best: float,
    on_progress: OnProgress,
) -> Policy:
    total = run.recipe.steps
    last = curve[-1] if curve else None
    while agent.steps < total:
        begin = time.perf_counter()
        steps = min(run.recipe.evaluation.every, total - agent.steps)
        agent.learn(steps, partial(_told, on_progress, total, last))
        policy = agent.policy()
        last = _judged(run, agent, policy)
        earlier = curve[-1]["seconds"] if curve else 0.0
        last["seconds"] = round(earlier + time.perf_counter() - begin, 1)
        curve.append(last)
        agent.record({f"validation/{k}": v for k, v in last.items() if k not in ("steps", "seconds")})
        if last["quality"] > best or len(curve) == 1:
            best = last["quality"]
            save_policy(_described(run, policy, curve), folder / POLICY)
        _write_curve(folder / CURVE, curve)
        write_checkpoint(
            folder / CHECKPOINT,
            {"run": run.to_json()["hash"], "agent": agent.state(), "curve": curve, "best": best},
        )
        on_progress(Progress(agent.steps, total, last))
    kept = load_policy(folder / POLICY)
    kept = replace(kept, training={**kept.training, "curve": curve})  # what came after it too
    save_policy(kept, folder / POLICY)
    return kept


def _told(on_progress: OnProgress, total: int, last: Mapping[str, Any] | None, done: int) -> None:
    on_progress(Progress(done, total, last))


def _agent(run: Run, folder: Path, envs: Any) -> Agent:
    if isinstance(run.recipe.learner, BC):
        demos = load_demos(run.recipe.learner.dataset, run.demos)
        return Cloner(run.recipe, envs, run.seed, demos, folder / LOG)
    return Agent(run.recipe, envs, run.seed, folder / LOG)


def _resumed(run: Run, agent: Agent, folder: Path) -> tuple[list[dict[str, Any]], float]:
    """Bring the agent to the last checkpoint; its curve and best quality, if there is one."""
    file = folder / CHECKPOINT
    if not file.exists():
        return [], -np.inf
    state = read_checkpoint(file)
    if state.get("run") != run.to_json()["hash"]:
        raise CheckpointError(f"{file}: belongs to another run than {folder / RUN}")
    try:
        agent.restore(state["agent"])
        return list(state["curve"]), float(state["best"])
    except (KeyError, ValueError, TypeError, RuntimeError) as error:
        raise CheckpointError(f"{file}: not of this agent: {str(error).splitlines()[0]}") from None


def _judged(run: Run, agent: Agent, policy: Policy) -> dict[str, Any]:
    """A line of the curve. Its quality is the mean of 1 - strain / limit where it succeeds, 0 elsewhere."""
    outcomes = judge(agent.envs, policy, run.scenes)
    good = [o for o in outcomes if o["success"]]
    return {
        "steps": agent.steps,
        "success": len(good) / len(outcomes),
        "quality": float(sum(1 - o["strain"] for o in good)) / len(outcomes),
        "strain": float(np.mean([o["strain"] for o in good])) if good else 1.0,
        "total": float(np.mean([o["total"] for o in outcomes])),
        "length": float(np.mean([o["steps"] for o in outcomes])),
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
