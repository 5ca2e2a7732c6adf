"""``repair``: a sound copy of whatever can be read of a recording, and a list of what is lost."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from replay.cli.console import print_result
from replay.cli.copies import add_output, write_copy
from replay.file.repair import range_text

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from pathlib import Path

    from replay.file.repair import Losses
    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    """Add the copy's path."""
    add_output(parser, "sound")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Write the copy, and print what it lacks."""
    target: Path = options.output or log.path.with_name(f"{log.path.stem}.sound.mcap")
    losses = write_copy(log, target, log.write_sound, overwrite=options.overwrite)
    print_result(
        lambda: _data(losses) | {"file": str(target), "files": len(log.assets) - len(losses.files)},
        _lines(log, target, losses),
        as_json=options.json,
    )
    return 0


def _data(losses: Losses) -> dict[str, object]:
    data: dict[str, object] = asdict(losses)
    steps = [[gap.start, gap.stop - 1] for gap in losses.steps]
    return data | {"steps": steps, "chunks": {str(number): cause for number, cause in losses.chunks.items()}}


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
        yield "lost   nothing that can be known of"
