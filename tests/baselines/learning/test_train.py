"""Training: each algorithm learns, a killed run ends as it would have, and nothing foreign is read."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("sb3_contrib")
pytest.importorskip("tensorboard")

from baselines.jobs.version import PACKAGES
from baselines.learning import train
from baselines.learning.agents import Agent, _Watch
from baselines.learning.checkpoints import MAGIC, CheckpointError, read_checkpoint, write_checkpoint
from baselines.learning.envs import judge, make_envs
from baselines.learning.fields import RecipeError
from baselines.learning.policies import TENSORS, Policy, PolicyError, load_policy, save_policy
from baselines.learning.vec_env import BatchVecEnv
from retract_env.errors import SceneError
from retract_env.task import HIGH, LOW, SIZE, default_scene
from retract_env.task.config import Weights
from retract_env.task.rules import FAILURES
from tests.baselines.trained import easy_scene, recipe

ROOT = Path(__file__).resolve().parents[3]
TINY: dict[str, dict[str, Any]] = {
    "ppo": {"rollout": 16, "batch_size": 8, "epochs": 2},
    "sac": {"warmup": 8, "batch_size": 8, "buffer": 40},
    "tqc": {"warmup": 8, "batch_size": 8, "buffer": 40},
    "ppo_lagrangian": {"rollout": 16, "batch_size": 8, "epochs": 2},
}
"""Runs of 48 steps, with checkpoints after 16, 32 and 48; the replay buffers run over."""


def tiny(algorithm: str, **changes: Any) -> train.Run:
    return replace(train.Run(recipe(algorithm, 48, 16, **TINY[algorithm]), 0, 1, [None]), **changes)


class Stop(Exception):
    pass


def stopped_after(steps: int) -> Callable[[train.Progress], None]:
    """Stops a run in the middle of the leg that begins there."""

    def told(progress: train.Progress) -> None:
        if progress.steps >= steps + 5:
            raise Stop

    return told


def outcome(folder: Path) -> tuple[Any, bytes]:
    """The last state of all that was learned, and the policy's tensors."""
    state = read_checkpoint(folder / train.CHECKPOINT)
    del state["seconds"]
    for line in state["curve"]:
        del line["seconds"]
    return plain(state), (folder / train.POLICY / TENSORS).read_bytes()


def plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value.numpy().tobytes() if hasattr(value, "numpy") else value


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Uninterrupted runs."""
    done: dict[str, Path] = {}

    def run(algorithm: str) -> Path:
        if algorithm not in done:
            done[algorithm] = tmp_path_factory.mktemp(algorithm)
            train.train(tiny(algorithm), done[algorithm])
        return done[algorithm]

    return run


@pytest.mark.parametrize("algorithm", ["ppo", "ppo_lagrangian", "sac"])
def test_a_run_that_stopped_ends_as_it_would_have(
    tmp_path: Path, whole: Callable[[str], Path], algorithm: str
) -> None:
    """To the last bit of weights, optimisers, replay buffer and normalisation."""
    with pytest.raises(Stop):
        train.train(tiny(algorithm), tmp_path, stopped_after(16))
    assert read_checkpoint(tmp_path / train.CHECKPOINT)["agent"]["steps"] == 16
    train.train(train.open_run(tmp_path), tmp_path)
    assert outcome(tmp_path) == outcome(whole(algorithm))


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_a_run_that_stopped_between_evaluations_ends_as_it_would_have(tmp_path: Path, algorithm: str) -> None:
    """From a checkpoint that the recipe asks for before the first evaluation."""
    run = replace(tiny(algorithm), recipe=recipe(algorithm, 48, 32, 16, **TINY[algorithm]))
    stopped, whole = tmp_path / "stopped", tmp_path / "whole"
    with pytest.raises(Stop):
        train.train(run, stopped, stopped_after(16))
    state = read_checkpoint(stopped / train.CHECKPOINT)
    assert state["agent"]["steps"] == 16 and state["curve"] == []
    train.train(train.open_run(stopped), stopped)
    train.train(run, whole)
    assert outcome(stopped) == outcome(whole)
    assert [line["steps"] for line in read_checkpoint(whole / train.CHECKPOINT)["curve"]] == [32, 48]


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"start": "nope"}, PolicyError),
        ({"demos": 3}, RecipeError),
        ({"start": "bc-0"}, RecipeError),  # another network
    ],
)
def test_a_run_that_cannot_begin_leaves_nothing(
    tmp_path: Path, change: dict[str, Any], error: type[Exception]
) -> None:
    with pytest.raises(error):
        train.train(tiny("ppo", **change), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        ("nowhere.yaml", r"nowhere\.yaml"),
        (default_scene().dump() | {"material": {"law": "fung", "stiffening": 4.0}}, "on a planar rod"),
    ],
    ids=["not there", "of another law"],
)
def test_a_scene_that_cannot_be_had_is_refused_before_anything_is_made(
    scene: object, said: str, tmp_path: Path
) -> None:
    run = tiny("ppo")
    data = run.recipe.dump() | {"task": {"physics": "rod", "scene": scene}}
    with pytest.raises(SceneError, match=said):
        train.train(replace(run, recipe=type(run.recipe).from_data(data)), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_logs_say_what_became_of_episodes(whole: Callable[[str], Path]) -> None:
    """Shares of each failure, and the reward by its terms: means over episodes."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log = EventAccumulator(str(whole("sac") / train.LOG)).Reload()
    tags = set(log.Tags()["scalars"])
    assert {f"rewards/{term}" for term in Weights.model_fields} <= tags
    shares = {tag: [event.value for event in log.Scalars(tag)] for tag in tags if tag.startswith("failures/")}
    assert set(shares) == {f"failures/{reason}" for reason in (*filter(None, FAILURES), "not_visible")}
    assert all(0 <= sum(values) <= 1 + 1e-6 for values in zip(*shares.values(), strict=True))


def test_torch_threads_are_set_in_one_place() -> None:
    sources = [file.read_text("utf-8") for folder in PACKAGES for file in (ROOT / folder).rglob("*.py")]
    assert sum(source.count("set_num_threads(") for source in sources) == 1


def test_a_run_leaves_what_it_says(whole: Callable[[str], Path]) -> None:
    folder = whole("ppo")
    assert {file.name for file in folder.iterdir()} == {
        train.RUN,
        train.CHECKPOINT,
        train.CURVE,
        train.POLICY,
        train.LOG,
    }
    assert list((folder / train.LOG).glob("events.out.tfevents.*"))
    lines = (folder / train.CURVE).read_text().splitlines()
    assert lines[0].startswith("steps,success,strain,quality")
    assert [line.split(",")[0] for line in lines[1:]] == ["16", "32", "48"]
    policy = load_policy(folder / train.POLICY)
    assert policy.training["recipe"]["algorithm"] == "ppo" and policy.training["seed"] == 0
    curve = policy.training["curve"]
    assert [line["steps"] for line in curve] == [16, 32, 48]
    assert policy.scores["validation"] in curve
    assert policy.scores["validation"]["quality"] == max(line["quality"] for line in curve)


