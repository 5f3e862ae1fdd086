"""Shipped policies: the same actions after a round trip, and anything else refused without being run."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.benchmark.contest import compete
from baselines.benchmark.methods import Method, work_item
from baselines.learning.policies import JSON, TENSORS, PolicyError, load_policy, save_policy, shipped
from retract_env.task import HIGH, LOW, SIZE, SIZES, default_scene
from tests.baselines.trained import policy


def observations(count: int) -> Any:
    rng = np.random.default_rng(5)
    return rng.uniform(LOW, HIGH, (count, SIZE)).astype(np.float32)


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("output", ["clip", "tanh"])
def test_a_round_trip_keeps_every_bit(tmp_path: Path, activation: str, output: str) -> None:
    before = policy(activation=activation, output=output)
    save_policy(before, tmp_path / "it")
    after = load_policy(tmp_path / "it")
    for seen in observations(20):
        action = before(seen)
        assert np.array_equal(action, after(seen))
        assert action.dtype == np.float32 and np.abs(action).max() <= 1
    assert (after.name, after.env, after.training) == (before.name, before.env, before.training)


def test_it_computes_what_torch_computes() -> None:
    torch = pytest.importorskip("torch")
    mine = policy(sizes=(16, 16))
    layers: list[Any] = []
    for weight, bias in zip(mine.weights, mine.biases, strict=True):
        layer = torch.nn.Linear(*weight.shape[::-1])
        with torch.no_grad():
            layer.weight.copy_(torch.from_numpy(weight))
            layer.bias.copy_(torch.from_numpy(bias))
        layers += [layer, torch.nn.Tanh()]
    net = torch.nn.Sequential(*layers[:-1])
    for seen in observations(20):
        normal = np.clip((seen - mine.mean) / mine.deviation, -10, 10)
        wanted = net(torch.from_numpy(normal)).detach().numpy().clip(-1, 1)
        assert mine(seen) == pytest.approx(wanted, abs=1e-5)


def test_pixels_are_not_understood() -> None:
    with pytest.raises(
        ValueError, match=r"^observation has shape \(96, 96, 3\), allowed that of obs='state'"
    ):
        policy()(np.zeros((96, 96, 3), np.uint8))


def change_json(folder: Path, **changes: Any) -> None:
    about = json.loads((folder / JSON).read_text())
    (folder / JSON).write_text(json.dumps(about | changes))


def change_training(folder: Path, **changes: Any) -> None:
    change_json(folder, training=policy().training | changes)  # type: ignore[operator]


class Harm:
    """What a pickle may hide."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return exec, ("raise SystemExit('code was run')",)


def flip_a_bit(folder: Path) -> None:
    data = bytearray((folder / TENSORS).read_bytes())
    data[-5] ^= 1
    (folder / TENSORS).write_bytes(data)


