"""``why``: why a plan failed, in plain words first."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from recorder.records import format_error
from replay.cli.console import print_json, remark, results_only, tell
from replay.cli.main import FINE, INCOMPLETE, USAGE
from replay.cli.why_json import facts
from replay.cli.why_text import lines
from replay.errors import Damaged
from replay.explain.step_names import HINT
from replay.explain.why import why
from replay.restore.pictures import write_pictures

if TYPE_CHECKING:
    import argparse

    from replay.explain.explanation import Why
    from replay.recording import Recording


def add(parser: argparse.ArgumentParser) -> None:
    """Takes which failure."""
    parser.add_argument("step", metavar="STEP", nargs="?", help=f"of another task that failed: {HINT}")
    parser.add_argument(
        "--pictures", metavar="DIR", help="write pictures of that moment: the robot's view, and one from the side"
    )


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints the explanation."""
    found = why(log, options.step)
    code, pictures = _pictures(log, found, options.pictures)
    if options.json:
        print_json(facts(found) | {"pictures": pictures})
    else:
        tell("\n".join(lines(found, str(log.path))))
        if pictures:
            tell("\n".join(("", "Pictures of that moment", *(f"  {path}" for path in pictures))))
    return code


def _pictures(log: Recording, found: Why, folder: str | None) -> tuple[int, list[str]]:
    """The pictures that were asked for; says why there are none if they can't be made."""
    if folder is None:
        return FINE, []
    if found.failure is None:
        remark("no pictures: nothing failed")
        return FINE, []
    try:
        with results_only():
            return FINE, [str(path) for path in write_pictures(log, found, Path(folder))]
    except Exception as error:  # noqa: BLE001  the explanation is worth more than its pictures
        remark(f"no pictures: {format_error(error)}")
        return INCOMPLETE if isinstance(error, Damaged) else USAGE, []
