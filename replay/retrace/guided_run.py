"""Run a plan again in this process, guided by its recording. :mod:`.plan_process` starts the process.

The plan's call stacks end at the first frame of this module. The plan calls the sinks of records, so the sinks are in
:mod:`.guide`.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from pycram import running
from pycram.foundation.forcing import decided_by
from pycram.projection.child import die_with
from pycram.reasoning.queries.query import answered_by
from pycram.running import seed_random_numbers
from pycram.scheduling.cancellation import guide_strikes, uninterruptible
from pycram.scheduling.schedule import seed_order
from recorder.errors import RecordingError
from recorder.mcap_sink import McapSink
from recorder.provenance import metadata
from recorder.recording import redirected
from recorder.records import Change, Check, Run, escaped
from recorder.tracing.forking import process
from recorder.tracing.journal import NullSink, Sink
from replay.file.record_reader import RecordReader
from replay.retrace.changes import AnswerOracle, PendingChanges, change_text, parse_setting
from replay.retrace.decisions import BadChange
from replay.retrace.guide import Guide, GuidedSink
from replay.retrace.plan_process import FirstDifference, Guidance

_STDOUT, _STDERR = 1, 2


def make_change(change: Change) -> None:
    """Make a change of a fork."""
    if change.seed:
        seed_random_numbers(int(change.seed))
        seed_order(int(change.seed))
        return
    with uninterruptible():
        parse_setting(change.set, fluent=not change.world).make(change.world)


class GuidedRun:
    """A run of a plan in this process: records are compared, queries answered, and changes made after their steps.

    The folder is for recordings of projections. ``report`` is explained in :class:`replay.retrace.guide.Guide`, and
    ``refuse`` in :class:`replay.retrace.changes.PendingChanges`.
    """

    def __init__(
        self,
        guidance: Guidance,
        folder: Path,
        report: Callable[[int, FirstDifference | None], None],
        refuse: Callable[[Exception], NoReturn],
    ) -> None:
        self.guidance = guidance
        self.recorded = RecordReader(guidance.log)
        began = self.recorded[0]
        assert isinstance(began, Run)  # noqa: S101  for mypy: the other process has checked this
        self.began = began
        self.guide = Guide(self.recorded, report, guidance.until, folder / self.recorded.path.name)
        self.answers = AnswerOracle(self.guide, taken=guidance.take_answers, refuse=refuse)
        self.changes = PendingChanges(guidance.changes, self.answers, make_change, refuse)

    def sink(self, *sinks: Sink, file: McapSink | None = None, passed: Callable[[], None] = lambda: None) -> GuidedSink:
        """Return the sink for the run's records: a file if given, the comparison, and other sinks.

        ``passed`` is called after each step and the changes after it.
        """
        return GuidedSink(
            self.guide.path if file is None else file.path,
            [*([] if file is None else [file]), self.guide, *sinks],
            self.changes.complete,
            lambda step: self.changes.passed(step, passed),
            self.guidance.moved,
            None if file is None else file.lock,
        )

    def run(
        self, plan: str, arguments: Sequence[str], sink_of: Callable[[Run], Sink], file: Path = Path(os.devnull)
    ) -> None:
        """Run a plan as a program. The function returns even if the plan raises an exception.

        When the plan starts its recording, ``sink_of`` returns a sink that replaces the file.
        """
        owner, began, by_program, guided = process(), self.began, self.guidance.by_program, False

        def redirect(run: Run) -> Sink | None:
            nonlocal guided
            if run.by_program != by_program:
                return None
            named = run.name in (began.name, escaped(Path(plan).stem))
            same_number = run.number == (began.number or 1)  # older recordings don't contain this number
            if guided or not (named and same_number):
                return NullSink()  # the program has started another recording
            guided = True
            if began.HasField("looks"):  # older recordings don't contain the number of polls
                guide_strikes(lambda look: self.guide.foreseen(look) if process() == owner else None, began.looks)
            return sink_of(run)

        decided = any(change.answer for change in self.guidance.changes)
        forcing = decided_by(self.answers) if decided else contextlib.nullcontext()
        with answered_by(self.answers), forcing, redirected(redirect):
            run_plan(began, spec_of(self.recorded, began, plan, arguments), file)


def spec_of(recorded: RecordReader, began: Run, plan: str | Path, arguments: Sequence[str]) -> running.RunSpec:
    """Return the settings of a recorded run, for the plan and its arguments. ``began`` is the first record."""
    watched = [each for each in recorded.records(Check) if each.by_run and each.phase == Check.WATCHED]
    return running.RunSpec(
        Path(plan),
        tuple(arguments),
        int(began.seed) if began.seed.isdecimal() else None,
        began.order,
        began.environment,
        {each.name: json.loads(each.value_json) for each in began.parameters},
        tuple(each.property for each in watched),
        any(each.only_record for each in watched),
    )


def run_plan(began: Run, spec: running.RunSpec, file: Path, *, overwrite: bool = False) -> None:
    """Run a recorded plan in this process, as the recorded command or program did; return even if the plan fails."""
    if not began.by_program:
        running.run(spec, file, overwrite=overwrite)
        return
    plan = str(spec.plan)
    sys.argv = [began.called_as or plan, *spec.arguments]
    sys.path.insert(0, str(spec.plan.parent.resolve()))
    module = ModuleType("__main__")  # as Python names it; runpy would name the module by its path
    module.__file__ = plan
    sys.modules["__main__"] = module
    with contextlib.suppress(BaseException):  # the recording contains the exception
        exec(compile(Path(plan).read_bytes(), plan, "exec"), module.__dict__)  # noqa: S102  the plan


def main() -> None:
    """Run a plan again as the JSON argument of the process requests (:meth:`.PlanProcess.run`)."""
    request = json.loads(sys.argv[1])
    die_with(request.pop("parent"))
    guidance = Guidance.of_json(request.pop("guidance"))
    plan, arguments = request.pop("plan"), request.pop("arguments")
    _ReportedRun(guidance, **request).run(plan, arguments)


class _ReportedRun:
    """A guided run whose result, a line of JSON, another process reads from the file descriptor ``result``.

    A fork continues after the comparison, records into a ``file``, and prints to the file descriptor ``output``.
    Without a file, the run ends when the comparison has ended.
    """

    def __init__(self, guidance: Guidance, *, result: int, output: int, file: str | None, folder: str) -> None:
        self._guided = GuidedRun(guidance, Path(folder), self._report, self._refuse)
        self._result = result
        self._output = output
        self._file = file
        self._sent = False
        self._equal: int | None = None  # number of equal records, once the comparison has ended

    def run(self, plan: str, arguments: Sequence[str]) -> None:
        """Run the plan to its end, unless the process ends earlier."""
        self._guided.run(plan, arguments, self._sink_of, Path(self._file or os.devnull))
        self._guided.guide.close()
        if self._file is not None and self._sent:
            self._send(difference=None)
        due = self._guided.changes.due
        if due:
            why = f"the plan ended before this change, which comes after step {due[0].step}"
            self._refuse(BadChange(change_text(due[0]), why))

    def _sink_of(self, run: Run) -> Sink:
        recorded, began, guidance = self._guided.recorded, self._guided.began, self._guided.guidance
        if guidance.moved is not None:  # the folder of a moved plan isn't in a repository
            run.plan.CopyFrom(began.plan)
        file = None
        if self._file is not None:
            run.origin.recording, run.origin.wall_time_ns = recorded.path.name, began.wall_time_ns
            run.origin.step = len(recorded) - 1 if guidance.until is None else guidance.until
            run.origin.changes.extend(guidance.changes)
            try:
                file = McapSink(Path(self._file), metadata(run))
            except RecordingError as error:
                self._refuse(error)
        return self._guided.sink(file=file, passed=self._leave)

    def _report(self, equal: int, difference: FirstDifference | None) -> None:
        self._equal = equal
        if self._file is None or difference is not None:
            self._send(difference=None if difference is None else asdict(difference))
            os._exit(0)

    def _leave(self) -> None:
        """End the run after the last compared step and the changes after it."""
        if self._equal is None or self._sent:
            return
        self._send(difference=None)
        for stream, descriptor in ((sys.__stdout__, _STDOUT), (sys.__stderr__, _STDERR)):
            if stream is not None:
                stream.flush()
            os.dup2(self._output, descriptor)  # from this moment on, the plan's output is new

    def _refuse(self, error: Exception) -> NoReturn:
        self._send(error=str(error))
        os._exit(0)

    def _send(self, **facts: object) -> None:
        self._sent = True
        taken, notes = self._guided.answers.taken, self._guided.guide.notes()
        answer = {"equal": self._equal, "taken": taken, "notes": notes, "unused": self._guided.answers.unused, **facts}
        os.write(self._result, json.dumps(answer).encode() + b"\n")