def test_another_seed_is_another_run(tmp_path: Path, whole: Callable[[str], Path]) -> None:
    train.train(tiny("ppo", seed=1), tmp_path)
    assert outcome(tmp_path)[1] != outcome(whole("ppo"))[1]


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "tqc"])
def test_the_policy_that_is_shipped_acts_as_the_agent(algorithm: str) -> None:
    """Normalisation, network and squashing are those of Stable-Baselines3."""
    envs = make_envs(recipe(algorithm, 48, 16, **TINY[algorithm]), 1)
    agent = Agent(recipe(algorithm, 48, 16, **TINY[algorithm]), envs, 0)
    rng = np.random.default_rng(0)
    agent.stats.update(rng.uniform(LOW, HIGH, (50, SIZE)))
    policy = agent.policy()
    for seen in rng.uniform(LOW, HIGH, (20, SIZE)).astype(np.float32):
        wanted, _ = agent.model.predict(envs.normalize_obs(seen), deterministic=True)
        assert policy(seen) == pytest.approx(wanted, abs=1e-5)
    envs.close()


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "tqc"])
def test_an_agent_begins_as_the_policy_that_it_is_given(algorithm: str, tmp_path: Path) -> None:
    output = "clip" if algorithm == "ppo" else "tanh"
    activation = "tanh" if algorithm == "ppo" else "relu"
    given = _policy((64, 64), output=output, activation=activation)
    envs = make_envs(recipe(algorithm, 48, 16, **TINY[algorithm]), 1)
    agent = Agent(recipe(algorithm, 48, 16, **TINY[algorithm]), envs, 0)
    agent.begin_from(given)
    rng = np.random.default_rng(0)
    for seen in rng.uniform(LOW, HIGH, (20, SIZE)).astype(np.float32):
        assert agent.policy()(seen) == pytest.approx(given(seen), abs=1e-4)
    with pytest.raises(RecipeError, match=r"^network: layers, activation and output "):
        agent.begin_from(_policy((64, 32), output=output, activation=activation))
    envs.close()


def _policy(sizes: tuple[int, ...], **changes: Any) -> Policy:
    from tests.baselines.trained import policy

    return policy(0, sizes, **changes)


def test_while_the_critic_alone_learns_the_policy_stays(tmp_path: Path) -> None:
    save_policy(_policy((64, 64)), tmp_path / "begin")
    changes = TINY["ppo"] | {"critic_first": 1000}
    run = train.Run(recipe("ppo", 32, 16, **changes), 0, 1, [None], start=str(tmp_path / "begin"))
    after = train.train(run, tmp_path / "run")
    assert after.name == "toy+ppo"
    for mine, theirs in zip(after.weights, _policy((64, 64)).weights, strict=True):
        assert np.array_equal(mine, theirs)


