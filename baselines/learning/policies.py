"""Trained policies as plain tensors and JSON: a folder with policy.json and policy.safetensors.

`load_policy` rebuilds the network in NumPy. Loading reads numbers and texts and never executes code; what is
corrupted or foreign is refused with a `PolicyError` of one line.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from baselines.jobs.files import write_json, written_whole
from retract_env.config import Frozen, Listed, Name, Range, brief, refusal, whole
from retract_env.errors import ConfigError
from retract_env.task import SIZE, SIZES, actions

Floats = NDArray[np.float32]

FORMAT: Literal["retract-policy-1"] = "retract-policy-1"
JSON, TENSORS = "policy.json", "policy.safetensors"
TRAINED = Path(__file__).parent / "trained"
"""Policies that come with the package, a folder each."""
MOST_BYTES = 64 * 2**20
"""A file larger than this is no policy of ours."""


class PolicyError(ConfigError):
    """A policy that cannot be used; the message is one line."""


class _Part(Frozen):
    """Constructors and `from_data` raise `PolicyError`."""

    error_type: ClassVar[type[ConfigError]] = PolicyError


def _plain(value: Any) -> Any:
    if not isinstance(value, dict):
        raise refusal(f" = {brief(value)}, not a mapping")
    return value


def _text(value: Any) -> Any:
    if not isinstance(value, str) or not value.isprintable() or len(value) > 10_000:
        raise refusal(f" = {brief(value)}, not a printable text of at most 10000 characters")
    return value


Text = Annotated[str, BeforeValidator(_text)]
Plain = Annotated[dict[str, Any], BeforeValidator(_plain)]
Whole = Annotated[int, whole(0, 2**53)]
Real = Annotated[float, Range(-1e9, 1e9)]
SHA256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _Judged(_Part):
    """A line of the curve."""

    steps: Whole
    success: Annotated[float, Range(0.0, 1.0)]
    quality: Real | None = None
    strain: Real | None = None
    total: Real | None = None
    length: Real | None = None
    broken: Annotated[float, Range(0.0, 1.0)] | None = None
    fem_success: Annotated[float, Range(0.0, 1.0)] | None = None
    fem_strain: Real | None = None
    fem_gap: Real | None = None
    seconds: Real | None = None


class _Training(_Part):
    """How it came about: what the benchmark asks for, and what a training run says besides."""

    seed: Whole
    curve: Annotated[tuple[_Judged, ...], Listed, Field(min_length=1)]
    command: Text | None = None
    recipe: Plain | None = None
    envs: Whole | None = None
    start: Text | None = None
    demos: Whole | None = None
    contents: Plain | None = None
    hash: SHA256 | None = None
    steps: Whole | None = None


class _Env(_Part):
    id: Name
    kwargs: Plain


class _About(_Part):
    """What policy.json says. Every field is checked when it is written and when it is read."""

    format: Literal["retract-policy-1"]
    name: Name
    layers: Annotated[
        tuple[tuple[Annotated[int, whole(1, 10**6)], Annotated[int, whole(1, 10**6)]], ...],
        Listed,
        Field(min_length=1, max_length=100),
    ]
    """(in, out) of each"""
    activation: Literal["tanh", "relu"]
    output: Literal["clip", "tanh"]
    clip: Annotated[float, Range(0.0, 1e6, "", "(]")]
    tensors: SHA256
    """of the other file"""
    env: _Env
    training: _Training
    scores: dict[str, _Judged]


@dataclass(frozen=True, eq=False)
class Policy:
    """A multilayer perceptron from the state observation to an action; plays in `rollout`.

    One that was trained when observations had fewer numbers reads the first ones of today's: parts are only
    ever added at the end.
    """

    name: str
    """The method's: policies that differ by their seed alone share it."""
    weights: tuple[Floats, ...]
    """(out, in) of each layer"""
    biases: tuple[Floats, ...]
    """(out,)"""
    mean: Floats
    """(n,) of the observations, n of `SIZES`"""
    deviation: Floats
    """(n,) likewise, positive"""
    clip: float
    """normalised observations are clipped to this"""
    activation: Literal["tanh", "relu"]
    output: Literal["clip", "tanh"]
    """what brings the last layer's numbers into [-1, 1]"""
    env: Mapping[str, Any] = field(default_factory=dict)
    """id and kwargs of the environment that it was trained in"""
    training: Mapping[str, Any] = field(default_factory=dict)
    """seed and curve; what a training run says besides: command, recipe, steps, ..."""
    scores: Mapping[str, Any] = field(default_factory=dict)
    """a line as the curve's for each split that it was judged on"""

    def __post_init__(self) -> None:
        if not 0 < self.clip < np.inf:
            raise PolicyError(f"policy: clip = {self.clip}, allowed (0, inf)")
        sizes = [w.shape for w in self.weights]
        ends = [self.mean.shape[0], *(b.shape[0] for b in self.biases)]
        if sizes != [(ends[k + 1], ends[k]) for k in range(len(sizes))] or not sizes:
            raise PolicyError(f"policy: layers of shapes {sizes} do not follow each other")
        if ends[0] not in SIZES or ends[-1] != actions.SIZE:
            known = " or ".join(map(str, SIZES))
            raise PolicyError(
                f"policy: from {ends[0]} to {ends[-1]} numbers, allowed {known} to {actions.SIZE}"
            )
        if self.deviation.shape != self.mean.shape:
            raise PolicyError(
                f"policy: deviation of shape {self.deviation.shape}, allowed {self.mean.shape}, the mean's"
            )
        if not all(np.isfinite(t).all() for t in self.tensors().values()) or not (self.deviation > 0).all():
            raise PolicyError("policy: weights, or the deviations of its observations, are no numbers")

    def __call__(self, observation: NDArray[Any]) -> Floats:
        """(3,) action in [-1, 1]. Raises ValueError for what is not the task's state vector."""
        if observation.shape != (SIZE,):
            raise ValueError(f"observation has shape {observation.shape}, allowed that of obs='state'")
        seen = observation[: len(self.mean)]
        x = np.clip((seen - self.mean) / self.deviation, -self.clip, self.clip)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = weight @ x + bias
            x = np.tanh(x) if self.activation == "tanh" else np.maximum(x, 0)
        x = self.weights[-1] @ x + self.biases[-1]
        found: Floats = (np.tanh(x) if self.output == "tanh" else np.clip(x, -1, 1)).astype(np.float32)
        return found

    def widened(self) -> Policy:
        """The same policy on all of today's numbers, of which it does not heed those that it did not know."""
        more = SIZE - len(self.mean)
        return replace(
            self,
            weights=(np.pad(self.weights[0], ((0, 0), (0, more))), *self.weights[1:]),
            mean=np.pad(self.mean, (0, more)),
            deviation=np.pad(self.deviation, (0, more), constant_values=1.0),
        )

    def tensors(self) -> dict[str, Floats]:
        """All numbers by name, as they are kept."""
        named = {"mean": self.mean, "deviation": self.deviation}
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            named |= {f"layer{k}.weight": weight, f"layer{k}.bias": bias}
        return named


