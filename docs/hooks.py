"""What the site shows beyond docs/*.md: notebooks as pages, and pages that stand in the repository's root.

Notebooks become Markdown here and not by a plugin: the plugins that there are load scripts from other hosts,
and the site has to work without any.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
FROM_ROOT = ("CHANGELOG.md", "CONTRIBUTING.md")
TERMINAL_CODES = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the root's pages, and a page for each notebook; the notebook itself stays, to be downloaded."""
    for name in FROM_ROOT:
        files.append(File.generated(config, name, content=(ROOT / name).read_text("utf-8")))
    for file in list(files):
        if file.src_uri.endswith(".ipynb") and file.abs_src_path is not None:
            page = as_markdown(Path(file.abs_src_path))
            files.append(File.generated(config, file.src_uri.replace(".ipynb", ".md"), content=page))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Links as they work in the repository become links of the site."""
    if page.file.src_uri in FROM_ROOT:
        return markdown.replace("](docs/", "](")
    for name in FROM_ROOT:
        markdown = markdown.replace(f"](../{name}", f"]({name}")
    return re.sub(r"(\]\([^)\s]*)\.ipynb(?!#download)", r"\1.md", markdown).replace("#download", "")


def as_markdown(notebook: Path) -> str:
    """A notebook's cells and outputs as one page of Markdown; its first cell has the heading."""
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    parts = []
    for cell in cells:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
        elif source:
            parts.append(fenced(source, "python"))
            parts += [output for told in cell["outputs"] if (output := shown(told))]
    parts.append(f"[Download this notebook]({notebook.name}#download)")
    return "\n\n".join(parts) + "\n"


def shown(output: dict[str, Any]) -> str:
    """One output of a cell: a picture, else its text."""
    data = output.get("data", {})
    if "image/png" in data:
        return f"![Output](data:image/png;base64,{''.join(data['image/png']).replace(chr(10), '')})"
    text = TERMINAL_CODES.sub("", "".join(output.get("text", data.get("text/plain", "")))).rstrip()
    return fenced(text, "{ .text .output }") if text else ""


def fenced(text: str, language: str) -> str:
    """A block of code; language may be attributes in braces."""
    return f"```{language}\n{text}\n```"
