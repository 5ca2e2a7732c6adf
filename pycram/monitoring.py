"""Properties that are watched while a plan runs (:mod:`recorder.properties`).

A monitor gets each record when it is written, so it sees the same records in the same order as a reader. A monitor
doesn't affect random numbers or the order of branches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from pycram.foundation.failures import PropertyViolated
from pycram.language.nesting import scope, sequential
from pycram.models.load import Model
from pycram.reasoning.queries.measured import ContactClient
from pycram.scheduling.schedule import scheduler
from pycram.world.world import open_worlds
from recorder.properties import Monitor, Property, Violation, parse
from recorder.properties.language import AT_END
from recorder.properties.monitor import FOLLOWED
from recorder.records import Check, LoadBody, Mutation, Record, arguments
from recorder.tracing import journal, span
from recorder.tracing.context import current_name
from recorder.tracing.journal import Journal, NullSink


@scope
def monitored(*properties: str, only_record: bool = False) -> Iterator[None]:
    """Watch properties, such as ``never contact(pr2, kitchen)``, in the ``with`` block.

    Actions of the block run in order. A violation raises PropertyViolated at the next checkpoint of its branch. At the
    end of the block, ``eventually`` and ``at end`` are decided.

    Args:
        only_record: Whether violations are recorded without an error.

    Raises:
        PropertyViolated: A property is violated.
        BadProperty: A text isn't a property (docs/reference/properties.md), or contains an unknown name.
    """
    with sequential() as settle, watched(properties, only_record=only_record):
        yield
        settle()


@contextmanager
def watched(properties: Sequence[str], *, by_run: bool = False, only_record: bool = False) -> Iterator[list[str]]:
    """Watch properties in the block as :func:`monitored` does, and yield the growing list of messages of violations.

    With ``by_run``, the block is the whole run.
    """
    if not properties:
        yield []
        return
    sink = _MonitorSink([parse(each) for each in properties], by_run=by_run, only_record=only_record)
    with _attached(sink):
        yield sink.violations
        sink.finish()


@contextmanager
def _attached(sink: _MonitorSink) -> Iterator[None]:
    """Pass the records of the present recording, or else of a new journal, to a sink."""
    journals = journal.listening()
    if not journals:
        sink.log = Journal([sink])
        journal.open_journal(sink.log, span.running())
        try:
            yield
        finally:
            journal.close_journal(sink.log)
        return
    sink.log = journals[-1]
    with ExitStack() as locked:
        worlds = open_worlds()
        for world in worlds:
            locked.enter_context(world.lock)
        for each in sink.properties:
            sink.record(Check(phase=Check.WATCHED, property=each.text))
        for record in locked.enter_context(span.running()):
            sink.follow(record)
        for world in worlds:
            frame = world.transactions.keyframe()
            frame.world, frame.sim_step, frame.seq = world.name, world.sim_step, sink.log.length
            sink.follow(frame)
        sink.log.add_sink(sink)
    try:
        yield
    finally:
        sink.log.remove_sink(sink)


class _MonitorSink(NullSink):
    log: Journal

    def __init__(self, properties: Sequence[Property], *, by_run: bool, only_record: bool) -> None:
        self.properties = properties
        self._by_run, self._only_record = by_run, only_record
        self._monitor = Monitor(properties, ContactClient(_model_of))
        self._recorded = journal.recording()
        self._errors: list[PropertyViolated] = []
        self.violations: list[str] = []
        self._lines: dict[int, str] = {}  # the plan's lines, by steps

    def write(self, topic: str, record: Record, payload: bytes) -> None:  # noqa: ARG002  a sink's
        """Follow a record. The journal writes the records of violations after this record."""
        self.follow(record)

    def follow(self, record: Record) -> None:
        """Record the violations at a record; raise them at the next checkpoint of this branch."""
        if not isinstance(record, FOLLOWED):
            return
        if isinstance(record, Mutation) and record.source_file:
            self._lines[record.seq] = f"{Path(record.source_file).name}:{record.source_line}"
        for violation in self._monitor.feed(record):
            error = self._violated(violation)
            if not self._only_record:
                scheduler().fail_later(error)
                self._errors.append(error)

    def finish(self) -> None:
        """End the properties; raise the first violation that wasn't raised before."""
        ended = [self._violated(violation) for violation in self._monitor.finish()]
        self._monitor.verdicts()  # raises BadProperty for names that never existed in the run
        scheduler().take_failure()
        for error in (*self._errors, *ended):
            if error.__traceback__ is None and not self._only_record:
                raise error

    def record(self, record: Check) -> None:
        """Append a record of a property; the journal writes this record after the record that led to the call."""
        record.by_run, record.only_record = self._by_run, self._only_record
        record.thread = current_name()
        record.task = record.task or journal.task_id()
        stack = span.current_call_stack()
        record.source_file, record.source_line = stack.line
        record.callers.extend(stack.callers)
        self.log.append(record)

    def _violated(self, violation: Violation) -> PropertyViolated:
        at, margin, since = violation.moment, violation.margin, ""
        if violation.statement.kind == AT_END and violation.since is not None and self._recorded:
            line = self._lines.get(violation.since.step)
            since = f", since step {violation.since.step}{f' in {line}' if line else ''}"
        record = Check(
            phase=Check.VIOLATED,
            property=violation.statement.text,
            world=at.world,
            sim_step=self._monitor.worlds[at.world].sim_step if at.world in self._monitor.worlds else at.sim_step,
            task=at.task,
            step=at.step,
            moment=at.sim_step,
            margin=margin if abs(margin) < float("inf") else None,
            values=arguments(violation.values),
            reason=violation.cause + since,
        )
        self.record(record)
        error = PropertyViolated(
            record.property,
            at.step if self._recorded else -1,
            at.seconds,
            record.margin if record.HasField("margin") else None,
            violation.values,
            record.reason,
        )
        self.violations.append(str(error))
        return error


def _model_of(world: str, loaded: LoadBody) -> Model:
    return next(each for each in open_worlds() if each.name == world).get_object(loaded.body).model
