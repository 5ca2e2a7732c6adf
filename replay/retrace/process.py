"""The process in which a plan runs again; :mod:`.plan_process` starts it.

Its result is one line of JSON on the file descriptor that it is given: stdout and stderr are the plan's. When it is
only to compare, it ends there, wherever the plan is then. A fork goes on, into a recording of its own.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NoReturn

from pycram import running
from pycram.projection.child import die_with
from pycram.reasoning.queries.query import answered_by
from pycram.scheduling.cancellation import uninterruptible
from pycram.scheduling.schedule import seed_order
from pycram.scheduling.strikes import guide_strikes
from pycram.seeding import seed_random_numbers
from recorder.errors import PortableError, RecordingError
from recorder.mcap.sink import McapSink
from recorder.provenance import metadata
from recorder.recording import redirected
from recorder.records import Change, Run, escaped, format_error
from recorder.tracing.journal import NullSink
from recorder.tracing.process_identity import process
from replay.file.record_reader import RecordReader
from replay.retrace.answers import Answers
from replay.retrace.changes import BadChange, parse_setting, text_of
from replay.retrace.guide import Guide
from replay.retrace.steering import Steering

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from google.protobuf.message import Message

    from pycram.scheduling.schedule import Foreseen
    from recorder.records import Record
    from recorder.records.asset import AssetFile
    from recorder.tracing.journal import Sink
    from replay.retrace.guide import Difference

_STDOUT, _STDERR = 1, 2


class _Guided:
    """A sink that is guided by a recording; that of a fork writes one of its own as well.

    Args:
        guide: compares the records.
        file: the fork's recording; None to compare only.
        steering: makes the changes.
        moved: the folder that the plan's recorded source was written to, and the one that it came from.
        passed: called when a step has passed, and what is changed after it.
    """

    def __init__(
        self,
        guide: Guide,
        file: McapSink | None,
        steering: Steering,
        moved: tuple[str, str] | None,
        passed: Callable[[], None],
    ) -> None:
        self._guide = guide
        self._file = file
        self._steering = steering
        self._moved = moved
        self._passed = passed
        self.path = guide.path if file is None else file.path
        self.lock = None if file is None else file.lock

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self._steering.complete(record)
        if self._moved is not None:
            rename(record, *self._moved)
        if self._file is not None:
            self._file.write(topic, record, record.SerializeToString())
        self._guide.write(topic, record, payload)
        self._steering.passed(record.seq, self._passed)

    def attach(self, asset: AssetFile) -> None:
        if self._file is not None:
            self._file.attach(asset)

    def flush(self) -> None:
        if self._file is not None:
            self._file.flush()

    def close(self) -> None:
        self._guide.close()
        if self._file is not None:
            self._file.close()


def rename(message: Message, old: str, new: str) -> None:
    """Put another folder's name in place of one in all texts of a message."""
    for field, value in message.ListFields():
        if field.cpp_type == field.CPPTYPE_MESSAGE:
            for part in value if _is_repeated(value) else [value]:
                rename(part, old, new)
        elif field.type == field.TYPE_STRING and _is_repeated(value):
            value[:] = [text.replace(old, new) for text in value]
        elif field.type == field.TYPE_STRING and old in value:
            setattr(message, field.name, value.replace(old, new))


def _is_repeated(value: object) -> bool:
    return hasattr(value, "append")


def make_change(change: Change) -> None:
    """Make a change; of the plan's lines none has done it, as call stacks end here."""
    if change.seed:
        seed_random_numbers(int(change.seed))
        seed_order(int(change.seed))
        return
    with uninterruptible():
        parse_setting(change.set, fluent=not change.world).make(change.world)


@dataclass(frozen=True, slots=True)
class Request:
    """What a process is to do.

    Attributes:
        log: the recording.
        plan: the plan's file.
        arguments: of the plan.
        seed: of random numbers; None to leave them as they are.
        order: of branches, where it isn't drawn from the seed.
        by_program: whether the plan begins the recording itself.
        result: the file descriptor for the result.
        output: the file descriptor for what a fork prints.
        until: the last step that is compared; None for all.
        file: the fork's recording; None to end when all is compared.
        folder: for the recordings of its projections, where it is only compared.
        take_answers: whether queries have the recorded answers, and aren't asked.
        changes: the fields of what is to be changed after its steps.
        moved: the folder that the plan's recorded source was written to, and the one that it came from.
        parent: the process that asks, with which this one ends.
    """

    log: str
    plan: str
    arguments: Sequence[str]
    seed: int | None
    by_program: bool
    result: int
    output: int
    until: int | None
    file: str | None
    folder: str
    take_answers: bool
    changes: Sequence[Mapping[str, Any]]
    moved: tuple[str, str] | None
    parent: int


def main(text: str) -> None:
    """Run a plan again as a request says, given as JSON."""
    request = Request(**json.loads(text))
    die_with(request.parent)
    _GuidedRun(request).run()