def damage(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


class Harm:
    """What a pickle may hide."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return exec, ("raise SystemExit('code was run')",)


def hidden_harm(file: Path) -> None:
    import hashlib

    data = pickle.dumps(Harm(), protocol=2)
    file.write_bytes(MAGIC + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (damage, "corrupted, its content does not match its hash"),
        (lambda file: file.write_bytes(file.read_bytes()[:-100]), "corrupted, its content does not match"),
        (lambda file: file.write_bytes(b"PK\x03\x04 something else"), "not a checkpoint of retract"),
        (lambda file: file.write_bytes(b""), "not a checkpoint of retract"),
        (hidden_harm, "not readable: "),
        (lambda file: write_checkpoint(file, {"run": "x"}), "belongs to another run than "),
    ],
)
def test_a_corrupted_or_foreign_checkpoint_is_refused(
    tmp_path: Path, whole: Callable[[str], Path], harm: Callable[[Path], Any], message: str
) -> None:
    file = tmp_path / train.CHECKPOINT
    file.write_bytes((whole("ppo") / train.CHECKPOINT).read_bytes())
    harm(file)
    with pytest.raises(CheckpointError) as caught:
        train.train(tiny("ppo"), tmp_path)
    assert f"{train.CHECKPOINT}: {message}" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b'{"recipe": 3}', b'{"seed": 0}', b"\xff\xfe{", b"[" * 200_000],
    ids=lambda content: repr(content[:12]),
)
def test_a_folder_without_a_sound_run_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(train.RunError, match=r"holds no training run$"):
        train.open_run(tmp_path)
    (tmp_path / train.RUN).write_bytes(content)
    with pytest.raises(train.RunError, match=r"run\.json: not readable as a training run: "):
        train.open_run(tmp_path)


@pytest.mark.parametrize(
    ("algorithm", "steps", "settings"),
    [
        ("ppo", 4096, {"rollout": 16}),
        ("ppo_lagrangian", 4096, {"rollout": 16}),
        ("sac", 2048, {"updates": 8}),
        ("tqc", 2048, {"updates": 8}),
    ],
)
def test_each_algorithm_learns_to_lift(
    tmp_path: Path, algorithm: str, steps: int, settings: dict[str, Any]
) -> None:
    """An untrained policy hardly moves; within seconds each learns to bring the target into view."""
    run = train.Run(recipe(algorithm, steps, steps // 4, **settings), 0, 16, [None])
    envs = make_envs(run.recipe, 16)
    untrained = Agent(run.recipe, envs, 0).policy()
    before = judge(envs, untrained, [None])[0]
    envs.close()
    assert not before["success"]
    trained = train.train(run, tmp_path)
    assert trained.scores["validation"]["success"] == 1


@pytest.mark.slow
def test_killed_with_several_environments_it_ends_as_it_would_have(tmp_path: Path) -> None:
    """SIGKILL to the whole console command, in its own processes."""
    import yaml

    config = tmp_path / "recipe.yaml"
    config.write_text(yaml.safe_dump(recipe("ppo", 96, 32, **TINY["ppo"]).dump()))
    console = "import sys; from baselines.cli.app import main; sys.exit(main())"
    command = [sys.executable, "-c", console, "train", "ppo"]
    new = [*command, "--config", str(config), "--envs", "2"]
    killed, undisturbed = tmp_path / "killed", tmp_path / "undisturbed"
    process = subprocess.Popen([*new, "--out", str(killed)], cwd=ROOT, start_new_session=True)
    deadline = time.monotonic() + 300
    while not (killed / train.CHECKPOINT).exists():
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert read_checkpoint(killed / train.CHECKPOINT)["agent"]["steps"] < 96
    subprocess.run([*command, "--resume", "--out", str(killed)], cwd=ROOT, check=True)
    subprocess.run([*new, "--out", str(undisturbed)], cwd=ROOT, check=True)
    assert outcome(killed) == outcome(undisturbed)


def test_the_easy_scene_is_one() -> None:
    from retract_env.scene import Scene

    assert Scene.from_data(easy_scene()).limits.friction == 5.0


def test_rods_are_trained_side_by_side_and_a_run_that_stopped_ends_as_it_would_have(tmp_path: Path) -> None:
    """In one process, as many as the run says; judged and kept as on any other physics."""
    data = recipe("ppo", 96, 32, **TINY["ppo"]).dump()
    data["task"] |= {"physics": "rod", "scene": "random", "grasp": "agent"}
    scenes = [easy_scene(), default_scene().dump()]
    run = train.Run(type(recipe("ppo", 96, 32)).from_data(data), 0, 2, scenes)
    stopped, whole = tmp_path / "stopped", tmp_path / "whole"
    with pytest.raises(Stop):
        train.train(run, stopped, stopped_after(32))
    train.train(train.open_run(stopped), stopped)
    policy = train.train(run, whole)
    assert outcome(stopped) == outcome(whole)
    assert policy.env["id"] == "TissueRetractRod-v0"
    assert [line["steps"] for line in policy.training["curve"]] == [32, 64, 96]
    envs = make_envs(run.recipe, 3)
    assert isinstance(envs.unwrapped, BatchVecEnv) and envs.num_envs == 3
    envs.close()


def test_logs_are_means_over_all_episodes_of_a_line() -> None:
    """However many are over in one step."""
    from stable_baselines3.common.logger import Logger

    watch = _Watch(lambda _: None, recipe("ppo", 48, 16).learner, Counter())
    watch.model = SimpleNamespace(logger=Logger(None, []))  # type: ignore[assignment]
    infos = [{"is_success": k == 0, "failure": "", "episode_terms": {"strain": float(k)}} for k in range(4)]
    for ended in (infos[:1], infos[1:]):
        watch._log(ended)
    assert watch.logger.name_to_value["rewards/strain"] == pytest.approx(1.5)
    assert watch.logger.name_to_value["failures/not_visible"] == pytest.approx(0.75)
    watch.logger.dump()
    watch._log(infos[2:])
    assert watch.logger.name_to_value["rewards/strain"] == pytest.approx(2.5)
