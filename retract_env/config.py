"""Values checked once, where they enter: ranges, immutable models, files, errors of one line.

An error names the field, the value and what is allowed, as in `tissue.height = -0.0044 m, allowed
(0, 0.05] m`. A fault is what follows the path of its field: it starts with " = ", ": ", "[2]" or ".key".
"""

from __future__ import annotations

import difflib
import json
import math
import re
import reprlib
import stat
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator
from pydantic_core import PydanticCustomError, core_schema

from retract_env.errors import ConfigError

if TYPE_CHECKING:
    from os import PathLike

    from typing_extensions import Self


def refusal(*faults: str) -> PydanticCustomError:
    """What a validator raises to refuse its field, with one fault or several."""
    return PydanticCustomError("fault", "{first}", {"first": faults[0], "faults": faults})


def _message(error: ValidationError, whole: str) -> str:
    """The first three faults in one line, and how many there are besides; whole names what has no path."""
    lines = []
    for item in error.errors(include_url=False):
        path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in item["loc"])
        if item["type"] == "fault":
            lines += [(path or whole * fault.startswith(" =")) + fault for fault in item["ctx"]["faults"]]
        else:
            lines.append(f"{path}: {'missing' if item['type'] == 'missing' else item['msg']}")
    first = [line.removeprefix(".").removeprefix(": ") for line in lines[:3]]
    more = len(lines) - len(first)
    return "; ".join(first) + (f"; and {more} more" if more else "")


def brief(value: object) -> str:
    """Value as an error shows it: its repr, long ones cut."""
    short = reprlib.Repr()
    short.maxstring = short.maxother = 60
    try:
        return short.repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        return "a number of many digits"


def point_text(x: float, y: float) -> str:
    """Point (x, y) m as an error shows it."""
    return f"({x:.6g}, {y:.6g}) m"


# --- Values


@dataclass(frozen=True)
class Range:
    """Interval that a finite number has to lie in; `ends` says which ends belong to it."""

    low: float
    high: float
    unit: str = ""
    ends: str = "[]"

    def __str__(self) -> str:
        if self.low == self.high:
            return f"{self.low:g} {self.unit}".rstrip()
        return f"{self.ends[0]}{self.low:g}, {self.high:g}{self.ends[1]} {self.unit}".rstrip()

    def fault(self, value: object) -> str | None:
        """What is wrong with value, None if nothing is."""
        number = _float(value)
        if number is None:
            return f" = {brief(value)}, not a number; allowed {self}"
        above = number > self.low if self.ends[0] == "(" else number >= self.low
        below = number < self.high if self.ends[1] == ")" else number <= self.high
        if above and below:  # both False for nan
            return None
        shown = brief(value) if isinstance(value, int) else repr(number)
        return f" = {f'{shown} {self.unit}'.rstrip()}, allowed {self}"

    def check(self, value: object) -> float:
        """Value as a float. Raises what pydantic takes for a fault of the field."""
        if (fault := self.fault(value)) is not None:
            raise refusal(fault)
        return float(value) + 0.0  # type: ignore[arg-type]  # -0.0 becomes 0.0: equal values, equal hashes

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self.check, handler(source))


