"""Copies of recordings that verbs write: whole or not at all, and never over something else."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, TypeVar

from recorder.mcap.sink import open_output
from recorder.mcap.writer import MAGIC
from replay.cli.console import print_message
from replay.errors import ReplayError
from replay.file.record_reader import is_locked

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from replay.recording import Recording

R = TypeVar("R")


def add_output(parser: argparse.ArgumentParser, kind: str) -> None:
    """Add the copy's path."""
    parser.add_argument(
        "-o", "--output", metavar="FILE", type=Path, help=f"the copy; by default LOG's name.{kind}.mcap"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace a recording that is there")


def write_copy(log: Recording, target: Path, write: Callable[[BinaryIO], R], *, overwrite: bool) -> R:
    """Write a copy of a recording; return what the function returns that writes it.

    Raises:
        ReplayError: it can't be written there.
    """
    _check(log, target, overwrite=overwrite)
    part = target.with_name(f"{target.name}.part")  # whole or not at all
    try:
        with open_output(part) as file:
            result = write(file)
        if target.exists():
            print_message(f"{target} is replaced")
        part.replace(target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return result


def _check(log: Recording, target: Path, *, overwrite: bool) -> None:
    if log.live:
        raise ReplayError(f"{log.path}: it is still being written; copy it when its process has ended")
    if not target.exists():
        return
    if target.samefile(log.path):
        raise ReplayError(f"{target}: that is the recording itself, which is kept as it is; name another file")
    if not overwrite:
        raise ReplayError(f"{target}: it is there already; name another file, or add --overwrite")
    with target.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ReplayError(f"{target}: there is a file that is no recording; move it away or name another file")
        if is_locked(file):
            raise ReplayError(f"{target}: another recording is writing it; name another file")
