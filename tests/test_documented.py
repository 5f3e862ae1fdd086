"""Whoever reads the sources, or asks `help`, is told what everything public is."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from tests.test_architecture import PACKAGES, ROOT, sources

SOURCES = [path.relative_to(ROOT).as_posix() for path in sources(*PACKAGES)]
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
ELSEWHERE = {
    "reset", "step", "step_wait", "close", "render",  # of Gymnasium's and Stable-Baselines3's environments
}  # fmt: skip
"""Methods that a library's base class documents."""


def public(body: list[ast.stmt], within: str = "") -> Iterator[tuple[str, Definition]]:
    """Public functions and classes at the top, and public methods, by name."""
    for node in body:
        if not isinstance(node, Definition) or node.name.startswith("_"):
            continue
        name = f"{within}{node.name}"
        yield name, node
        if isinstance(node, ast.ClassDef):
            yield from public(node.body, f"{name}.")


def only_declared(node: Definition) -> bool:
    """Whether its body is "...", as of a protocol's methods, which the protocol explains."""
    return (
        len(node.body) == 1
        and isinstance(value := node.body[0], ast.Expr)
        and (isinstance(value.value, ast.Constant) and value.value.value is ...)
    )


def documented_methods() -> set[str]:
    """Names of methods that some class of ours explains: others of the name do the same."""
    found = set()
    for source in SOURCES:
        for name, node in public(ast.parse((ROOT / source).read_text("utf-8")).body):
            if "." in name and ast.get_docstring(node):
                found.add(node.name)
    return found | ELSEWHERE


@pytest.fixture(scope="module")
def explained() -> set[str]:
    return documented_methods()


@pytest.mark.parametrize("source", SOURCES)
def test_everything_public_says_what_it_is(source: str, explained: set[str]) -> None:
    tree = ast.parse((ROOT / source).read_text("utf-8"))
    assert ast.get_docstring(tree), f"{source} says nothing of itself"
    silent = [
        name
        for name, node in public(tree.body)
        if not ast.get_docstring(node)
        and not only_declared(node)
        and not ("." in name and node.name in explained)
    ]
    assert not silent