class _GuidedRun:
    """A plan that runs again in this process."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self._recorded = RecordReader(request.log)
        self._changes = [Change(**each) for each in request.changes]
        self._guide = Guide(self._recorded, self._report, request.until, Path(request.folder) / Path(request.log).name)
        self._answers = Answers(self._guide, taken=request.take_answers, refuse=self._refuse)
        self._steering = Steering(self._changes, self._answers, make_change, self._refuse)
        self._sent = False
        self._equal: int | None = None  # number of equal records, when the comparison has ended

    def run(self) -> None:
        """Run it to its end, unless the process ends before."""
        request = self._request
        with answered_by(self._answers):
            run_plan(
                request.plan,
                request.arguments,
                request.seed,
                self._recorded,
                self._sink_of,
                self._guide.foreseen,
                by_program=request.by_program,
                file=Path(request.file or os.devnull),
            )
        self._guide.close()
        if self._steering.due:
            change = self._steering.due[0]
            self._refuse(BadChange(text_of(change), f"the plan ended before that could be after step {change.step}"))

    def _sink_of(self, run: Run) -> Sink:
        request, began = self._request, self._recorded[0]
        if request.moved is not None and isinstance(began, Run):  # else it would be that of no repository
            run.plan.CopyFrom(began.plan)
        file = None
        if request.file is not None:
            run.origin.recording, run.origin.wall_time_ns = self._recorded.path.name, began.wall_time_ns
            run.origin.step = len(self._recorded) - 1 if request.until is None else request.until
            run.origin.changes.extend(self._changes)
            try:
                file = McapSink(Path(request.file), metadata(run))
            except RecordingError as error:
                self._refuse(error)
        return _Guided(self._guide, file, self._steering, request.moved, self._go_on)

    def _report(self, equal: int, difference: Difference | None) -> None:
        self._equal = equal
        if self._request.file is None or difference is not None:
            self._send(difference=None if difference is None else asdict(difference))
            os._exit(0)

    def _go_on(self) -> None:
        """Leave the recording, if its last step that is compared has passed, and what follows it is changed."""
        if self._equal is None or self._sent:
            return
        self._send(difference=None)
        for stream, descriptor in ((sys.__stdout__, _STDOUT), (sys.__stderr__, _STDERR)):
            if stream is not None:
                stream.flush()
            os.dup2(self._request.output, descriptor)  # what the plan prints from here on is new

    def _refuse(self, error: Exception) -> NoReturn:
        self._send(error=str(error) if isinstance(error, PortableError) else format_error(error))
        os._exit(0)

    def _send(self, **facts: object) -> None:
        self._sent = True
        answer = {"equal": self._equal, "taken": self._answers.taken, **facts}
        os.write(self._request.result, json.dumps(answer).encode() + b"\n")


def run_plan(
    plan: str,
    arguments: Sequence[str],
    seed: int | None,
    recorded: RecordReader,
    sink_of: Callable[[Run], Sink],
    foreseen: Foreseen,
    *,
    by_program: bool,
    file: Path = Path(os.devnull),
) -> None:
    """Run a plan as a program, whatever it ends with.

    Args:
        plan: the plan's file.
        arguments: of the plan.
        seed: of random numbers; None to leave them as they are.
        recorded: the recording that it has made.
        sink_of: gives the sink for that recording, when the plan makes it again.
        foreseen: gives the strikes of the recorded run.
        by_program: whether the plan begins the recording itself.
        file: where it would be recorded.
    """
    owner, began, guided = process(), recorded[0], False

    def redirect(run: Run) -> Sink | None:
        nonlocal guided
        if run.by_program != by_program or process() != owner:  # a projection makes a recording of its own
            return None
        if guided or not _is_meant(run, began, plan):
            return NullSink()  # what a program records beside the recording in question
        guided = True
        if isinstance(began, Run) and began.HasField("looks"):  # else an older release made it
            guide_strikes(lambda look: foreseen(look) if process() == owner else None, began.looks)
        return sink_of(run)

    with redirected(redirect):
        if by_program:
            sys.argv = [getattr(began, "called_as", "") or plan, *arguments]
            sys.path.insert(0, str(Path(plan).parent.resolve()))
            with contextlib.suppress(BaseException):  # whatever it raises: the recording has it
                _run_program(plan)
        else:
            order, motion = getattr(began, "order", ""), getattr(began, "environment", "")
            given = {each.name: json.loads(each.value_json) for each in getattr(began, "parameters", ())}
            running.run(running.RunSpec(Path(plan), tuple(arguments), seed, order, motion, given), file)


def _run_program(plan: str) -> None:
    """Run a file as Python does it, under whatever name it was called: runpy would name it by its path."""
    module = ModuleType("__main__")
    module.__file__ = plan
    sys.modules["__main__"] = module
    exec(compile(Path(plan).read_bytes(), plan, "exec"), module.__dict__)  # noqa: S102  the plan


def _is_meant(run: Run, began: Record, plan: str) -> bool:
    """Whether a recording that a plan begins is the one that was made before, by their first records."""
    named = run.name in (getattr(began, "name", ""), escaped(Path(plan).stem))
    return named and run.number == (getattr(began, "number", 0) or 1)  # an older release's: the first
