"""One run of a sweep, in a process of its own: the plan from its start, and a recording that appears when whole."""

from __future__ import annotations

import json
import os
import time
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pycram import running
from pycram.failures import PlanFailure
from pycram.models import warming
from pycram.physics import head_start
from pycram.projection.child import limit_memory
from pycram.seeding import MAX_SEED
from pycram.sweeping.folder import name_of
from pycram.sweeping.values import Variations
from recorder.errors import RecordingError
from recorder.mcap.sink import McapSink
from recorder.provenance import metadata
from recorder.recording import record, redirected
from recorder.records import Query, Run, Task, format_failure
from recorder.tracing.journal import NullSink

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pycram.physics.head_start import HeadStart
    from recorder.mcap.shared_models import SharedModels
    from recorder.records import Record
    from recorder.tracing.journal import Sink

HOOKS: Final = "pycram.runs"
"""Group of entry points: functions that are called with the path of a recording whose plan began, in its run's process.

If none of a sweep's plan begins, its recording is set aside: nothing is to be left of it under its name.
"""
_TIME_LIMIT: Final = "TimeLimit"


class RunLost(PlanFailure):
    """The process of a run ended before the plan did, and again when it was tried once more."""


@dataclass(frozen=True, slots=True)
class Spec:
    """What all runs of a sweep have in common.

    Attributes:
        plan: Its file, absolute.
        folder: Where the recordings go, absolute.
        seed: From which the seeds of the runs and what is drawn for them follow.
        arguments: Of the plan.
        listed: Values of parameters.
        sampled: Distributions of parameters.
        motion: The execution environment where the plan names none; "" for "simulated".
        local_variables: Whether failures hold the plan's local variables.
        limit: Seconds by the clock that a run may take.
        memory: Bytes that a run may take; 0 for any number.
    """

    plan: str
    folder: str
    seed: int = 0
    arguments: tuple[str, ...] = ()
    listed: Mapping[str, list[Any]] = field(default_factory=dict)
    sampled: Mapping[str, str] = field(default_factory=dict)
    motion: str = ""
    local_variables: bool = True
    limit: float = 300.0
    memory: int = 0

    def values(self, number: int) -> dict[str, Any]:
        """Return the values of a run's parameters."""
        return Variations(self.listed, self.sampled).of(self.seed, number)

    def seed_of(self, number: int) -> int:
        """Return a run's seed."""
        return (self.seed + number) % (MAX_SEED + 1)

    def name(self, number: int) -> str:
        """Return the name of a run's recording."""
        return name_of(number, self.values(number))

    def part(self, number: int) -> Path:
        """Return where a run is recorded until it is whole."""
        return Path(self.folder) / f".{self.name(number)}.part"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What has come of a run.

    Attributes:
        number: Its number.
        name: That of its recording.
        succeeded: Whether the plan did.
        failure: Why not, in words.
        seconds: How long it took.
        started: Whether it came as far as a task or a query.
        lost: Whether its process ended before the plan did.
        unrecorded: Why it couldn't be recorded; "" if it was.
        remark: What went wrong beside it.
    """

    number: int
    name: str
    succeeded: bool
    failure: str = ""
    seconds: float = 0.0
    started: bool = True
    lost: bool = False
    unrecorded: str = ""
    remark: str = ""


class _RunSink(McapSink):
    """The recording of a run, which takes note of how it ends."""

    end: Run | None = None
    started = False
    late: Callable[[], str] = str

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self.started = self.started or isinstance(record, Task | Query)
        if isinstance(record, Run) and record.phase == Run.FINISHED:
            if record.interrupted_by and (cause := self.late()):
                record.failure.type, record.failure.message = _TIME_LIMIT, cause
                payload = record.SerializeToString()
            self.end = record
        super().write(topic, record, payload)


def run_once(
    spec: Spec,
    number: int,
    attempt: int,
    models: SharedModels | None,
    began: float,
    *,
    start: HeadStart | None = None,
    lost: str = "",
) -> bytes:
    """Run the plan once, in a child of the sweep; return the outcome, and what the next runs had better find done.

    Args:
        spec: The sweep's.
        number: Of the run.
        attempt: Which one it is, from 1.
        models: Files that the recording refers to.
        began: When that was, by the system's monotonic clock, in s.
        start: What the engine has done already; None if what would be good to have done is to be noted.
        lost: Why the run's process ended each time; then only that is recorded.
    """
    process, plan, part = os.getpid(), Path(spec.plan), spec.part(number)
    values, seed = spec.values(number), spec.seed_of(number)
    if spec.memory and not lost:
        limit_memory(spec.memory)
    sinks: list[_RunSink] = []
    refused: list[str] = []

    def late() -> str:
        over = time.monotonic() - began >= spec.limit
        return f"the run still went on after {spec.limit:g} s" if over else ""

    def sink_of(run: Run) -> Sink | None:
        if os.getpid() != process:  # a projection has a recording of its own
            return None
        if sinks:  # what a plan records itself, all runs would write to the same file
            return NullSink()
        run.sweep.number, run.sweep.seed, run.sweep.attempt = number, spec.seed, attempt
        try:
            sinks.append(_RunSink(part, metadata(run), models=models))
        except RecordingError as error:
            refused.append(error.cause)
            raise
        sinks[0].late = late
        sinks[0].path = Path(spec.folder) / spec.name(number)  # beside which projections are recorded
        return sinks[0]

    prepared = nullcontext() if lost else _noted() if start is None else start.taken()
    with redirected(sink_of), prepared as noted:
        if lost:
            _record_loss(spec, values, seed, lost)
        else:
            one = running.RunSpec(
                plan,
                spec.arguments,
                seed,
                motion=spec.motion,
                parameters=values,
                local_variables=spec.local_variables,
            )
            running.run(one, part, overwrite=True)
    sink = sinks[0] if sinks else None
    name = spec.name(number)
    if sink is None or sink.lost or sink.end is None:
        part.unlink(missing_ok=True)
        why = "".join(refused) if sink is None else sink.lost
        return _answer(Outcome(number, name, succeeded=False, unrecorded=why or "its end is missing"))
    path = part.replace(Path(spec.folder) / name)
    failure = "" if sink.end.succeeded else format_failure(sink.end.failure)
    remark = _call_hooks(path) if sink.started or sink.end.succeeded else ""
    outcome = Outcome(
        number,
        name,
        sink.end.succeeded,
        failure,
        seconds=time.monotonic() - began,
        started=sink.started,
        lost=bool(lost),
        remark=remark,
    )
    return _answer(outcome, noted)


def _record_loss(spec: Spec, values: Mapping[str, Any], seed: int, cause: str) -> None:
    plan = Path(spec.plan)
    with (
        suppress(RunLost),
        record(
            spec.part(0),  # the sink knows where
            name=plan.stem,
            arguments=spec.arguments,
            source=plan,
            seed=seed,
            environment=spec.motion,
            parameters=values,
            overwrite=True,
        ),
    ):
        raise RunLost(cause)


@contextmanager
def _noted() -> Iterator[tuple[warming.Notes, head_start.Notes]]:
    with warming.noted() as notes, head_start.noted() as calls:
        yield notes, calls


def _answer(outcome: Outcome, noted: tuple[warming.Notes, head_start.Notes] | None = None) -> bytes:
    return json.dumps({"outcome": asdict(outcome), "noted": noted and [each.text() for each in noted]}).encode()


@cache
def hooks() -> tuple[Callable[[Path], object], ...]:
    """Return what installed packages do with each recording."""
    return tuple(each.load() for each in entry_points(group=HOOKS))


def _call_hooks(path: Path) -> str:
    """Call them; what goes wrong in them costs no run."""
    try:
        for hook in hooks():
            hook(path)
    except Exception as error:  # noqa: BLE001  whatever it raises
        return f"{type(error).__name__}: {error}"
    return ""
