"""Checkpoints of a training run: one file of tensors, numbers and texts, whole or not there at all.

The file says what it is and how its content hashes, so that what is corrupted or foreign is refused before
it is read; reading it never executes code.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import warnings
from pathlib import Path
from typing import Any

import torch

from baselines.jobs.files import written_whole
from retract_env.errors import ConfigError

MAGIC = b"retract-checkpoint-1\n"


class CheckpointError(ConfigError):
    """A checkpoint that cannot be gone on from; the message is one line."""


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write, replacing what was there. Raises OSError."""
    content = io.BytesIO()
    torch.save(state, content)
    data = content.getbuffer()
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(MAGIC + hashlib.sha256(data).hexdigest().encode() + b"\n")
        file.write(data)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """What `write_checkpoint` wrote. Raises CheckpointError, naming the file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    head = len(MAGIC) + 65
    if not data.startswith(MAGIC):
        raise CheckpointError(f"{path}: not a checkpoint of retract")
    content = memoryview(data)[head:]
    if hashlib.sha256(content).hexdigest().encode() + b"\n" != data[len(MAGIC) : head]:
        raise CheckpointError(f"{path}: corrupted, its content does not match its hash")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # torch warns of pickles that it did not write
            state: dict[str, Any] = torch.load(io.BytesIO(content), weights_only=True, map_location="cpu")
    except (RuntimeError, pickle.UnpicklingError, EOFError, ValueError, UserWarning) as error:
        raise CheckpointError(f"{path}: not readable: {str(error).splitlines()[0]}") from None
    return state
