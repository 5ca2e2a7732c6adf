"""Verbs that copy a recording: ``repair`` copies the readable parts, ``pack`` the recording and its models."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import BinaryIO, TypeVar

from recorder.mcap_sink import open_output
from recorder.mcap_writer import MAGIC
from replay.cli.console import print_message, print_result
from replay.errors import ReplayError
from replay.file.record_reader import is_locked
from replay.file.repair import Losses, range_text
from replay.recording import Recording

R = TypeVar("R")


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = "To repair a plan that fails, see fix."
    add_output(parser, "sound")


def run(log: Recording, options: argparse.Namespace) -> None:
    target: Path = options.output or log.path.with_name(f"{log.path.stem}.sound.mcap")
    losses = write_copy(log, target, log.write_sound, overwrite=options.overwrite)
    data = asdict(losses) | {
        "steps": [[gap.start, gap.stop - 1] for gap in losses.steps],
        "chunks": {str(number): cause for number, cause in losses.chunks.items()},
        "file": str(target),
        "files": len(log.assets) - len(losses.files),
    }
    print_result(lambda: data, _lines(log, target, losses), as_json=options.json)


def _lines(log: Recording, target: Path, losses: Losses) -> Iterator[str]:
    files = len(log.assets) - len(losses.files)
    yield f"{target}: {losses.records} records, {files} attached files"
    if losses.steps:
        yield f"lost   steps {', '.join(map(range_text, losses.steps))}"
    yield from (f"lost   chunk {number}: {cause}" for number, cause in losses.chunks.items())
    if losses.messages:
        yield f"lost   {losses.messages} messages that can't be decoded"
    yield from (f"lost   the attached file {name}: {cause}" for name, cause in losses.files.items())
    if not (losses.steps or losses.chunks or losses.messages or losses.files):
        yield "lost   nothing that is known"


def add_output(parser: argparse.ArgumentParser, kind: str) -> None:
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help=f"the copy (default: LOG.{kind}.mcap)")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing recording")


def write_copy(log: Recording, target: Path, write: Callable[[BinaryIO], R], *, overwrite: bool) -> R:
    """Write a copy of a recording, and return the result of the function ``write``; raise ReplayError if this fails."""
    _check(log, target, overwrite=overwrite)
    part = target.with_name(f"{target.name}.part")  # readers must never see an incomplete copy
    try:
        with open_output(part) as file:
            result = write(file)
        if target.exists():
            print_message(f"{target} already existed; the copy replaces it")
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)
    return result


def _check(log: Recording, target: Path, *, overwrite: bool) -> None:
    if log.live:
        raise ReplayError(f"{log.path} is still being written; copy it after its process has ended")
    if not target.exists():
        return
    if target.samefile(log.path):
        raise ReplayError(f"{target} is the recording itself; name another file")
    if not overwrite:
        raise ReplayError(f"{target} exists; name another file, or add --overwrite")
    with target.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ReplayError(f"{target} exists and isn't a recording; move it away, or name another file")
        if is_locked(file):
            raise ReplayError(f"{target} is being written by another process; name another file")


def add_pack(parser: argparse.ArgumentParser) -> None:
    add_output(parser, "whole")


def run_pack(log: Recording, options: argparse.Namespace) -> None:
    target: Path = options.output or log.path.with_name(f"{log.path.stem}.whole.mcap")
    write_copy(log, target, log.write_packed, overwrite=options.overwrite)
    shared = log.assets.shared
    models = "" if shared is None else shared.name
    of = f", including the models of {models}" if models else "; the recording already contained its models"
    print_result(
        lambda: {"file": str(target), "files": len(log.assets), "models": models},
        [f"{target}: {len(log.assets)} attached files{of}"],
        as_json=options.json,
    )
