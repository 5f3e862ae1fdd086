"""docs/notebooks: executed as they stand, in the short length that their first cells speak of."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SHORT = {
    "RETRACT_NOTEBOOK_RESOLUTION": "coarse",
    "RETRACT_NOTEBOOK_STEPS": "8192",
    "RETRACT_NOTEBOOK_FLAPS": "1",
    "RETRACT_NOTEBOOK_SCENES": "1",
}
LONGEST = 600
"""s a cell may take, kernels not compiled yet; compiled, a whole notebook takes less than a tenth"""


@pytest.mark.notebook
@pytest.mark.filterwarnings("ignore")  # the kernel's own
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    for name, value in SHORT.items():
        monkeypatch.setenv(name, value)
    # the code of this checkout and the console command beside this interpreter, from any folder
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    notebook = nbformat.read(path, 4)
    nbclient.NotebookClient(
        notebook, timeout=LONGEST, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()  # raises where a cell does
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_kept_with_what_it_showed(path: Path) -> None:
    """Each in order, none with an error; so the pages show what a reader would see."""
    nbformat = pytest.importorskip("nbformat")
    code = [cell for cell in nbformat.read(path, 4).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert not [out for cell in code for out in cell.outputs if out.output_type == "error"]
    assert sum(bool(cell.outputs) for cell in code) >= len(code) / 2