def test_a_policy_of_before_reads_the_numbers_that_it_knows() -> None:
    """Parts are added at the end alone, and a policy that is begun from heeds none of the new ones."""
    before = policy()
    first = before.weights[0][:, : SIZES[0]]
    old = replace(
        before,
        weights=(first, *before.weights[1:]),
        mean=before.mean[: SIZES[0]],
        deviation=before.deviation[: SIZES[0]],
    )
    wide = old.widened()
    assert len(old.mean) == SIZES[0] and len(wide.mean) == SIZE
    for seen in observations(5):
        other = seen.copy()
        other[SIZES[0] :] = 0
        assert np.array_equal(old(seen), old(other))
        assert wide(seen) == pytest.approx(old(seen), abs=1e-5)
        assert wide(other) == pytest.approx(old(seen), abs=1e-5)
    with pytest.raises(PolicyError, match=r"from 108 to 3 numbers, allowed 107 or 111 to 3$"):
        policy(
            weights=(np.zeros((3, 108), np.float32),),
            biases=(np.zeros(3, np.float32),),
            mean=np.zeros(108, np.float32),
            deviation=np.ones(108, np.float32),
        )


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda f: (f / JSON).unlink(), "policy.json: no such file or directory"),
        (lambda f: (f / TENSORS).unlink(), "policy.safetensors: no such file or directory"),
        (lambda f: (f / JSON).write_text("{"), "policy.json: not readable as JSON"),
        (lambda f: (f / JSON).write_text("[1]"), "policy.json: not a policy of the format retract-policy-1"),
        (lambda f: (f / JSON).write_bytes(b"\xff\xfe"), "policy.json: not readable as JSON"),
        (lambda f: change_json(f, format="other"), "policy.json: not a policy of the format"),
        (lambda f: change_json(f, extra=1), "policy.json: extra: unknown key; known keys: format, name"),
        (lambda f: change_json(f, activation="gelu"), "policy.json: activation: Input should be 'tanh' or"),
        (lambda f: change_json(f, layers=[]), "policy.json: layers: "),
        (
            lambda f: change_json(f, layers=[[SIZE, 8], [8, 5], [5, 2]]),
            "policy.json: layers[2] = [5, 2]",
        ),
        (lambda f: change_json(f, clip="wide"), "policy.json: clip = 'wide', not a number"),
        (lambda f: change_json(f, clip=10**400), "policy.json: clip = 100000"),
        (lambda f: change_json(f, clip=float("nan")), "policy.json: not readable as JSON"),
        (lambda f: change_json(f, name=""), "policy.json: name = '', not a text"),
        (lambda f: change_json(f, tensors="0"), "policy.json: tensors: "),
        (lambda f: change_json(f, env={}), "policy.json: env.id: missing"),
        (
            lambda f: change_json(f, training={}),
            "policy.json: training.seed: missing; training.curve",
        ),
        (lambda f: change_training(f, seed="0"), "policy.json: training.seed = '0', not a number"),
        (
            lambda f: change_training(f, curve=[{"steps": 1}]),
            "policy.json: training.curve[0].success",
        ),
        (lambda f: change_training(f, curve=[]), "policy.json: training.curve: "),
        (lambda f: change_training(f, colour=1), "policy.json: training.colour: unknown key"),
        (lambda f: change_json(f, scores={"test": 3}), "policy.json: scores.test = 3, not a mapping"),
        (flip_a_bit, "policy.safetensors: not the tensors that policy.json was written with"),
        (
            lambda f: (f / TENSORS).write_bytes(pickle.dumps(Harm())),
            "policy.safetensors: not the tensors that policy.json was written with",
        ),
    ],
)
def test_what_is_corrupted_or_foreign_is_refused(
    tmp_path: Path, harm: Callable[[Path], Any], message: str
) -> None:
    save_policy(policy(), tmp_path)
    harm(tmp_path)
    with pytest.raises(PolicyError) as caught:
        load_policy(tmp_path)
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("foreign", [pickle.dumps(Harm()), b"", b"\x00" * 100, b"\xff" * 9])
def test_tensors_that_are_none_are_refused_even_under_their_own_hash(tmp_path: Path, foreign: bytes) -> None:
    import hashlib

    save_policy(policy(), tmp_path)
    (tmp_path / TENSORS).write_bytes(foreign)
    change_json(tmp_path, tensors=hashlib.sha256(foreign).hexdigest())
    with pytest.raises(PolicyError, match=r"policy\.safetensors: not readable as safetensors: "):
        load_policy(tmp_path)


def test_layers_must_follow_each_other() -> None:
    sound = policy()
    with pytest.raises(PolicyError, match=r"^policy: layers of shapes .* do not follow each other$"):
        policy(weights=sound.weights[::-1])
    with pytest.raises(PolicyError, match=r"^policy: weights, or the deviations"):
        policy(deviation=np.zeros(SIZE, np.float32))
    for count in (1, 5):
        with pytest.raises(
            PolicyError, match=rf"^policy: deviation of shape \({count},\), allowed \({SIZE},\)"
        ):
            policy(deviation=np.ones(count, np.float32))


def test_a_failed_write_leaves_the_policy_that_was_there(tmp_path: Path) -> None:
    save_policy(policy(0), tmp_path)
    broken = policy(1, scores={"validation": object()})
    with pytest.raises(PolicyError, match=r"^scores\.validation = <object object at .*, not a mapping"):
        save_policy(broken, tmp_path)
    assert np.array_equal(load_policy(tmp_path).mean, policy(0).mean)
    assert {file.name for file in tmp_path.iterdir()} == {JSON, TENSORS}


def test_shipped_policies_are_loaded_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = shipped()
    assert len(names) >= 3
    for name in names:
        mine = load_policy(name)
        assert mine.training["command"].startswith("retract train ")
        assert mine.scores["validation"] in mine.training["curve"]
        words = [*mine.training["command"].split(), mine.training["start"] or ""]
        assert not any(Path(word).is_absolute() for word in words)
    monkeypatch.chdir(tmp_path)  # what lies there comes first
    save_policy(policy(), tmp_path / names[0])
    assert load_policy(names[0]).name == "toy"
    with pytest.raises(PolicyError, match=r"policy\.json: no such file or directory"):
        load_policy("bc-1000")


def test_a_shipped_policy_exposes_the_target() -> None:
    """Of a flap that no training has seen, and within the limits, by the certifier's word."""
    row = compete(
        work_item(
            method=Method.trained(Path("bc-0")),
            scene=default_scene().dump(),
            resolution="coarse",
            lead_out=3,
        )
    )
    assert row["certified"], row["reason"]
    assert row["max_strain"] < 0.15  # the paper's planner needs 0.29
