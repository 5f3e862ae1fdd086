"""Files from outside: whatever they are, they are read or refused in one line, soon."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from retract_env.config import DEEPEST, LARGEST, MOST_VALUES, config_file, read_json, read_yaml
from retract_env.errors import ConfigError

SOON = 20.0
"""s of processor time; what is refused here took minutes or never ended; now 1 s at most."""


def refused(read: Callable[[Any], Any], path: object) -> str:
    """The one line with which a file is refused."""
    start = time.process_time()
    with pytest.raises(ConfigError) as caught:
        read(path)
    assert time.process_time() - start < SOON
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert len(message) < 500
    return message


def nested(first: str, other: str, levels: int = 12) -> str:
    """Each level stands for nine of the one before it, the last for 9^11 values."""
    lines = [f"a0: &a0 {first}"]
    for k in range(1, levels):
        lines.append(f"a{k}: &a{k} " + other.format(",".join([f"*a{k - 1}"] * 9)))
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (nested("[1]", "[{}]"), "more than 20000 keys and values, aliases written out"),
        (nested("{x: 1}", "{{<<: [{}]}}"), "more than 20000 keys and values, aliases written out"),
        ("- &v {outline: [[0, 0], [1, 0], [1, 1]]}\n" + "- *v\n" * 30_000, "more than 20000 keys and values"),
        ("[" + "1," * (MOST_VALUES + 1) + "]", "more than 20000 keys and values"),
        ("[" * (DEEPEST + 1), "lists and mappings more than 20 deep"),
        ("- " * 100_000, "lists and mappings more than 20 deep"),
        ("&a {<<: [*a, *a], x: *a}", "alias a within what it stands for"),
        ("a: 1" + ":30" * 100_000, "300001 characters, allowed 1000"),
    ],
    ids=["aliases", "merge keys", "one alias", "flat", "deep", "dashes", "itself", "base 60"],
)
def test_a_yaml_bomb_is_refused_before_it_goes_off(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "bomb.yaml"
    file.write_text(text)
    said = refused(read_yaml, file)
    assert said.startswith("not readable as YAML, line ")
    assert message in said


@pytest.mark.parametrize("tagged", ['!!int ""', '!!float ""', "!!bool foo", "!!timestamp foo"])
def test_a_tag_on_what_it_does_not_fit_is_refused(tmp_path: Path, tagged: str) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(f"name: {tagged}\n")
    assert refused(read_yaml, file).startswith("not readable as YAML: ")


def test_aliases_and_merge_keys_of_a_reasonable_size_are_read(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text("- &v {outline: [0, 1], modulus: 2}\n- {<<: *v, modulus: 3}\n" + "- *v\n" * 100)
    data = read_yaml(file)
    assert data[1] == {"outline": [0, 1], "modulus": 3}
    assert data[101] == data[0]


@pytest.mark.parametrize("read", [read_yaml, read_json])
def test_a_large_file_is_not_even_read(tmp_path: Path, read: Callable[[Any], Any]) -> None:
    file = tmp_path / "large"
    file.touch()
    os.truncate(file, 10**11)  # 100 GB that take no room on the disk
    assert refused(read, file) == f"100000000000 bytes, allowed {LARGEST}"


@pytest.mark.parametrize("read", [read_yaml, read_json])
@pytest.mark.parametrize("device", ["/dev/full", "/dev/zero", "/dev/null", "/dev/stdin", "a pipe"])
def test_devices_and_pipes_are_refused(tmp_path: Path, read: Callable[[Any], Any], device: str) -> None:
    path = Path(device)
    if device == "a pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("no named pipes here")
        os.mkfifo(path := tmp_path / "pipe")
    if not path.exists() or path.is_file():
        pytest.skip(f"no {device} here")
    assert refused(read, path) == "not a file on a disk, but a device or a pipe"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not readable as JSON: Expecting value"),
        (b'{"x": 1, "y": 2, "x": 3}', "not readable as JSON: key 'x' given twice"),
        (b'{"' + b'":1,"'.join(b"%d" % k for k in range(50_000)) + b'":1,"7":1}', "key '7' given twice"),
        (b"[" * 200_000, "not readable as JSON: maximum recursion depth exceeded"),
        (b"\xff", "not UTF-8 text (byte 0)"),
        (None, "no such file or directory"),
    ],
)
def test_what_is_no_json_is_said_in_one_line(tmp_path: Path, content: bytes | None, message: str) -> None:
    file = tmp_path / "plan.json"
    if content is not None:
        file.write_bytes(content)
    assert message in refused(read_json, file)


def test_json_is_read_as_it_was_written(tmp_path: Path) -> None:
    file, data = tmp_path / "data.json", {"a": [1, 2.5, None, "text"], "b": {"c": True}}
    file.write_text(json.dumps(data))
    assert read_json(file) == data


# --- What is shipped


@pytest.mark.parametrize(
    ("name", "folder"), [("ten_veins", "scenes"), ("ppo", "train"), (Path("bc"), "train"), ("benchmark", "")]
)
def test_a_shipped_file_is_found_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()  # such as what an earlier run has written
    assert config_file(name, folder).stem == str(name)
    assert read_yaml(config_file(name, folder))


def test_a_file_of_the_users_comes_before_a_shipped_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ten_veins").write_text("own: 1")
    assert read_yaml(config_file("ten_veins", "scenes")) == {"own": 1}
    for path in ("ten_veins.yaml", "scenes/ten_veins"):  # a path is never taken for a name
        assert config_file(path, "scenes") == Path(path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("eleven_veins", "no such file, and none of the shipped ones: homogeneous, homogeneous_near, ten_"),
        ("x" * 5000, "file name too long"),
        ("..", "is a directory"),
        ("", "is a directory"),
        ("a\0b", "no such file"),
    ],
)
def test_other_names_are_refused_with_those_that_there_are(name: str, message: str) -> None:
    assert message in refused(lambda name: read_yaml(config_file(name, "scenes")), name)
