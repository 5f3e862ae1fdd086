"""Files appear whole or not at all; folders that a failed run made go again."""

from __future__ import annotations

import json
import math
import os
import threading
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from baselines.jobs.files import output_folder, write_json, written_whole


class Broken(Exception):
    pass


def test_a_file_takes_its_name_only_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "picture.png"
    with written_whole(target) as temporary:
        temporary.write_text("whole")
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".png"
        assert not target.exists()
    assert target.read_text() == "whole"
    assert list(tmp_path.iterdir()) == [target]


def test_what_a_file_holds_is_on_the_disk_before_it_takes_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    replace = os.replace

    def replaced(*names: Path) -> None:
        done.append("name")
        replace(*names)

    monkeypatch.setattr(os, "fsync", lambda _: done.append("content"))
    monkeypatch.setattr(os, "replace", replaced)
    with written_whole(tmp_path / "checkpoint.pt") as temporary:
        temporary.write_text("whole")
    assert done == ["content", "name"]


@pytest.mark.parametrize("error", [Broken, KeyboardInterrupt])
def test_a_failed_write_leaves_what_was_there(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "plan.json"
    target.write_text("old")

    def write() -> None:
        with written_whole(target) as temporary:
            temporary.write_text("ha")
            raise error

    with pytest.raises(error):
        write()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_files_that_belong_together_appear_together(tmp_path: Path) -> None:
    def write(last: str | None) -> None:
        with ExitStack() as all_or_none:
            for name in ("a", "b"):
                all_or_none.enter_context(written_whole(tmp_path / name)).write_text("new")
            if last is None:
                raise Broken

    with pytest.raises(Broken):
        write(None)
    assert list(tmp_path.iterdir()) == []
    write("c")
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}


def test_a_folder_in_the_way_is_found_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "plan.json").mkdir()
    with pytest.raises(IsADirectoryError), written_whole(tmp_path / "plan.json"):
        pytest.fail("the block must not run")


def test_a_reader_never_sees_half_a_file(tmp_path: Path) -> None:
    """While a file is written again and again, whoever reads it gets one version or the other."""
    target, versions = tmp_path / "data", ("a" * 100_000, "b" * 100_000)
    target.write_text(versions[0])
    stop = threading.Event()

    def keep_writing() -> None:
        turn = 0
        while not stop.is_set():
            turn += 1
            with written_whole(target) as temporary:
                temporary.write_text(versions[turn % 2])

    writer = threading.Thread(target=keep_writing)
    writer.start()
    try:
        seen = {target.read_text() for _ in range(200)}
    finally:
        stop.set()
        writer.join()
    assert seen <= set(versions)


def test_a_failed_run_leaves_no_new_folder(tmp_path: Path) -> None:
    with pytest.raises(Broken), output_folder(tmp_path / "a" / "b"):
        raise Broken
    assert list(tmp_path.iterdir()) == []
    with output_folder(tmp_path / "a" / "b") as folder:
        (folder / "file").touch()
    with pytest.raises(Broken), output_folder(tmp_path / "a" / "b"):
        raise Broken
    assert (tmp_path / "a" / "b" / "file").exists()


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(NotADirectoryError), output_folder(path):
            pytest.fail("the block must not run")


def test_json_is_strict_and_says_what_it_cannot(tmp_path: Path) -> None:
    write_json(
        tmp_path / "x", {"a": np.eye(2), "n": (math.nan, np.float64(-math.inf)), "d": {"k": np.int32(3)}}
    )
    text = (tmp_path / "x").read_text()
    data = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert data == {"a": [[1.0, 0.0], [0.0, 1.0]], "n": [None, "-inf"], "d": {"k": 3}}
    assert len(text.splitlines()) == 2 + len(data)
