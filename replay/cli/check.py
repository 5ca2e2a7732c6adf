"""``check``: check properties in a recording, or in each recording of a folder."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING

from recorder.properties import BadProperty, Property, parse, parse_file
from replay.cli.console import print_message, print_result
from replay.errors import ReplayError
from replay.explain.check import CheckedProperty, lines
from replay.recording import Recording
from replay.report import report
from replay.report.phrases import plural

if TYPE_CHECKING:
    from replay.runs.folder import Runs


def add(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "Exit code 1: a property is violated. docs/reference/properties.md explains the language. For a query at one "
        "step, such as 'reachable(milk, pr2)', use 'pycram-replay ask'."
    )
    parser.add_argument("properties", metavar="PROPERTY", nargs="*", help="such as 'never contact(pr2, kitchen)'")
    parser.add_argument(
        "-f", "--file", action="append", default=[], help="a file with a property on each line; # begins a comment"
    )


def run(log: Recording, options: argparse.Namespace) -> int:
    found = _check(log, _given(options))
    print_result(lambda: report.data(found), (line for each in found for line in lines(each)), as_json=options.json)
    return int(not all(found))


def run_folder(runs: Runs, options: argparse.Namespace) -> int:
    properties = _given(options)
    rows: list[tuple[str, list[CheckedProperty]]] = []
    for name in runs.folder.runs:
        with Recording(runs.path / name) as log:
            try:
                rows.append((name, _check(log, properties)))
            except ReplayError as error:  # the run may have ended before an object was loaded
                print_message(f"left out: {name}: {error}")
    text = []
    for number, each in enumerate(properties):
        violated = [name for name, found in rows if not found[number]]
        shown = f"; violated in {', '.join(violated[:3])}{', ...' if violated[3:] else ''}" if violated else ""
        text.append(f"{each}: holds in {len(rows) - len(violated)} of {plural(len(rows), 'run')}{shown}")
    print_result(lambda: {name: report.data(found) for name, found in rows}, text, as_json=options.json)
    return int(not all(each for _, found in rows for each in found))


def _given(options: argparse.Namespace) -> list[Property]:
    found = _parsed(options.properties, options.file, options.log)
    if not found:
        raise ReplayError("give a property, such as 'always milk.z > 0.5', or a file with -f")
    return found


def checked(log: Recording, texts: Sequence[str], files: Sequence[str]) -> list[CheckedProperty]:
    """Check the properties in texts and files; raise ReplayError for texts and files that can't be read."""
    return _check(log, _parsed(texts, files, str(log.path)))


def _parsed(texts: Sequence[str], files: Sequence[str], log: str) -> list[Property]:
    try:
        return [*map(parse, texts), *(each for file in files for each in parse_file(file))]
    except BadProperty as error:
        raise ReplayError(f"{error}{_as_query(error.text, log)}") from None
    except OSError as error:
        raise ReplayError(f"{error.filename}: {error.strerror}") from None


def _as_query(text: str, path: str) -> str:
    """Return the command for a text that isn't a property but a query; "" if the text contains no query."""
    try:
        from replay.restore.ask import BELIEVED, QUERIES  # noqa: PLC0415  imports the engine
    except ModuleNotFoundError:  # only queries need the physics engine
        return ""
    found = re.search(rf"\b({'|'.join((BELIEVED, *QUERIES))})\(.*\)", text)
    if found is None:
        return ""
    command = f"pycram-replay ask {shlex.quote(path)} STEP {shlex.quote(found[0])}"
    return f"; {found[1]} is a query about one step; ask it: {command}"


def _check(log: Recording, properties: list[Property]) -> list[CheckedProperty]:
    try:
        return log.check(*properties)
    except BadProperty as error:
        raise ReplayError(str(error)) from None
