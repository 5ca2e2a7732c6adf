"""The plan's own code raised the failure, or contains a mistake."""

from __future__ import annotations

import builtins
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder import notebook
from recorder.records import Fluent, Query, Refusal, Task, argument_values, from_json
from recorder.records.text import is_choice
from recorder.tasks import Node
from replay.explain.causes import trials
from replay.explain.causes.case import Cause
from replay.history.source import Line
from replay.report import phrases

if TYPE_CHECKING:
    from replay.explain.causes.case import FailureCase
    from replay.explain.causes.trials import Trial

_MAX_ANSWERS: Final = 3
_SEARCHED: Final = 1_000  # number of changes of fluents that are searched
#: ``raise`` or ``assert`` in a line, also after the head of a compound statement.
_RAISES: Final = re.compile(r"(^|[:;]\s*)(raise|assert)\b")
#: PyCRAM's usage errors. Errors that mean a mistake in the plan's line, even if they are raised inside a motion.
USAGE_ERRORS: Final = frozenset(
    (
        "AssetError", "AttachmentError", "BadArgument", "BlockClosed", "ChangeRefused", "Deadlock",
        "DeadlockedBranches", "DesignatorError", "DisplayError", "FollowsTrajectory", "JointLimitError", "LockHeld",
        "Misnested", "NoDescription", "NoProcessModule", "NoResult", "NoWorld", "NotExplorable", "NotProjectable",
        "NotSettable", "NotTrueOrFalse", "ObjectsChanged", "OutlivesTimeout", "PluginFailed", "ReadOnly",
        "ResourceError", "RunsEarly", "SweepRefused", "UnknownName", "UsageError", "WorldClosed",
    )
)  # fmt: skip
_INTERRUPTS: Final = ("KeyboardInterrupt", "TimedOut", "Cancelled")


@dataclass(frozen=True, slots=True)
class Raised(Cause):
    """The plan's own code raised the failure, or has a mistake that Python or PyCRAM rejected."""

    kind = "raised"
    untestable = "the plan's own code would have to change"
    type: str  # type of the exception
    line: Line  # the plan's line
    own: bool  # whether the line is a ``raise`` or ``assert``, rather than a mistake
    task: Node | None  # the task around the line; None if there is none
    #: The answers on which the line may depend: the last queries and waits of its task. If the last motion of the task
    #: before these changes failed, the end of that motion comes first. For a ``whenever``, the last change of the
    #: fluents that it follows.
    answers: tuple[Query | Task | Fluent, ...] = ()

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Raised]:
        """Yield the plan's line that raised the failure, or raised another exception because of it."""
        yield from _raised_while_handling(case)
        error = next(reversed(case.traced), None)
        asked = case.source.call_stack(case.motion.started) if case.motion is not None else ()
        lines = error.lines or asked if error is not None else ()
        if error is None or not lines or case.failure.type in (*_INTERRUPTS, "PropertyViolated"):
            return
        in_motion = case.motion is not None
        refused = case.failure.type in USAGE_ERRORS or (hasattr(builtins, case.failure.type) and not in_motion)
        if (in_motion and not error.own and not refused) or not (error.own or refused or case.task is None):
            return
        line = lines[-1] if error.own else case.line(lines) or lines[-1]
        own = error.own and _is_raise(line)
        judged = (*_failed_before(case), *answers(case), *_watched(case)) if own else ()
        steps = {*(each.seq for each in judged), *(each.seq for each in _refusals(case)), case.step}
        yield Raised(tuple(sorted(steps)), case.failure.type, line, own, case.task, judged)

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether the change is known that wrote the value of the plan's check."""
        return self.own and not self.answers and any(each.kind == "written" for each in found)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials with other answers, longer waits, another arm, or without the refused call of a mistake."""
        if not self.own:
            yield from (each for refusal in _refusals(case) for each in trials.skipped(refusal))
            return
        for each in reversed(self.answers):
            if isinstance(each, Query):
                yield from trials.other_answer(each)
            elif isinstance(each, Task) and each.kind == "wait":
                earlier = (record for record in case.log.backwards(each.seq - 1, Task) if record.task == each.task)
                started = next(record for record in earlier if record.phase == Task.STARTED)
                given = argument_values(started.parameters)
                yield from trials.fulfilled(started, given)
                yield from trials.longer(started, given.get("timeout"))
            elif isinstance(each, Task):
                failed = next((motion for motion in case.failed.motions if motion.id == each.task), None)
                if failed is not None:
                    yield from trials.seen(case, failed)
                    yield from trials.other_arm(case, failed)

    def _words(self) -> Iterator[str]:
        what = "the plan raised the failure" if self.own else f"a mistake in the plan: {self.type}"
        inside = f", in {phrases.node(self.task)}" if self.task is not None else ""
        yield f"{what} at {phrases.place(self.line)}{inside}: {phrases.short(self.line.text)}"
        for answer in self.answers:
            yield f"before, at step {answer.seq}: {_answer(answer)}"


def _answer(record: Query | Task | Fluent) -> str:
    if isinstance(record, Query):
        reasons = phrases.reasons(record) if record.candidates else ""
        return f"{phrases.question(record)}: {phrases.answer(record)}" + (f"; {reasons}" if reasons else "")
    if isinstance(record, Fluent):
        at = (
            f", at {notebook.place(phrases.path(record.source_file), record.source_line)}" if record.source_line else ""
        )
        return f"{record.name} became {phrases.value(from_json(record.after_json))}{at}"
    if record.kind != "wait":
        return f"{record.name} failed: {phrases.short(phrases.one_line(record.failure.message))}"
    done = "it became true" if from_json(record.result_json) is True else "it didn't become true in time"
    return f"waited for {record.name}: {done}"


def _is_raise(line: Line) -> bool:
    return _RAISES.search(line.text) is not None


def _raised_while_handling(case: FailureCase) -> Iterator[Raised]:
    """Yield the line that raised another error while the plan handled the task's failure."""
    last = next(reversed(case.exceptions), None)
    end = case.task.motion.finished if case.task is not None else None
    failure = (case.failure.type, case.failure.message)
    if last is None or end is None or not last.lines or (last.type, last.message) == failure:
        return
    if last.type == "DeadlockedBranches":
        return  # the other branches waited for the failed branch
    if last.own if _is_raise(last.lines[-1]) else last.type in USAGE_ERRORS or hasattr(builtins, last.type):
        line = last.lines[-1] if last.own else case.line(last.lines) or last.lines[-1]
        yield Raised((end.seq,), last.type, line, last.own and _is_raise(line), None, (end,))


