"""The least certified strain known for each frozen scene, shipped with the package: what scores compare with.

`python -m baselines.benchmark.references CSV RESOLUTION COMMAND` takes the benchmark's rows, the mesh that
they were certified on and the command that made them, and keeps what is better than what was known.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from baselines.jobs.files import write_json, written_whole

FILE = Path(__file__).parent / "references.json"


@dataclass(frozen=True)
class Reference:
    """The best that was certified on a scene, and where it comes from."""

    strain: float
    method: str
    run: int
    """seed of the training, for a policy"""
    split: str
    number: int
    """of the scene in its split"""
    resolution: str
    """mesh of the certificate"""
    command: str
    """what computed it"""


def load_references(resolution: str, file: Path = FILE) -> dict[str, Reference]:
    """By the scene's hash; those of that resolution alone, as strains of different meshes do not compare."""
    kept = {scene: Reference(**data) for scene, data in json.loads(file.read_text("utf-8")).items()}
    return {scene: reference for scene, reference in kept.items() if reference.resolution == resolution}


def better(
    rows: Iterable[Mapping[str, Any]], resolution: str, command: str, known: Mapping[str, Reference]
) -> dict[str, Reference]:
    """What is known, and the certified rows that are better, by split and number."""
    best = dict(known)
    for row in rows:
        before = best.get(row["scene_hash"])
        if row["certified"] and (before is None or row["max_strain"] < before.strain):
            best[row["scene_hash"]] = Reference(
                strain=row["max_strain"],
                method=row["method"],
                run=row["run"],
                split=row["split"],
                number=row["number"],
                resolution=resolution,
                command=command,
            )
    return dict(sorted(best.items(), key=lambda item: (item[1].split, item[1].number, item[0])))


def read_rows(file: Path) -> list[dict[str, Any]]:
    """Rows of a report's CSV, as far as `better` asks for them."""
    with file.open(newline="", encoding="utf-8") as text:
        return [
            {
                **line,
                "run": int(line["run"]),
                "number": int(line["number"]),
                "certified": line["certified"] == "True",
                "max_strain": float(line["max_strain"] or "nan"),
            }
            for line in csv.DictReader(text)
        ]


def main(arguments: Sequence[str]) -> None:
    """CSV, RESOLUTION, COMMAND: keep in `FILE` what is better there."""
    file, resolution, command = arguments
    known = load_references(resolution)
    if len(known) < len(json.loads(FILE.read_text("utf-8"))):
        raise SystemExit(f"{FILE}: holds strains of another mesh than {resolution}, which do not compare")
    best = better(read_rows(Path(file)), resolution, command, known)
    with written_whole(FILE) as temporary:
        write_json(temporary, {scene: asdict(reference) for scene, reference in best.items()})


if __name__ == "__main__":
    main(sys.argv[1:])
