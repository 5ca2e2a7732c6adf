"""Completion of names that a recording holds: steps, objects, joints, worlds and tasks."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

from recorder.terminal import files_ending

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from recorder.records import LoadBody
    from replay.recording import Recording

_LIMIT: Final = 0.1  # s that reading a long recording may take: names that come later aren't offered


def _names(find: Callable[[Recording], Iterator[str]]) -> Callable[..., list[str]]:
    """Return a completer of the names that a function finds in the recording."""

    def complete(prefix: str, parsed_args: argparse.Namespace, **_: object) -> list[str]:
        from replay.errors import ReplayError  # noqa: PLC0415  verbs and options are completed without a recording
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


def _joints(log: Recording) -> Iterator[str]:
    for body in _loaded(log):
        yield from (body.body, *(f"{body.body}.{joint}" for joint in body.joints))


def _within_limit(records: Iterator[Any]) -> Iterator[Any]:
    end = time.monotonic() + _LIMIT
    for record in records:
        if time.monotonic() > end:
            return
        yield record


def _steps_and_files(prefix: str, **given: Any) -> list[str]:
    return [*COMPLETERS["STEP"](prefix, **given), *files_ending(".mcap")(prefix)]


#: Completers by the names or the placeholders of arguments.
COMPLETERS: Final[dict[str, Callable[..., list[str]]]] = {
    "LOG": files_ending(".mcap"),
    "LOG2": files_ending(".mcap"),
    "STEP": _names(_steps),
    "STEP|LOG": _steps_and_files,
    "object": _names(lambda log: (body.body for body in _loaded(log))),
    "OBJECT[.JOINT]": _names(_joints),
    "world": _names(lambda log: (lifetime.world for lifetime in log.lifetimes)),
    "task": _names(_tasks),
}