def save_policy(policy: Policy, folder: Path) -> None:
    """Write both files or neither; the folder is made.

    Raises OSError, and PolicyError for what `load_policy` would refuse.
    """
    from safetensors.numpy import save

    data = save({name: np.ascontiguousarray(t) for name, t in policy.tensors().items()})
    about = {
        "format": FORMAT,
        "name": policy.name,
        "layers": [list(w.shape[::-1]) for w in policy.weights],
        "activation": policy.activation,
        "output": policy.output,
        "clip": policy.clip,
        "tensors": hashlib.sha256(data).hexdigest(),
        "env": dict(policy.env),
        "training": dict(policy.training),
        "scores": dict(policy.scores),
    }
    _About.from_data(about)
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as both:
        both.enter_context(written_whole(folder / TENSORS)).write_bytes(data)
        write_json(both.enter_context(written_whole(folder / JSON)), about)


def shipped() -> list[str]:
    """Names of the policies that come with the package; `load_policy` takes them for folders."""
    return sorted(file.parent.name for file in TRAINED.glob(f"*/{JSON}"))


def policy_folder(given: str | Path) -> Path:
    """Where a policy lies: the folder given, or that of the shipped one of that name where there is none."""
    folder = Path(given)
    return TRAINED / folder if not folder.exists() and str(given) in shipped() else folder


