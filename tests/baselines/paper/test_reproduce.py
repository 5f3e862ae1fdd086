"""`retract reproduce`: work that is interrupted goes on, results that do not depend on who worked on them."""

from __future__ import annotations

import csv
import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import wraps
from pathlib import Path

import pytest
from rich.console import Console

from baselines.cli.app import main
from baselines.jobs.journal import Row
from baselines.jobs.version import code_version
from baselines.paper import experiments
from baselines.paper.reproduce import names, reproduce
from baselines.paper.studies import STUDIES
from baselines.paper.studies.fig8 import better, strain_curves
from tests.baselines.small_studies import SMALL, small_experiments, use_small_study

ROOT = Path(__file__).resolve().parents[3]
COMMAND = [sys.executable, "-m", "tests.baselines.small_studies"]
PATIENCE = 300.0
"""s"""


@pytest.fixture(scope="module")
def small() -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(STUDIES, SMALL, STUDIES[SMALL])
        use_small_study()
        yield SMALL


@pytest.fixture(scope="module")
def whole(small: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run in this process, from beginning to end."""
    out = tmp_path_factory.mktemp("whole")
    reproduce([small], out, "coarse", workers=1, console=Console(quiet=True))
    return out


def rows_kept(out: Path) -> int:
    journal = out / f".{SMALL}.jsonl"
    return journal.read_bytes().count(b"\n") if journal.exists() else 0


def results(out: Path) -> dict[str, bytes]:
    """The files that a run has written, by name; the journal is none of them."""
    return {path.name: path.read_bytes() for path in out.iterdir() if not path.name.startswith(".")}


def interrupt_after(out: Path, rows: int, workers: int, how: signal.Signals) -> subprocess.Popen[str]:
    """Begin the study in a process of its own, and end it once that many rows are kept."""
    command = [*COMMAND, "--out", str(out), "--workers", str(workers)]
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    end = time.monotonic() + PATIENCE
    while rows_kept(out) < rows and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    process.send_signal(how)
    return process


# --- Runs


def test_a_run_writes_a_table_a_picture_and_a_page(whole: Path, small: str) -> None:
    found = results(whole)
    assert set(found) == {f"{small}.csv", f"{small}.png", f"{small}.md"}
    assert found[f"{small}.png"].startswith(b"\x89PNG")
    assert f"retract {code_version()}" in found[f"{small}.md"].decode()
    assert len(found[f"{small}.csv"].splitlines()) == 1 + len(small_experiments())


def test_an_interrupted_run_goes_on_where_it_stopped(whole: Path, small: str, tmp_path: Path) -> None:
    """Ctrl-C: exit 130, one line, no files but the journal; the next run does the rest, to the same bytes."""
    process = interrupt_after(tmp_path, 3, 1, signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert errors == "interrupted\n"
    kept = rows_kept(tmp_path)
    assert 3 <= kept < len(small_experiments())
    assert results(tmp_path) == {}
    told = io.StringIO()
    reproduce([small], tmp_path, "coarse", workers=1, console=Console(file=told))
    assert f"{kept} of {len(small_experiments())} were done before" in told.getvalue()
    assert rows_kept(tmp_path) == len(small_experiments())
    assert results(tmp_path) == results(whole)


@pytest.mark.slow
def test_killed_workers_and_all_the_run_goes_on_with_more_of_them(whole: Path, tmp_path: Path) -> None:
    process = interrupt_after(tmp_path, 2, 2, signal.SIGKILL)
    process.communicate(timeout=PATIENCE)
    kept = rows_kept(tmp_path)
    assert kept < len(small_experiments())
    with (tmp_path / f".{SMALL}.jsonl").open("ab") as journal:
        journal.write(b'{"key": "cut o')  # as a crash may leave it
    done = subprocess.run(
        [*COMMAND, "--out", str(tmp_path), "--workers", "2"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"{kept} of {len(small_experiments())} were done before" in done.stdout
    assert results(tmp_path) == results(whole)


def test_what_is_done_is_not_done_again_unless_told_to(
    whole: Path, small: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = results(whole)
    done: list[dict[str, object]] = []

    @wraps(experiments.certified)
    def nothing(**arguments: object) -> Row:
        done.append(arguments)
        return {}

    monkeypatch.setattr(experiments, "certified", nothing)
    reproduce([small], whole, "coarse", workers=1, console=Console(quiet=True))
    assert done == []
    assert results(whole) == before
    with pytest.raises(KeyError):  # these rows are empty
        reproduce([small], whole, "coarse", workers=1, fresh=True, console=Console(quiet=True))
    assert len(done) == len(small_experiments())


@pytest.mark.slow
@pytest.mark.parametrize("lost", [False, True], ids=["both to the end", "one lost on the way"])
def test_a_ray_cluster_of_two_nodes_finds_the_same(lost: bool, whole: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray")
    code = (
        "import pathlib, sys, threading, time\n"
        "from ray.cluster_utils import Cluster\n"
        "from tests.baselines.small_studies import SMALL, main, use_small_study\n"
        "use_small_study()\n"
        "head = {'num_cpus': 1, 'include_dashboard': False}\n"
        "cluster = Cluster(initialize_head=True, head_node_args=head)\n"
        "other = cluster.add_node(num_cpus=1)\n"
        "def lose():\n"
        "    while not any(p.stat().st_size for p in pathlib.Path(sys.argv[1]).glob('*.jsonl')):\n"
        "        time.sleep(0.05)\n"
        "    cluster.remove_node(other, allow_graceful=False)\n"
        "    done = sum(p.read_text().count('\\n') for p in pathlib.Path(sys.argv[1]).glob('*.jsonl'))\n"
        "    print('lost after', done, flush=True)\n"
        "if sys.argv[2] == 'True':\n"
        "    threading.Thread(target=lose, daemon=True).start()\n"
        "command = ['reproduce', SMALL, '--resolution', 'coarse', '--out', sys.argv[1]]\n"
        "code = main([*command, '--cluster', cluster.address])\n"
        "cluster.shutdown()\n"
        "sys.exit(code)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path), str(lost)], cwd=ROOT, check=True, timeout=PATIENCE,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    before = [int(line.split()[-1]) for line in done.stdout.splitlines() if line.startswith("lost after")]
    assert len(before) == lost and all(rows < len(small_experiments()) - 1 for rows in before)
    assert results(tmp_path) == results(whole)


def test_the_paths_of_fig_8_come_in_the_papers_order(whole: Path, small: str) -> None:
    """Where strains differ by more than they are known to, CTC has the least of all four with B at 25 %."""
    with (whole / f"{small}.csv").open() as file:
        rows = [{**row, "x": float(row["x"])} for row in csv.DictReader(file)]
    places, curves = strain_curves(rows, "homogeneous")
    for path in ("circular", "linear60", "linear75"):
        for i in range(len(places)):
            assert not better(curves[path][i], curves["ctc"][i]), (path, places[i])


# --- The command


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fig88"], "unknown study 'fig88', allowed fig7, fig8, fig9, fig11, fig12"),
        (["fig8", "--cluster", "auto", "--workers", "2"], "--workers and --cluster: allowed one of them"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reproduce", *arguments, "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {said}")


def test_without_ray_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["reproduce", "fig8", "--out", str(tmp_path), "--cluster", "auto"]) == 2
    assert "retract[cluster]" in capsys.readouterr().err


def test_all_is_every_study() -> None:
    assert names("all") == list(STUDIES)
    assert names("fig8") == ["fig8"]
