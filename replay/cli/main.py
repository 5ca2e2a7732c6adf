"""``pycram-replay VERB LOG ...``: results on stdout, talk on stderr.

Exit codes: 0 fine, 1 a check failed, 2 wrong usage, 3 done as far as possible, but the recording was incomplete.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import re
import sys
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.extras import NotInstalled, needed
from replay.cli.console import remark
from replay.errors import Damaged, ReplayError, Unreadable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

#: A verb's module is loaded when it is called: some need what others can do without.
VERBS: Final = {
    "info": "what ran, when, for how long, and how it ended",
    "log": "the records as lines",
    "show": "one record whole",
    "tree": "the tasks, how they ended, and the way down to the failure",
    "state": "poses, joints and attachments after a step",
    "diff": "what is different between two steps, or two recordings",
    "blame": "what last changed an object or a joint, and why",
    "why": "why the plan failed, in plain words",
    "ask": "any reasoning query at a step, also with things moved",
    "render": "a picture of a step, without a viewer",
    "view": "the recording in the Rerun viewer: scene, tasks, queries, curves",
    "verify": "whether a recording is sound, and its changes, made again, have the effects on record",
    "restore": "a live world as it was: for a script, in a shell, in a window",
}
FINE, FAILED, USAGE, INCOMPLETE = 0, 1, 2, 3
_INTERRUPTED = 130
_POINTS: Final = ("--from", "--to")
_NEGATIVE: Final = re.compile(r"-[\d.]")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a verb.

    Args:
        argv: the arguments; the process' own by default.

    Returns:
        The exit code.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # closed by the shell: what is opened later would take its place
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115  until the process ends
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names may have letters that a terminal has not
    given = _joined(sys.argv[1:] if argv is None else argv)
    if given == ["--version"]:
        print(f"pycram-replay {version('pycram')}")
        return FINE
    verb = _module(given[0]) if given and given[0] in VERBS else None
    try:
        options = _parser(given[:1], verb).parse_args(given)
    except SystemExit as end:  # after its help, or its complaint
        return FINE if not end.code else USAGE
    try:
        code = _run(_module(options.verb), options)
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left goes nowhere
        if isinstance(error, BrokenPipeError):  # somebody's head has seen enough
            return FINE
        return _complain(str(error), USAGE)  # as that the disk is full
    except KeyboardInterrupt:
        return _INTERRUPTED
    return code


def _joined(given: Sequence[str]) -> list[str]:
    """Arguments with points that begin with a minus joined to their options; alone they would be taken for options."""
    joined: list[str] = []
    for text in given:
        if joined and joined[-1] in _POINTS and _NEGATIVE.match(text):
            joined[-1] += f"={text}"
        else:
            joined.append(text)
    return joined


def _module(verb: str) -> ModuleType:
    return importlib.import_module(f"replay.cli.{verb}")


def _parser(given: Sequence[str], module: ModuleType | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="pycram-replay",
        description="Looks into recordings of plans.",
        epilog="Exit codes: 0 fine, 1 a check failed, 2 wrong usage, 3 done, but the recording was incomplete.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and end")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, text in VERBS.items():
        verb = verbs.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        verb.add_argument("log", metavar="LOG", help="the recording")
        if module is not None and name in given:
            module.add(verb)
        verb.add_argument("--json", action="store_true", help="for machines")
    return parser


def _run(verb: ModuleType, options: argparse.Namespace) -> int:
    from replay.recording import open_recording  # noqa: PLC0415  --help needn't wait for it

    try:
        with open_recording(options.log) as log:
            try:
                with needed():
                    code: int = verb.run(log, options)
            except ReplayError as error:
                lost = log.missing or isinstance(error, Damaged | Unreadable)
                code = _complain(str(error), INCOMPLETE if lost else USAGE)
            except NotInstalled as error:  # reading needs little, but rebuilding a world needs the executor
                code = _complain(f"{options.verb}: {error}", USAGE)
            missing = log.missing
    except Unreadable as error:
        return _complain(str(error), INCOMPLETE)
    except ReplayError as error:
        return _complain(str(error), USAGE)
    if missing:
        return _complain(f"the recording is incomplete: {missing}", code or INCOMPLETE)
    return code


def _complain(text: str, code: int) -> int:
    sys.stdout.flush()
    remark(text)
    return code


if __name__ == "__main__":
    sys.exit(main())