def is_mistake(case: FailureCase) -> bool:
    """Return whether Python or PyCRAM rejects the plan's code whatever the state of the world is."""
    return case.failure.type in USAGE_ERRORS or hasattr(builtins, case.failure.type)


def _refusals(case: FailureCase) -> Iterator[Refusal]:
    """Yield the last refusal if it is the failure."""
    for refusal in case.log.backwards(case.step, Refusal) if case.log.counts().get("refusal") else ():
        if (refusal.failure.type, refusal.failure.message) == (case.failure.type, case.failure.message):
            yield refusal
        return


def _failed_before(case: FailureCase) -> Iterator[Task]:
    """Yield the end of the last motion in the same task if the motion failed."""
    scope = None if case.task is None else case.task.id
    ended = [
        motion
        for motion in case.failed.motions
        if motion.last_step < case.step and (scope is None or scope in [node.id for node in motion.around()])
    ]
    last = max(ended, key=lambda motion: motion.last_step, default=None)
    if last is not None and last.failed and last.finished is not None and case.is_here(last.started):
        yield last.finished


def _watched(case: FailureCase) -> Iterator[Fluent]:
    """Yield the last change of a fluent of a failed ``whenever``."""
    if case.task is None or case.task.kind != "whenever":
        return
    for record in islice(case.log.backwards(case.step, Fluent), _SEARCHED):
        if record.name in case.task.name:
            yield record
            return


def answers(case: FailureCase) -> Iterator[Query | Task]:
    """Yield the last queries and waits of the same task before the failure, in order."""
    inside = {0} if case.task is None else {case.task.id}
    start = (
        case.task.started.seq if case.task is not None else max((m.last_step for m in case.failed.motions), default=0)
    )
    found: list[Query | Task] = []
    for record in case.log.backwards(case.step, (Query, Task)):
        if record.seq < start or len(found) == _MAX_ANSWERS:
            break
        if isinstance(record, Query) and record.task in inside and not is_choice(record):
            found.append(record)
        elif isinstance(record, Task) and record.phase == Task.FINISHED and record.parent in inside:
            if record.kind == "wait":
                found.append(record)
            else:
                break
    yield from reversed(found)
