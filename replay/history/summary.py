"""A summary of a recording: plan, times, worlds and outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from recorder.records import STEPS_PER_SECOND, Run, format_failure
from replay.errors import Unreadable
from replay.file.record_reader import RecordReader
from replay.history.tasks import INTERRUPT, failed_threads

#: Size in bytes up to which a recording is read completely. Of larger recordings, only both ends are read.
MAX_CHECKED: Final = 16 << 20


@dataclass(frozen=True, slots=True)
class WorldTime:
    """A world and its clock."""

    world: str
    lifetime: int  # number of the world's lifetime, from 1
    seconds: float  # simulated time at the last change, s


@dataclass(frozen=True, slots=True)
class Summary:
    """A summary of a recording."""

    plan: str
    started: datetime  # wall-clock time of the first record, UTC
    seconds: float  # time from the first to the last record, s
    worlds: tuple[WorldTime, ...]  # the worlds in the order of their opening
    outcome: str  # "succeeded", "failed", "interrupted", "running", "cut off", or "lost" if the end is damaged
    failure: str  # failure of the plan, such as "Type: message"; "" without a failure
    #: Names and failures of threads of the plan that failed while the plan continued.
    threads: tuple[tuple[str, str], ...]
    records: int  # number of steps
    counts: Mapping[str, int]  # number of records of each kind
    attachments: int
    size: int  # size of the file in bytes
    problems: str  # missing or damaged parts, as text; "" if there are none
    checked: bool  # whether the whole file was read
    metadata: Mapping[str, str]  # metadata of the run
    start: Run | None  # the first record, with the plan's arguments; None if the record is lost


def summary(log: RecordReader) -> Summary:
    """Summarise a recording; raise Unreadable if all records are damaged."""
    size = log.path.stat().st_size
    checked = size <= MAX_CHECKED
    problems = log.check_file() if checked else log.problems
    first, last = next(log.records(), None), next(log.backwards(), None)
    if first is None or last is None:
        raise Unreadable(log.path, f"has no record that can be read: {problems}")
    end = last if isinstance(last, Run) and last.phase == Run.FINISHED else None
    is_lost = end is None and any(gap.start >= len(log) for gap in log.missing())
    unfinished = "running" if log.live else "lost" if is_lost else "cut off"
    failed = "interrupted" if end is not None and end.failure.type == INTERRUPT else "failed"
    outcome = unfinished if end is None else "succeeded" if end.succeeded else failed
    elapsed_ns = last.monotonic_ns - first.monotonic_ns  # this is correct even if the wall clock jumped
    if not last.monotonic_ns:  # old recordings lack this steady clock
        elapsed_ns = last.wall_time_ns - first.wall_time_ns
    ends = [(lifetime, log.end_of(lifetime)) for lifetime in log.lifetimes]
    steps = [(lifetime, end.sim_step if end is not None else 0) for lifetime, end in ends]
    return Summary(
        plan=log.metadata.get("plan", ""),
        started=datetime.fromtimestamp(first.wall_time_ns / 1e9, UTC),
        seconds=elapsed_ns / 1e9,
        worlds=tuple(WorldTime(each.world, each.number, step / STEPS_PER_SECOND) for each, step in steps),
        outcome=outcome,
        failure=format_failure(end.failure) if end is not None and end.HasField("failure") else "",
        threads=tuple((record.thread, format_failure(record.failure)) for record in failed_threads(log)),
        records=len(log),
        counts=log.counts(),
        attachments=len(log.assets),
        size=size,
        problems=problems,
        checked=checked,
        metadata=log.metadata,
        start=first if isinstance(first, Run) else None,
    )
