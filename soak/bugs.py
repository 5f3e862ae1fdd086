"""Deliberate errors, planted in a copy of the sources: the tests catch every one, or they test little.

The same tests pass in a copy without an error, or it would not be the error that they notice.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.jobs.journal import Row, WorkItem
from benchmarks._report import ROOT

COPIED = ("retract_env", "planners", "baselines", "tests", "benchmarks", "soak", "configs", "pyproject.toml")
LONGEST = 3600.0
"""s, for the tests of one error: kernels are compiled anew for each."""
FAILED, PASSED = 1, 0
"""Exit codes of pytest: a test failed, none did."""


@dataclass(frozen=True)
class Bug:
    """A line that is written wrong, and who is to notice."""

    file: str
    sound: str
    """what stands there, once"""
    wrong: str
    tests: tuple[str, ...]
    """the first that may notice; pytest stops at the first that fails"""


FEM = ("tests/retract_env/fem", "tests/retract_env/physics/test_physics_fem.py", "tests/planners/certify")
TASK = ("tests/retract_env/test_objectives.py", "tests/planners/certify")
BUGS: Mapping[str, Bug] = {
    "a sign in the tangent": Bug(
        "retract_env/fem/kernels.py",
        "first[l] = (p[l] + r[l]) * x[l]",
        "first[l] = (p[l] - r[l]) * x[l]",
        FEM,
    ),
    "lambda halved": Bug(
        "retract_env/fem/elements.py", "modulus * poisson / ((1", "0.5 * modulus * poisson / ((1", FEM
    ),
    "the volume's term left out of the force": Bug(
        "retract_env/fem/kernels.py",
        "J[l] = w[l] * (k[l] * log_j - m[l])",
        "J[l] = w[l] * (0.9 * k[l] * log_j - m[l])",
        FEM,
    ),
    "gravity off by 10 %": Bug(
        "retract_env/fem/model.py", "= -tissue.density * scene.g", "= -0.9 * tissue.density * scene.g", FEM
    ),
    "a shifted jaw": Bug(
        "retract_env/fem/model.py",
        "base = np.array([self.jaw_x, k * self",
        "base = np.array([self.jaw_x - 1e-4, k * self",
        FEM,
    ),
    "half the depth forgotten in the jaws' forces": Bug(
        "retract_env/fem/model.py",
        "[[-2 * force[self._patch_x[k]].sum(), -2 * force",
        "[[-force[self._patch_x[k]].sum(), -2 * force",
        FEM,
    ),
    "a bed that pulls": Bug(
        "retract_env/fem/model.py",
        "if gap < 0.0:\n            force[bed",
        "if gap != 0.0:\n            force[bed",
        FEM,
    ),
    "a pad that pulls": Bug(
        "retract_env/fem/contact.py", "force[p] -= push * tx", "force[p] += push * tx", FEM
    ),
    "Fung's stress doubled": Bug(
        "retract_env/fem/fung.py", "Q[l] = w[l] * more\n", "Q[l] = 2.0 * w[l] * more\n", FEM
    ),
    "friction from one jaw only": Bug(
        "retract_env/objectives.py",
        "friction = float(np.max(required_friction))",
        "friction = float(np.ravel(required_friction)[0])",
        TASK,
    ),
    "friction from the first jaw in the certifier": Bug(
        "retract_env/physics/base.py",
        "return float(self.required_friction.max()) if",
        "return float(self.required_friction[0]) if",
        TASK,
    ),
    "compression not counted as strain": Bug(
        "retract_env/objectives.py",
        "off = np.abs(np.asarray(stretches, float) - 1.0)",
        "off = np.asarray(stretches, float) - 1.0",
        TASK,
    ),
    "2 % of the volume instead of 1": Bug(
        "retract_env/objectives.py", "WORST_FRACTION = 0.01", "WORST_FRACTION = 0.02", (*TASK, *FEM)
    ),
    "the highest point instead of the lowest": Bug(
        "retract_env/objectives.py",
        "away[..., 1] * along[0]).min())",
        "away[..., 1] * along[0]).max())",
        TASK,
    ),
    "seen before it is seen": Bug(
        "retract_env/objectives.py",
        'return "ok" if clearance >= clearance_limit else None',
        'return "ok" if clearance >= clearance_limit - 1e-3 else None',
        TASK,
    ),
    "no look between increments": Bug(
        "planners/certify/retraction.py",
        "            if place is None:\n                if self.frames[-1].progress != end:",
        "            if True:\n                if self.frames[-1].progress != end:",
        TASK,
    ),
    "a vein as soft as the tissue": Bug(
        "retract_env/fem/prism.py",
        "*(v.modulus for v in tissue.veins)])",
        "*(tissue.modulus for v in tissue.veins)])",
        FEM,
    ),
    "no shear correction in the rod": Bug(
        "retract_env/rod/sections.py", "SHEAR = 5 / 6", "SHEAR = 1.0", ("tests/retract_env/rod",)
    ),
}


def bug_tasks(count: int, code: str) -> list[dict[str, Any]]:
    """The first so many errors, and before them none, for all of their tests."""
    names = list(BUGS)[:count]
    tests = list(dict.fromkeys(test for name in names for test in BUGS[name].tests))
    none = {"part": "bugs", "bug": "", "tests": tests, "code": code}
    return [none, *({"part": "bugs", "bug": name, "code": code} for name in names)]


def planted(task: WorkItem) -> Row:
    """Which test notices an error; where there is none, that no test does."""
    bug = BUGS.get(task["bug"])
    tests = task["tests"] if bug is None else bug.tests
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        for name in COPIED:
            put = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
            copy.mkdir(exist_ok=True)
            put(ROOT / name, copy / name)
        if bug is not None:
            file = copy / bug.file
            source = file.read_text("utf-8")
            if source.count(bug.sound) != 1:
                return {
                    "outcome": "unsound",
                    "detail": f"{bug.file}: {bug.sound!r} stands there {source.count(bug.sound)} times",
                }
            file.write_text(source.replace(bug.sound, bug.wrong), "utf-8")
        environment = os.environ | {"PYTHONPATH": str(copy), "NUMBA_CACHE_DIR": str(Path(folder) / "kernels")}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        try:
            done = subprocess.run(
                command,
                cwd=copy,
                env=environment,
                capture_output=True,
                text=True,
                timeout=LONGEST,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return {"outcome": "time", "detail": f"the tests took more than {LONGEST:.0f} s"}
    said = [line.split(" - ")[0] for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    failed = done.returncode == FAILED and bool(said) and said[0].startswith("FAILED")
    if bug is None and done.returncode == PASSED:
        return {"outcome": "passed", "detail": ""}
    if bug is not None and failed:
        return {"outcome": "caught", "detail": said[0].removeprefix("FAILED ")}
    what = "no test noticed" if done.returncode == PASSED else f"pytest ended with {done.returncode}"
    return {"outcome": "unsound", "detail": ": ".join([what, *said[:1]])}
