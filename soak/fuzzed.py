"""`python -m soak.fuzzed KIND RUNS FOLDER NAME`: bytes that find new ways through a reader, by libFuzzer.

It begins with the files in the folder's `seeds`, has each read under a name in its `place`, and ends at the
first that is neither read nor refused in one line. Needs atheris.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from pathlib import Path

import atheris

WAYS = (
    *("yaml", "json", "retract_env.config", "retract_env.grasp", "retract_env.scene.parts"),
    *("retract_env.scene.veins", "retract_env.scene.uncertainty", "planners.base"),
    *("planners.certify.certificate", "baselines.cli.certify", "baselines.jobs.journal"),
    *("baselines.benchmark.splits", "baselines.learning.policies", "baselines.learning.recipe"),
)
"""Modules whose branches count; those of compiled kernels cannot be looked into."""
LONGEST_S, MOST_MEMORY_MB = 20, 4096

with atheris.instrument_imports(include=list(WAYS)):
    from baselines.cli.console import BadInput
    from retract_env.errors import ConfigError
    from soak.damaged import READERS
    from soak.outcomes import refused


def main(kind: str, runs: int, folder: Path, name: str) -> None:
    """Does not return: libFuzzer ends the process."""
    seeds, place = folder / "seeds", folder / "place"
    path, longest = place / name, 4 * max(seed.stat().st_size for seed in seeds.iterdir())
    known = {name, *(p.name for p in place.iterdir())}
    counted: Counter[str] = Counter()

    def one(data: bytes) -> None:
        path.write_bytes(data)
        try:
            READERS[kind](path)
            counted["read"] += 1
        except (ConfigError, BadInput) as problem:
            counted["refused"] += 1
            said = refused(ValueError(str(problem)))
            assert said["outcome"] == "refused", said["detail"]
        assert {p.name for p in place.iterdir()} == known
        if counted.total() == runs:
            print(f"counted: {counted['read']} read, {counted['refused']} refused", flush=True)

    warnings.simplefilter("error")
    limits = [f"-timeout={LONGEST_S}", f"-rss_limit_mb={MOST_MEMORY_MB}", f"-max_len={longest}"]
    atheris.Setup(
        ["soak", f"-runs={runs}", "-seed=1", f"-artifact_prefix={folder}/", *limits, str(seeds)], one
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), sys.argv[4])
