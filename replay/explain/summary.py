"""What ran, when, for how long, and how it ended: read from both ends of a recording, whatever its length."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from recorder.records import STEPS_PER_SECOND, Keyframe, Mutation, Run, format_failure

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.records import Record
    from replay.file.lifetimes import Lifetime
    from replay.file.log import Log

#: Recordings up to this size are read whole to tell whether they are sound, bytes; of larger ones only both ends.
CHECKED: Final = 16 << 20
_ENDS: Final = 2  # records of the run itself: that it started, that it finished


@dataclass(frozen=True, slots=True)
class Simulated:
    """A world and its clock.

    Attributes:
        world: its name.
        life: which world of that name it is, from 1.
        seconds: its simulated time at its last change, s.
    """

    world: str
    lifetime: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Summary:
    """A recording in short.

    Attributes:
        plan: name of the plan.
        started: wall-clock time of the first record.
        seconds: wall-clock time from the first to the last record.
        worlds: with the simulated time that each reached, in the order of their opening.
        outcome: "succeeded", "failed", "running" or "cut off".
        failure: what the plan failed with, as "Type: message"; or "".
        threads: failures that ended threads of the plan's own while it went on, with the names of the threads.
        records: number of steps.
        counts: number of records of each kind.
        attachments: number of attached files.
        size: of the file, bytes.
        missing: in words, what of the recording is missing; or "".
        checked: whether every part was read to tell so.
        metadata: all that the recorder said of the run.
    """

    plan: str
    started: datetime
    seconds: float
    worlds: tuple[Simulated, ...]
    outcome: str
    failure: str
    threads: tuple[tuple[str, str], ...]
    records: int
    counts: Mapping[str, int]
    attachments: int
    size: int
    missing: str
    checked: bool
    metadata: Mapping[str, str]


def _simulated(log: Log, lifetime: Lifetime) -> Simulated:
    end = log.end_of(lifetime)
    return Simulated(lifetime.world, lifetime.number, end.sim_step / STEPS_PER_SECOND if end is not None else 0.0)


def summary(log: Log) -> Summary:
    """Sums up a recording.

    Args:
        log: the recording.
    """
    size = log.path.stat().st_size
    checked = size <= CHECKED
    missing = log.check() if checked else log.missing
    first, last = next(log.records()), next(log.backwards())
    end = last if isinstance(last, Run) and last.phase == Run.FINISHED else None
    outcome = "running" if log.live else "cut off"
    if end is not None:
        outcome = "succeeded" if end.succeeded else "failed"
    return Summary(
        plan=log.metadata.get("plan", ""),
        started=datetime.fromtimestamp(first.wall_time_ns / 1e9, UTC),
        seconds=(last.wall_time_ns - first.wall_time_ns) / 1e9,
        worlds=tuple(_simulated(log, lifetime) for lifetime in log.lifetimes),
        outcome=outcome,
        failure=format_failure(end.failure) if end is not None and end.HasField("failure") else "",
        threads=tuple((record.thread, format_failure(record.failure)) for record in failed_threads(log)),
        records=len(log),
        counts=log.counts(),
        attachments=len(log.assets),
        size=size,
        missing=missing,
        checked=checked,
        metadata=log.metadata,
    )


def failed_threads(log: Log) -> tuple[Run, ...]:
    """The records of threads of the plan's own that ended with a failure while it went on.

    Args:
        log: the recording.
    """
    if log.counts().get("run", 0) <= _ENDS:
        return ()
    runs = (record for record in log.records(Run) if isinstance(record, Run))
    return tuple(record for record in runs if record.phase == Run.THREAD_FAILED)


def final_of(log: Log) -> int:
    """The last step before worlds were closed at the end: plans that clean up leave nothing to look at behind it."""
    closing = len(log)
    for record in log.backwards(-1, (Mutation, Keyframe)):
        if not closes(record):
            break
        closing = record.seq
    return max(closing - 1, 0)


def closes(record: Record) -> bool:
    """Whether a record is the end of a world."""
    return isinstance(record, Mutation) and record.HasField("close_world")
