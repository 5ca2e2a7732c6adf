"""``log``: the records as lines, filtered."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from google.protobuf.json_format import MessageToDict

from recorder.log_lines import text_of
from recorder.records import TOPICS, Mutation
from replay.log import KINDS
from replay.steps import step_of

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from recorder.records import Record
    from replay.log import Log

HELP = "the records as lines"


def add(parser: argparse.ArgumentParser) -> None:
    """Takes filters."""
    parser.add_argument("--kind", choices=sorted(KINDS), action="append", help="only records of this kind; repeatable")
    parser.add_argument("--object", help="only records that tell of this object")
    parser.add_argument("--task", type=int, help="only records of the task with this id")
    parser.add_argument("--text", help="only lines that contain this")
    parser.add_argument("--from", dest="start", default="0", metavar="STEP", help="first step")
    parser.add_argument("--to", dest="end", default="last", metavar="STEP", help="last step")


def matching(log: Log, options: argparse.Namespace) -> Iterator[tuple[Record, str]]:
    """The records that the filters let through, with their lines."""
    kinds = tuple(KINDS[kind] for kind in options.kind or KINDS)
    for record in log.records(start=step_of(log, options.start), stop=step_of(log, options.end) + 1):
        if not isinstance(record, kinds):
            continue
        if options.task is not None and record.task != options.task:
            continue
        if options.object and not _tells_of(record, options.object):
            continue
        line = text_of(record)[0]
        if options.text and options.text not in line:
            continue
        yield record, line


def _tells_of(record: Record, name: str) -> bool:
    if isinstance(record, Mutation):
        command = getattr(record, record.WhichOneof("command") or "reset")
        moved = (state.body for state in record.effect.bodies)
        return name in (getattr(command, "body", None), getattr(command, "carrier", None), *moved)
    return json.dumps(name) in str(MessageToDict(record, preserving_proto_field_name=True))


def run(log: Log, options: argparse.Namespace) -> tuple[object, str]:
    """Lists them.

    Returns:
        The records, for machines and for people.
    """
    found = list(matching(log, options))
    facts = [
        {"step": record.seq, "kind": TOPICS[type(record)][1:], "task": record.task, "text": line}
        for record, line in found
    ]
    return facts, "\n".join(
        f"{record.seq:6} {record.sim_step / 240:8.3f}s {TOPICS[type(record)][1:]:8} {line}" for record, line in found
    )
