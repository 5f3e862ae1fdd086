"""What the documentation's site is made of: complete, and of nothing that lies on other hosts."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

import retract_env
from baselines.cli.app import app
from planners import PLANNERS, plan
from planners.certify import REASONS
from retract_env.scene import Scene

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
SHOWN_ELSEWHERE = {"package.md"}
"""What a package index shows."""

PUBLIC = (
    "retract_env.scene",
    "retract_env.spring",
    "retract_env.task",
    "retract_env.mesh",
    "planners",
    "planners.certify",
)
"""Packages that say in `__all__` what users may rely on."""
RELIED_ON = {
    "retract_env": ["register_physics"],
    "retract_env.env": ["TissueRetractEnv"],
    "retract_env.vector": ["TissueRetractVectorEnv"],
    "retract_env.grasp": ["Grasp", "JawPath"],
    "retract_env.rollout": ["Rollout", "PathPolicy", "rollout"],
    "retract_env.physics.base": ["Physics", "Restorable", "TissueState"],
    "retract_env.physics.registry": ["PHYSICS", "PhysicsKind"],
    "retract_env.scenarios": ["draws", "scenario"],
    "planners.base": ["Contestant", "Verdict"],
    "planners.paths": ["PATHS", "circular", "ctc", "linear"],
    "planners.search": ["race", "generate_and_test"],
    "baselines.learning.policies": ["Policy", "load_policy"],
    "baselines.learning.vec_env": ["BatchVecEnv"],
}
"""What the pages import besides."""


class _Loader(yaml.SafeLoader):
    """Of mkdocs.yml, which may name Python objects; they do not matter here."""


_Loader.add_multi_constructor("tag:yaml.org,2002:python/name:", lambda *_: None)


def settings() -> dict[str, Any]:
    return dict(yaml.load((ROOT / "mkdocs.yml").read_text("utf-8"), _Loader))


def listed(entry: Any) -> list[str]:
    """The pages of an entry of the navigation, at any depth."""
    if isinstance(entry, str):
        return [entry]
    return [
        page for inner in (entry.values() if isinstance(entry, dict) else entry) for page in listed(inner)
    ]


def test_every_page_is_in_the_navigation() -> None:
    pages = listed(settings()["nav"])
    assert len(pages) == len(set(pages))
    there = {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")} - SHOWN_ELSEWHERE
    there |= {str(path.relative_to(DOCS).with_suffix(".md")) for path in DOCS.rglob("*.ipynb")}
    assert there - set(pages) == set(), "not in mkdocs.yml"
    assert set(pages) - there == {"CHANGELOG.md", "CONTRIBUTING.md"}


def test_the_site_needs_no_other_host() -> None:
    about = settings()
    assert about["theme"]["font"] is False
    assert "offline" in about["plugins"] and about["use_directory_urls"] is False
    for name in ("extra_css", "extra_javascript"):
        assert not [address for address in about.get(name, []) if "//" in str(address)]


def documented() -> dict[str, list[str]]:
    """Names that the reference shows of each module; [] for all that have a docstring."""
    found: dict[str, list[str]] = {}
    for page in sorted((DOCS / "reference").glob("*.md")):
        for module, members in re.findall(
            r"^::: (\S+)(?:\n    options:\n      members: \[(.*)\])?", page.read_text("utf-8"), re.MULTILINE
        ):
            assert module not in found
            found[module] = [name.strip() for name in members.split(",")] if members else []
    return found


def test_the_reference_has_every_public_name() -> None:
    shown = set()
    for module, members in documented().items():
        source = importlib.import_module(module)
        assert (source.__doc__ or "").strip(), module
        for name in members:
            assert hasattr(source, name), f"{module}.{name}"
        shown |= set(members) or {name for name in vars(source) if not name.startswith("_")}
    public = {name for module in PUBLIC for name in importlib.import_module(module).__all__}
    public |= {name for names in RELIED_ON.values() for name in names}
    assert public - shown == set()


@pytest.mark.parametrize("module", sorted(documented()))
def test_what_the_reference_shows_has_a_docstring(module: str) -> None:
    source = importlib.import_module(module)
    for name in documented()[module]:
        thing = getattr(source, name)
        if callable(thing):
            assert (thing.__doc__ or "").strip(), f"{module}.{name}"


def first_cells(page: str, head: str) -> list[str]:
    """Names in the first column of the table with that head."""
    text = (DOCS / page).read_text("utf-8").partition(f"| {head} |")[2].partition("\n\n")[0]
    cells = [line.split("|")[1] for line in text.splitlines()[2:]]
    return [name for cell in cells for name in re.findall(r"`([^`]+)`", cell)]


def test_the_console_page_has_every_command_and_planner() -> None:
    command = typer.main.get_command(app)
    assert set(first_cells("console.md", "command")) == set(command.commands)  # type: ignore[attr-defined]
    assert set(first_cells("console.md", "planner")) == set(PLANNERS)


def test_the_certificates_page_has_every_reason() -> None:
    assert first_cells("certificate.md", "reason") == list(REASONS)


def test_the_quick_starts_scene_can_be_retracted() -> None:
    text = (DOCS / "quick-start.md").read_text("utf-8").partition("```yaml\n")[2].partition("```")[0]
    scene = Scene.from_data(yaml.safe_load(text))
    assert plan(scene, "eased", "coarse", workers=1).certificate.certified


def test_the_changelog_tells_of_this_version() -> None:
    assert f"## {retract_env.__version__}, " in (ROOT / "CHANGELOG.md").read_text("utf-8")