def _float(value: object) -> float | None:
    """None for what is no number: texts and booleans too, which float() would take."""
    if isinstance(value, float):
        return float(value)
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _pair(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise refusal(f" = {brief(value)}, not a point [x, y] in m")
    return value


def _listed(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(value, list | tuple):
        raise refusal(f" = {brief(value)}, not a list")
    return value


def _bool(value: Any) -> Any:
    if not isinstance(value, bool):
        raise refusal(f" = {brief(value)}, not true or false")
    return value


def _name(value: Any) -> Any:
    if not isinstance(value, str) or not value.isprintable() or not 0 < len(value) <= 100:
        raise refusal(f" = {brief(value)}, not a text of 1 to 100 printable characters")
    return value


def whole(low: int, high: int) -> BeforeValidator:
    """Marks an int field that takes a whole number in [low, high]; 1e6 is one."""

    def check(value: Any) -> int:
        number = Range(low, high).check(value)
        if number != int(number):
            raise refusal(f" = {brief(value)}, not a whole number")
        return int(number)

    return BeforeValidator(check)


def one_of(names: Collection[str]) -> BeforeValidator:
    """Marks a text field that takes one of these names, as they are when it is checked."""

    def check(value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            raise refusal(f" = {brief(value)}, allowed {', '.join(names)}")
        return value

    return BeforeValidator(check)


Listed = BeforeValidator(_listed)
"""Marks a tuple that is given as a list, a tuple or an array."""


def listed(most: int) -> BeforeValidator:
    """As `Listed`, of `most` items at most; they are counted before any is looked at."""

    def check(value: Any) -> Any:
        value = _listed(value)
        if len(value) > most:
            raise refusal(f": {len(value)} items, allowed at most {most}")
        return value

    return BeforeValidator(check)


Paired = BeforeValidator(_pair)
"""Marks a point (x, y) m, given likewise."""
Flag = Annotated[bool, BeforeValidator(_bool)]
Name = Annotated[str, BeforeValidator(_name)]


# --- Models


def unknown_keys(data: Iterable[object], known: Sequence[str]) -> list[str]:
    """A fault for each key of a mapping that it may not have."""
    faults = []
    for key in data:
        if key not in known:
            shown = key if isinstance(key, str) and key.isidentifier() and len(key) <= 60 else brief(key)
            close = difflib.get_close_matches(str(shown), known, n=1)
            guess = f", did you mean {close[0]}?" if close else ";"
            faults.append(f".{shown}: unknown key{guess} known keys: {', '.join(known)}")
    return faults


class Frozen(BaseModel):
    """Immutable, hashable and picklable; constructors and `from_data` raise `error_type`."""

    error_type: ClassVar[type[ConfigError]] = ConfigError

    model_config = ConfigDict(frozen=True, extra="forbid")

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise self.error_type(_message(error, type(self).__name__.lower())) from None

    # So marked, nested models are still validated in their parent's pass: paths are whole, all faults seen.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        known = list(cls.model_fields)
        if isinstance(data, cls):
            return data
        if not isinstance(data, dict):
            raise refusal(f" = {brief(data)}, not a mapping; known keys: {', '.join(known)}")
        if faults := unknown_keys(data, known):
            raise refusal(*faults)
        return data

    @classmethod
    def from_data(cls, data: Any) -> Self:
        """Model from plain data: dicts, lists, numbers, texts. Raises `error_type`."""
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise cls.error_type(_message(error, cls.__name__.lower())) from None


# --- Files

LARGEST = 2**20
"""Bytes of a file that is read. The largest shipped scene has 6 kB, a plan of 200 candidates 50 kB."""
MOST_VALUES = 20_000
"""Keys and values in a YAML file, aliases written out: 20 times the largest shipped scene; reading them takes
a second."""
LONGEST_VALUE = 1000
"""Characters of one of them; a name may have 100."""
DEEPEST = 20
"""Lists and mappings within each other; a scene has 6."""


class _Loader(yaml.SafeLoader):
    """YAML's safe subset in which keys do not repeat and 1e-3 is a number, as in YAML 1.2.

    A few lines may stand for any number of values, by aliases of aliases and merge keys: they are counted as
    if they were written out, before any is.
    """

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = self._count = 0
        self._counts: dict[yaml.Node, int] = {}

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        before = self._count
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > LONGEST_VALUE:
            raise _fault(f"{len(event.value)} characters, allowed {LONGEST_VALUE}", event)
        self._depth += 1
        if self._depth > DEEPEST:
            raise _fault(f"lists and mappings more than {DEEPEST} deep", event)
        self._count += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(event, yaml.AliasEvent):
            if node not in self._counts:
                raise _fault(f"alias {event.anchor} within what it stands for", event)
            self._count = before + self._counts[node]
        elif node is not None:
            self._counts[node] = self._count - before
        if self._count > MOST_VALUES:
            raise _fault(f"more than {MOST_VALUES} keys and values, aliases written out", event)
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.MarkedYAMLError(None, None, f"key {key.value} given twice", key.start_mark)
                seen.add(key.value)
        return node


def _fault(problem: str, event: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(None, None, problem, event.start_mark)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


_HERE = Path(__file__).resolve().parent
CONFIGS = next(
    (folder for folder in (_HERE / "configs", _HERE.parent / "configs") if folder.is_dir()), _HERE / "configs"
)
"""What is shipped: beside the sources in a checkout, within the package where it is installed."""


def config_file(name: str | PathLike[str], folder: str) -> Path:
    """The YAML file of that path, or else the shipped one of that name in a folder of `CONFIGS`.

    Raises ConfigError where there is neither, with the names that there are.
    """
    path = Path(name)
    try:
        if path.suffix or len(path.parts) != 1 or (path.exists() and not path.is_dir()):
            return path
        shipped = CONFIGS / folder / f"{path}.yaml"
        if shipped.is_file():
            return shipped
        if path.exists():
            return path
    except OSError as error:  # a name that is too long
        raise ConfigError((error.strerror or str(error)).lower()) from None
    known = sorted(file.stem for file in (CONFIGS / folder).glob("*.yaml"))
    raise ConfigError(f"no such file, and none of the shipped ones: {', '.join(known)}")


def read_yaml(path: str | PathLike[str]) -> Any:
    """Plain data in a YAML file. Raises ConfigError; whoever passes it on puts the file's name before it."""
    text = _read_text(path)
    try:
        data: Any = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
        raise ConfigError(f"not readable as YAML{where}: {problem}") from None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        # no such date, an endless integer, a tag on what it does not fit
        raise ConfigError(f"not readable as YAML: {error}") from None
    if data is None:
        raise ConfigError("the file is empty")
    return data


def read_json(path: str | PathLike[str]) -> Any:
    """Plain data in a JSON file whose keys do not repeat. Raises ConfigError as `read_yaml`."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for key, value in pairs:
            if key in data:
                raise ValueError(f"key {brief(key)} given twice")
            data[key] = value
        return data

    text = _read_text(path)
    try:
        return json.loads(text, object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"not readable as JSON: {error}") from None


def _read_text(path: str | PathLike[str]) -> str:
    """A device or a pipe could go on for ever, or keep who opens it waiting. Raises ConfigError."""
    path = Path(path)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
            raise ConfigError("not a file on a disk, but a device or a pipe")
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise ConfigError(f"{max(len(content), status.st_size)} bytes, allowed {LARGEST}")
        return content.decode("utf-8-sig")
    except OSError as error:
        raise ConfigError((error.strerror or str(error)).lower()) from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"not UTF-8 text (byte {error.start})") from None
    except ValueError as error:  # a path with a null character; ConfigError is one, too
        raise ConfigError(str(error)) from None
