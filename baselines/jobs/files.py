"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import csv
import errno
import io
import json
import math
import os
import secrets
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, written in the block; it takes the name if the block ends well.

    The temporary keeps the name's ending, which tells writers of pictures the format. Where the block fails,
    the temporary goes and what stood at `path` stays. Several files that belong together are opened in one
    ExitStack, so that none is renamed before all are written. Raises OSError.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    temporary = path.with_name(f".{path.stem[:100]}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())  # else a power cut may leave the name and no content
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def output_folder(path: Path) -> Iterator[Path]:
    """Make the folder where it is missing and see that files can be made in it. Raises OSError.

    A block that fails leaves no new folder.
    """
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
    new = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        yield path
    except BaseException:
        for folder in new:  # the deepest first; one that others have filled stays
            with suppress(OSError):
                folder.rmdir()
        raise


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write an object as strict JSON, one top-level key a line. Raises OSError."""
    lines = [
        f"  {json.dumps(key)}: {json.dumps(_plain(value), allow_nan=False)}" for key, value in data.items()
    ]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV with a head; a column that a row lacks is empty there."""
    text = io.StringIO()
    columns = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _plain(value: Any) -> Any:
    """Arrays become lists; nan, which JSON lacks, null, and infinities the words "inf" and "-inf"."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
