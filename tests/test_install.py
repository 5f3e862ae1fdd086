"""A wheel, unpacked into an empty folder, finds all that it needs; what it says of itself leads somewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that a wheel, built from a copy of the sources, was unpacked into."""
    pytest.importorskip("setuptools", minversion="77")
    folder = tmp_path_factory.mktemp("wheel")
    left_out = shutil.ignore_patterns(".*", "__pycache__", "build", "out", "runs", "shared", "*.egg-info")
    shutil.copytree(ROOT, folder / "sources", ignore=left_out)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--quiet"]
    subprocess.run([*command, "-w", str(folder), str(folder / "sources")], check=True, capture_output=True)
    (built,) = folder.glob("retract-*.whl")
    zipfile.ZipFile(built).extractall(folder / "site")
    return folder / "site"


def run(wheel: Path, empty: Path, code: str) -> str:
    """What a program prints that knows of the wheel alone and is started in an empty folder."""
    environment = os.environ | {"PYTHONPATH": str(wheel), "SDL_VIDEODRIVER": "dummy"}
    found = f"import sys; assert sys.path[1] == {str(wheel)!r}, sys.path\n"
    found += f"import retract_env; assert retract_env.__file__.startswith({str(wheel)!r})\n"
    done = subprocess.run(
        [sys.executable, "-c", found + code], cwd=empty, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_console_plans_a_shipped_scene(wheel: Path, tmp_path: Path) -> None:
    code = """
from baselines.cli import main
sys.exit(main(["plan", "ten_veins", "--resolution", "coarse", "--no-pictures"]))
"""
    assert "certified; grasp" in run(wheel, tmp_path, code)
    assert {path.name for path in tmp_path.iterdir()} == {"out"}


def test_a_page_finds_its_parts(wheel: Path, tmp_path: Path) -> None:
    code = """
from baselines.pictures.page.compose import SCRIPTS, part
print(all(part(name) for name in (*SCRIPTS, "page.html", "page.css", "three.min.js", "three.LICENSE")))
"""
    assert run(wheel, tmp_path, code) == "True\n"


def test_an_environment_is_made_of_a_shipped_scene(wheel: Path, tmp_path: Path) -> None:
    code = """
import gymnasium as gym
env = gym.make("TissueRetractFEM-v0", scene="ten_veins")
observation, info = env.reset(seed=0)
print(env.step(env.action_space.sample())[4] is not None)
"""
    assert run(wheel, tmp_path, code).strip() == "True"


def test_recipes_splits_studies_and_policies_are_found(wheel: Path, tmp_path: Path) -> None:
    code = """
from baselines.benchmark.splits import load_benchmark
from baselines.learning.policies import load_policy
from baselines.learning.recipe import load_recipe
from baselines.paper.study import paper_scene
for name in ("ppo", "ppo_from_bc", "sac", "tqc", "bc"):
    load_recipe(name)
assert "test" in load_benchmark("benchmark").splits
for name in ("homogeneous", "homogeneous_near", "ten_veins", "twenty_veins", "wide"):
    paper_scene(name)
load_policy("bc-0")
"""
    run(wheel, tmp_path, code)
    assert list(tmp_path.iterdir()) == []


def test_without_pybullet_the_wheel_names_pip(wheel: Path, tmp_path: Path) -> None:
    code = """
sys.modules["pybullet"] = None
import gymnasium as gym
try:
    gym.make("TissueRetract-v0")
except ImportError as error:
    print(error)
"""
    assert 'pip install "retract[bullet]"' in run(wheel, tmp_path, code)


def test_the_packages_are_typed_and_hold_no_tests(wheel: Path) -> None:
    packages = {path.name for path in wheel.iterdir() if path.suffix != ".dist-info"}
    assert packages == {"retract_env", "planners", "baselines"}
    assert all((wheel / package / "py.typed").exists() for package in packages)


def test_what_an_index_shows_has_no_link_into_the_repository(wheel: Path) -> None:
    (metadata,) = wheel.glob("*.dist-info/METADATA")
    links = re.findall(r"\]\(([^)\s]+)", metadata.read_text("utf-8"))
    assert links
    assert all(link.startswith("https://") for link in links)
