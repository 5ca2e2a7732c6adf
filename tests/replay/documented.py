"""Commands that a page of the documentation shows, with the output that it shows: what a reader gets is the same."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

REPO = Path(__file__).parents[2]
FOLDER = re.compile(r"\S*demos/")
SECONDS = re.compile(r"# m?s\b")  # how long a thing takes here is no matter
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


class Shown(NamedTuple):
    """A block of a page: commands, and the lines that they print."""

    commands: list[str]
    lines: list[str]


def blocks(text: str) -> list[Shown]:
    """The blocks of commands in a page."""
    found = (block.splitlines() for block in re.findall(r"```console\n(.*?)```", text, re.DOTALL))
    return [
        Shown(
            [line.removeprefix("$ ") for line in block if line.startswith("$ ")],
            [line for line in block if not line.startswith("$ ")],
        )
        for block in found
    ]


def printed(commands: list[str], folder: Path) -> list[str]:
    """What commands print that a reader types in a folder with his recordings, beside the demos."""
    demos = folder / "demos"
    if not demos.exists():
        demos.symlink_to(REPO / "demos")
        (folder / "pycram-replay").write_text(f'#!/bin/sh\nexec {sys.executable} -m replay "$@"\n')
        (folder / "pycram-replay").chmod(0o755)
    script = 'PATH="$PWD:$PATH"\n' + "\n".join(commands)
    ended = subprocess.run(
        ["sh", "-c", script],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode in (0, 1), ended.stderr  # 1: what was looked for was found
    return ended.stdout.splitlines()


def without_numbers(line: str) -> str:
    """A line without what depends on the computer and the moment."""
    return SECONDS.sub("# s", NUMBER.sub("#", FOLDER.sub("demos/", line))).strip()
