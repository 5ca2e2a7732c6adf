"""Completion of the names in a recording: steps, objects, joints, worlds and tasks."""

from __future__ import annotations

import argparse
import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from recorder.system import cache_folder
from recorder.terminal import Parser, files_ending

if TYPE_CHECKING:
    from recorder.records import LoadBody
    from replay.recording import Recording

_LIMIT: Final = 0.1  # time in s after which names in a recording are no longer read for completion


def add_cached(verb: str, module: str, parser: Parser, add: Callable[[argparse.ArgumentParser], None]) -> None:
    """Add the arguments of a verb from the cache, because importing the module of the verb takes too long."""
    source, folder = Path(__file__).with_name(f"{module}.py"), cache_folder()
    file = None if folder is None else folder / f"completion-{verb}.json"
    key = [str(source), source.stat().st_mtime_ns]
    with contextlib.suppress(OSError, ValueError, TypeError):
        found, arguments = json.loads(file.read_text(encoding="utf-8")) if file is not None else (None, ())
        if found == key:
            for flags, options in arguments:
                parser.add_argument(*flags, **options)
            return
    before = len(parser._actions)  # noqa: SLF001  argparse has no public list of arguments
    add(parser)
    arguments = [_plain(action) for action in parser._actions[before:]]  # noqa: SLF001  as above
    with contextlib.suppress(OSError):
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps([key, arguments]), encoding="utf-8")


def _plain(action: argparse.Action) -> tuple[list[str], dict[str, object]]:
    """Return the flags of an argument, and the options of ``add_argument`` that completion needs."""
    options: dict[str, object] = {"choices": action.choices and [*action.choices], "metavar": action.metavar}
    if action.nargs == 0:
        options = {"action": "store_true"}
    elif action.nargs is not None:
        options["nargs"] = action.nargs
    if not action.option_strings:
        return [action.dest], options
    return [*action.option_strings], options | {"dest": action.dest}


def _names(find: Callable[[Recording], Iterator[str]]) -> Callable[..., list[str]]:
    """Return a completer for the names that a function finds in the recording."""

    def complete(prefix: str, parsed_args: argparse.Namespace, **_: object) -> list[str]:
        from replay.errors import ReplayError  # noqa: PLC0415  verbs and options can be completed without a recording
        from replay.recording import Recording  # noqa: PLC0415  as above

        try:
            with Recording(parsed_args.log) as log:
                found = dict.fromkeys(find(log))
        except (ReplayError, OSError):
            return []
        return [name for name in found if name.startswith(prefix)]

    return complete


def _tasks(log: Recording) -> Iterator[str]:
    from recorder.records import Task  # noqa: PLC0415  slow to import

    return (record.name for record in _within_limit(log.records(Task)))


def _steps(log: Recording) -> Iterator[str]:
    yield from ("last", "failure")
    yield from (f"task:{name}@{end}" for name in dict.fromkeys(_tasks(log)) for end in ("start", "end"))


def _loaded(log: Recording) -> Iterator[LoadBody]:
    from recorder.records import Mutation  # noqa: PLC0415  slow to import

    return (record.load_body for record in _within_limit(log.records(Mutation)) if record.HasField("load_body"))


def _within_limit(records: Iterator[Any]) -> Iterator[Any]:
    end = time.monotonic() + _LIMIT
    for record in records:
        if time.monotonic() > end:
            return
        yield record


#: Completers by the name or placeholder of an argument.
COMPLETERS: Final[dict[str, Callable[..., list[str]]]] = {
    "LOG": files_ending(".mcap"),
    "LOG2": files_ending(".mcap"),
    "STEP": _names(_steps),
    "STEP|LOG": lambda prefix, **given: [*COMPLETERS["STEP"](prefix, **given), *files_ending(".mcap")(prefix)],
    "object": _names(lambda log: (body.body for body in _loaded(log))),
    "OBJECT[.JOINT]": _names(
        lambda log: (f"{body.body}{joint}" for body in _loaded(log) for joint in ("", *(f".{j}" for j in body.joints)))
    ),
    "world": _names(lambda log: (lifetime.world for lifetime in log.lifetimes)),
    "task": _names(_tasks),
}
