# PYTHON_ARGCOMPLETE_OK
"""``pycram-replay VERB LOG ...``: results on stdout, messages on stderr."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from recorder.errors import discard, suggestion, until_closed
from recorder.packages import NotInstalled, needed
from recorder.terminal import Parser, complete, paged, typed_words
from replay.cli.console import print_message, progress
from replay.errors import Damaged, ReplayError, Unreadable

if TYPE_CHECKING:
    from replay.recording import Recording
    from replay.runs.folder import Runs

#: A verb's module is imported only when the verb is called, because some verbs need further libraries.
VERBS: Final = {
    "info": "summarise a run: plan, time, outcome, worlds, versions",
    "log": "print records as lines",
    "source": "list, print or save the plan's source",
    "show": "print one whole record",
    "tree": "print the task tree, with the path to the failure",
    "state": "print poses, joints and attachments after a step",
    "diff": "compare two steps, two recordings, or two folders of recordings",
    "blame": "find the last change of an object or a joint, and its cause",
    "why": "explain why the plan failed",
    "check": "check properties, such as 'never contact(pr2, kitchen)', and find the first violation",
    "ask": "answer a reasoning query at a step, optionally after moving objects",
    "render": "draw a picture of the scene at a step, without a viewer",
    "report": "write a page to send: the failure, why, pictures, a timeline, a film",
    "view": "show the recording in the Rerun viewer: scene, tasks, queries, curves",
    "verify": "check that a recording is consistent, and that repeating its changes has the recorded effects",
    "retrace": "run the plan again, and report the first difference from the recording",
    "fork": "run the plan again up to a step, then continue with another plan, world, answer or seed",
    "debug": "open a prompt at a step, in the plan's frame, and step forwards and back",
    "fix": "find the smallest edit with which the whole plan succeeds",
    "last-chance": "find the last step from which another choice or a repair leads to success",
    "minimise": "find a smaller plan and scene with the same failure",
    "test": "write a pytest that fails as the run did, and passes when the plan is repaired",
    "resume": "continue a plan whose process was killed",
    "export": "write a recording for Foxglove, its motions as a table (CSV, Parquet), or runs as a data set (LeRobot)",
    "repair": "copy the readable parts of a damaged recording, and list the lost parts",
    "pack": "copy a sweep's recording together with its models",
    "restore": "restore a live world for a script, in a shell, or in a window",
    "sql": "query the tables of a folder of recordings with SQL",
    "stats": "report success rates, causes of failures and slow parts of a folder of recordings",
    "separate": "find facts that separate failed from successful runs in a folder of recordings",
}
#: Verbs in the file of another verb. The functions of such a verb have names such as ``add_fork`` and ``run_fork``.
_FILES: Final = (
    dict.fromkeys(("show", "source", "tree"), "log")
    | dict.fromkeys(("fork", "resume"), "retrace")
    | {"diff": "state", "last-chance": "fix", "pack": "repair", "test": "minimise"}
)
_CHEAT: Final = "cheat"  # the only verb without a recording
_DEBUG: Final = "debug"
_READ: Final = tuple("info log source show tree state diff blame why check sql stats separate".split())  # noqa: SIM905
"""Verbs whose output is shown by a pager."""
_TAKE_INCOMPLETE: Final = ("debug", "resume")  # verbs that also take incomplete recordings
_FOLDER: Final = "the folder of recordings"
_LOG_HELP: Final = dict.fromkeys(("sql", "stats", "separate"), _FOLDER) | dict.fromkeys(
    ("info", "diff", "why", "check", "view", "export"), "the recording, or a folder of recordings"
)
FINE, FAILED, USAGE, INCOMPLETE, INTERNAL = 0, 1, 2, 3, 4
_INTERRUPTED = 130
_MAX_SKIPPED: Final = 8  # maximum number of skipped files that are named


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb, by default with the arguments of the process, and return the exit code."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # the shell closed the stream, whose descriptor the next opened file would get
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115  stays open until the process ends
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # terminals may not support all characters of names
    arguments = list(sys.argv[1:] if argv is None else argv)
    code = FINE
    try:
        with until_closed():
            code = _command(arguments)
    except OSError as error:
        discard(sys.stdout)
        return _report(str(error), USAGE)  # the disk may be full, for example
    except KeyboardInterrupt:
        return _INTERRUPTED
    return code


def _command(arguments: list[str]) -> int:
    if arguments == ["--version"]:
        from importlib.metadata import version  # noqa: PLC0415  slow to import

        print(f"pycram-replay {version('pycram')}")
        return FINE
    if (words := typed_words()) is not None:
        complete(_parser(words[:1], completing=True))
    if not arguments:
        _parser(()).print_help(sys.stderr)
        return USAGE
    first, *rest = arguments
    summarised = first not in VERBS and (first.endswith(".mcap") or Path(first).exists())
    if summarised:
        first, rest = "info", arguments
    elif first not in (*VERBS, _CHEAT) and not first.startswith("-"):
        return _report(f"there is no verb {first!r}; {suggestion(first, (*VERBS, _CHEAT))}", USAGE)
    try:
        options = _parser([first]).parse_args([first, *rest])
    except SystemExit as end:  # help or an error has been printed
        return FINE if not end.code else USAGE
    if options.verb == _CHEAT:
        from replay.cli.cheat import print_sheet  # noqa: PLC0415  as verbs

        with paged():
            print_sheet()
        return FINE
    if summarised:
        options.next_steps = True
    return _serve_editor(options) if options.log is None or getattr(options, "dap", False) else _run(options)


def _serve_editor(options: argparse.Namespace) -> int:
    if not options.dap:
        return _report("debug: give a recording, or use --dap with an editor that names the recording", USAGE)
    try:
        with needed():
            from replay.cli.debug_adapter import serve  # noqa: PLC0415  needs the executor

            serve(options.port, options.log)
    except NotInstalled as error:
        return _report(f"{options.verb}: {error}", USAGE)
    return FINE


def call(verb: str, log: Recording, arguments: Sequence[str]) -> None:
    """Run a verb on an open recording; raise ReplayError if it fails. After a message about wrong arguments, exit."""
    _function(verb, "run")(log, _parser([verb]).parse_args([verb, str(log.path), *arguments]))


def _own_error(error: Exception) -> str:
    """Write the traceback of an unexpected error to a file, and return a message with the name of the file."""
    import tempfile  # noqa: PLC0415  slow to import
    import traceback  # noqa: PLC0415

    text = "".join(traceback.format_exception(error))
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="pycram-replay-", suffix=".txt", delete=False, encoding="utf-8", errors="backslashreplace"
        ) as file:
            file.write(text)
    except OSError:
        return f"this is an internal error of PyCRAM; please report it with the recording:\n{text}"
    summary = traceback.format_exception_only(error)[-1].strip()
    return f"this is an internal error of PyCRAM; please report it with the recording and {file.name}: {summary}"


def _function(verb: str, name: str) -> Any:
    """Return the function of a verb with a name, or None: "add" adds arguments, "run" and "run_folder" run the verb.

    A function that runs the verb on a recording or on a folder may return an exit code.
    """
    module = importlib.import_module(f"replay.cli.{_FILES.get(verb, verb)}")
    return getattr(module, f"{name}_{verb.replace('-', '_')}" if verb in _FILES else name, None)


def _parser(arguments: Sequence[str], *, completing: bool = False) -> Parser:
    completers: Mapping[str, Callable[..., list[str]]] = {}
    if completing:
        from replay.cli.completion import COMPLETERS, add_cached  # noqa: PLC0415  only completion needs this module

        completers = COMPLETERS
    parser = Parser(
        prog="pycram-replay",
        description="Read recordings of robot plans, explain failures, and restore worlds. 'pycram-replay LOG' "
        "summarises a recording, 'pycram-replay VERB --help' shows examples of a verb.",
        epilog="Exit code 0: fine. 1: a check failed. 2: wrong usage. 3: incomplete recording. 4: internal error.",
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for name, text in VERBS.items():
        verb = verbs.add_parser(
            name,
            help=text,
            description=f"{text[0].upper()}{text[1:]}.",
            examples=lambda name=name: importlib.import_module("replay.cli.cheat").examples(name),
            completers=completers,
        )
        count = "?" if name == _DEBUG else None  # an editor may name the recording in a later message
        verb.add_argument("log", metavar="LOG", nargs=count, help=_LOG_HELP.get(name, "the recording"))
        if name in arguments and completing:
            module = _FILES.get(name, name)
            add_cached(name, module, verb, lambda parser: _function(parser.prog.split()[-1], "add")(parser))
        elif name in arguments:
            _function(name, "add")(verb)
        verb.add_argument("--json", action="store_true", help="print JSON")
    verbs.add_parser(_CHEAT, help="print a cheat sheet with examples of all verbs")
    return parser


def _run(options: argparse.Namespace) -> int:
    from replay.recording import Recording  # noqa: PLC0415  slow to import

    try:
        run = _function(options.verb, "run")
        if run is None or Path(options.log).is_dir():
            return _run_on_folder(options)
        with Recording(options.log) as log:
            if log.newer is not None:
                print_message(f"{log.path}: {log.newer}")
            try:
                with needed(), _paged(options):
                    code = run(log, options) or FINE
            except ReplayError as error:
                lost = log.problems or isinstance(error, Damaged | Unreadable)
                code = _report(str(error), INCOMPLETE if lost else USAGE)
            except NotInstalled as error:  # some verbs need more extras than others
                code = _report(f"{options.verb}: {error}", USAGE)
            problems = log.problems
    except Unreadable as error:
        return _report(str(error), INCOMPLETE)
    except ReplayError as error:
        return _report(str(error), USAGE)
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001  any exception that isn't expected is a defect of PyCRAM
        return _report(_own_error(error), INTERNAL)
    if problems and options.verb not in _TAKE_INCOMPLETE:
        return _report(f"the recording is incomplete: {problems}", code or INCOMPLETE)
    return code


def _paged(options: argparse.Namespace) -> AbstractContextManager[None]:
    return paged() if options.verb in _READ and not getattr(options, "follow", False) else nullcontext()


def _run_on_folder(options: argparse.Namespace) -> int:
    run = _function(options.verb, "run_folder")
    if run is None:
        takes = ", ".join(name for name in VERBS if name in _LOG_HELP)
        return _report(f"{options.log}: {options.verb} takes a single recording; verbs for folders are {takes}", USAGE)
    try:
        with needed(), opened(options.log) as runs, _paged(options):  # the verb may need a package that isn't installed
            code = run(runs, options)
            skipped = runs.skipped
    except NotInstalled as error:
        return _report(f"{options.verb}: {error}", USAGE)
    for left_out in skipped[:_MAX_SKIPPED]:
        print_message(f"left out: {left_out.name}: {left_out.reason}")
    if len(skipped) > _MAX_SKIPPED:
        print_message(f"left out: {len(skipped) - _MAX_SKIPPED} more")
    return code or (INCOMPLETE if skipped else FINE)


@contextmanager
def opened(path: str) -> Iterator[Runs]:
    """Open a folder of recordings, and print progress on a terminal."""
    with needed("runs"):
        from replay.runs.folder import Runs  # noqa: PLC0415  an extra
    with ExitStack() as opening:
        if Path(path).is_file():  # a single recording becomes a folder of one recording
            path = opening.enter_context(_folder_of(Path(path).absolute()))
        with progress("pycram-replay: reading recordings:") as show:
            runs = opening.enter_context(Runs(path, show))
        yield runs


@contextmanager
def _folder_of(file: Path) -> Iterator[str]:
    """Make a folder that contains this recording and the shared models of its folder."""
    import tempfile  # noqa: PLC0415  slow to import

    with tempfile.TemporaryDirectory() as folder:
        for each in (file, *file.parent.glob("models-*.mcap")):
            (Path(folder) / each.name).symlink_to(each)
        yield folder


def _report(text: str, code: int) -> int:
    sys.stdout.flush()
    print_message(text)
    return code


if __name__ == "__main__":
    sys.exit(main())
