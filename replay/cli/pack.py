"""``pack``: a copy of a sweep's recording that holds its models itself, and can go anywhere alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.cli.console import print_result
from replay.cli.repair import add_output, write_copy

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    """Add the copy's path."""
    add_output(parser, "whole")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Write the copy."""
    target: Path = options.output or log.path.with_name(f"{log.path.stem}.whole.mcap")
    write_copy(log, target, log.write_packed, overwrite=options.overwrite)
    shared = log.assets.shared
    models = "" if shared is None else shared.name
    of = f", those of {models} among them" if models else "; it held them itself before"
    print_result(
        lambda: {"file": str(target), "files": len(log.assets), "models": models},
        [f"{target}: {len(log.assets)} attached files{of}"],
        as_json=options.json,
    )
    return 0
