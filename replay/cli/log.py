"""``log``: the records as lines, filtered; also while they are written."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from recorder.records import STEPS_PER_SECOND
from replay.cli.console import print_json, print_message, print_text
from replay.explain.search import Filter, Search
from replay.explain.step_names import HINT
from replay.file.chunks import KINDS
from replay.state.json_data import kind_of, record_data

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from recorder.records import Record
    from replay.recording import Recording

_POLL_PERIOD = 0.2  # s between reads of a recording that is being written


def add(parser: argparse.ArgumentParser) -> None:
    """Add filters."""
    parser.add_argument("--kind", choices=sorted(KINDS), action="append", help="only this kind of record; repeatable")
    parser.add_argument("--task", metavar="ID|NAME", help="only what this task and those below it did")
    parser.add_argument("--object", metavar="NAME", help="only records about this object")
    parser.add_argument("--world", metavar="NAME", help="only records about this world")
    parser.add_argument("--text", metavar="TEXT", help="only lines that contain this")
    parser.add_argument("--from", dest="start", default="0", metavar="STEP", help=f"first step: {HINT}")
    parser.add_argument("--to", dest="end", default="last", metavar="STEP", help="last step")
    parser.add_argument("--follow", action="store_true", help="go on while the recording is being written")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the lines; with ``--json`` one object a line."""
    criteria = Filter(options.kind or (), options.task, options.object, options.world, options.text)
    search = Search(log, criteria)
    start, stop = log.step(options.start), log.step(options.end) + 1
    matches = follow(log, search, start) if options.follow else search.matches(start, stop)
    for record, line in matches:
        if options.json:
            print_json(record_data(record) | {"text": line}, flush=options.follow)
        else:
            clock = f"{record.sim_step / STEPS_PER_SECOND:.3f}s" if record.world else ""
            print_text(
                f"{record.seq:6} {clock:>10} {kind_of(record):8} {_world(log, record)}{line}", flush=options.follow
            )
    return 0


def _world(log: Recording, record: Record) -> str:
    """Return the world of a record, if there is more than one."""
    lifetime = log.lifetime_at(record.world, record.seq) if record.world and len(log.lifetimes) > 1 else None
    return f"{lifetime.title}: " if lifetime is not None else ""


def follow(
    log: Recording, search: Search, start: int, pause: Callable[[], object] | None = None
) -> Iterator[tuple[Record, str]]:
    """Yield the matching records, and those that will be written, until the recording is closed or its process ends."""
    wait = pause or (lambda: threading.Event().wait(_POLL_PERIOD))
    while True:
        live = log.live  # before the last read, so that nothing is missed
        log.refresh()
        yield from search.matches(start, len(log))
        start = len(log)
        if log.closed or not live:
            if not log.closed:
                print_message("the process that wrote this recording has ended without closing it")
            return
        wait()