def content_of(folder: str | Path) -> str:
    """16 hex digits of the SHA-256 over a policy's files. Raises OSError."""
    folder = policy_folder(folder)
    return hashlib.sha256((folder / JSON).read_bytes() + (folder / TENSORS).read_bytes()).hexdigest()[:16]


def load_policy(folder: str | Path) -> Policy:
    """The policy in a folder that `save_policy` wrote, or a shipped one by its name.

    Raises PolicyError, naming the file.
    """
    folder = policy_folder(folder)
    about = _read_about(folder / JSON)
    data = _bytes(folder / TENSORS)
    if hashlib.sha256(data).hexdigest() != about["tensors"]:
        raise PolicyError(f"{folder / TENSORS}: not the tensors that {JSON} was written with")
    tensors = _read_tensors(folder / TENSORS, data, len(about["layers"]))
    for k, layer in enumerate(about["layers"]):
        if (found := list(tensors[f"layer{k}.weight"].shape[::-1])) != layer:
            raise PolicyError(f"{folder / JSON}: layers[{k}] = {layer}, but {TENSORS} has {found}")
    try:
        return Policy(
            name=about["name"],
            weights=tuple(tensors[f"layer{k}.weight"] for k in range(len(about["layers"]))),
            biases=tuple(tensors[f"layer{k}.bias"] for k in range(len(about["layers"]))),
            mean=tensors["mean"],
            deviation=tensors["deviation"],
            clip=about["clip"],
            activation=about["activation"],
            output=about["output"],
            env=about["env"],
            training=about["training"],
            scores=about["scores"],
        )
    except PolicyError as error:
        raise PolicyError(f"{folder}: {error}") from None


def _bytes(file: Path) -> bytes:
    try:
        if file.stat().st_size > MOST_BYTES:
            raise PolicyError(f"{file}: larger than {MOST_BYTES // 2**20} MiB, which no policy is")
        return file.read_bytes()
    except OSError as error:
        raise PolicyError(f"{file}: {(error.strerror or str(error)).lower()}") from None


def _read_about(file: Path) -> dict[str, Any]:
    try:
        about = json.loads(_bytes(file), parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        if isinstance(error, PolicyError):
            raise
        raise PolicyError(f"{file}: not readable as JSON") from None
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise PolicyError(f"{file}: not a policy of the format {FORMAT}")
    try:
        _About.from_data(about)
    except PolicyError as error:
        raise PolicyError(f"{file}: {error}") from None
    return about


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def _read_tensors(file: Path, data: bytes, layers: int) -> dict[str, Floats]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        tensors = load(data)
    except (SafetensorError, ValueError, TypeError, KeyError) as error:
        raise PolicyError(f"{file}: not readable as safetensors: {error}") from None
    wanted = {"mean", "deviation"} | {
        f"layer{k}.{part}" for k in range(layers) for part in ("weight", "bias")
    }
    if set(tensors) != wanted:
        raise PolicyError(
            f"{file}: tensors {', '.join(sorted(tensors))}, allowed {', '.join(sorted(wanted))}"
        )
    for name, tensor in tensors.items():
        dimensions = 2 if name.endswith(".weight") else 1
        if tensor.dtype != np.float32 or tensor.ndim != dimensions:
            raise PolicyError(f"{file}: {name} is {tensor.dtype} of {tensor.ndim} dimensions, not ours")
    return tensors
