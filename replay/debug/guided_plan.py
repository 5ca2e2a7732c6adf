"""A recorded plan that runs again, stopped at a step: from step to step, forwards and back."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from replay.debug.copies import Copies, EndedByInterrupt
from replay.errors import Damaged, ReplayError
from replay.retrace.guide import Difference
from replay.retrace.outside import likely_reasons
from replay.retrace.plan_process import PlanProcess

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path
    from typing import Self

    from replay.debug.channel import Message
    from replay.debug.stops import Watched
    from replay.file.record_reader import RecordReader

_PARTS: Final = 40  # of a run, with a copy at the beginning of each
_SHORTEST: Final = 50_000_000  # ns of a part
_FINEST: Final = 4  # steps from a copy to where one goes back to


class Interrupted(ReplayError):
    """Somebody has pressed Ctrl-C until the plan's process was ended; the plan is where it was before, or at its start.

    Attributes:
        step: where that is; -1: it came to no step at all.
    """

    def __init__(self, step: int) -> None:
        super().__init__(f"the plan came to no other step; it is at {f'step {step} again' if step >= 0 else 'none'}")
        self.step = step


@dataclass(frozen=True, slots=True)
class Arrival:
    """Where a plan has stopped.

    Attributes:
        step: the last recorded step that it has made.
        reason: "step": it was to come there; "watch": what was watched has changed; "interrupted": by Ctrl-C; "parted":
            what comes next is another record than the recorded one.
        text: how it differs.
        changes: steps, numbers of what was watched, values before and after.
    """

    step: int
    reason: str = "step"
    text: str = ""
    changes: list[tuple[int, int, str, str]] = field(default_factory=list)


class GuidedPlan:
    """A recorded plan, at a step.

    Args:
        log: the recording.
        plan: another file than the recorded one.
        arguments: other arguments than the recorded ones.
        checkpoints: whether copies of it wait at some steps; else going back is to run it again from its start.
        recorded_source: whether the source that is attached to the recording runs, instead of that on the disk.

    Attributes:
        step: the last recorded step that it has made; -1 before the first.
        recorded_files: the recorded source by its files' paths, if that runs.
        notes: what is different from when it was recorded.
        last: the last step that it can come to.
        parted: how it differs from the recording after that step, and lines that may be why, as they read the world
            outside; "" if it isn't known to.

    Raises:
        CantRetrace: the plan isn't there, or the recording doesn't tell how it was run.
        Damaged: the beginning of the recording is lost.
    """

    def __init__(
        self,
        log: RecordReader,
        plan: str | Path | None = None,
        arguments: Sequence[str] | None = None,
        *,
        checkpoints: bool = True,
        recorded_source: bool = False,
    ) -> None:
        process = PlanProcess(log, plan, arguments, recorded_source=recorded_source)
        self.recorded_files = process.recorded_files
        self.notes = tuple(process.notes())
        self.step = -1
        self.last = len(log) - 1
        self._log = log
        self.parted = ""
        log.check()  # what is lost is known only then
        gap = next(iter(log.lost()), None)
        if gap is not None:
            self.last, self.parted = gap.start - 1, f"step {gap.start} is lost"
        if self.last < 0:
            raise Damaged(log.path, "its beginning", "nothing of it is left to guide the plan")
        self._copies = Copies(process, _spacing(log) if checkpoints and hasattr(os, "fork") else None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all processes."""
        self._copies.close()

    @property
    def checkpoints(self) -> list[int]:
        """The steps at which copies wait."""
        return sorted(each.step for each in self._copies.waiting)

    @property
    def runs(self) -> int:
        """How often it was run from its start."""
        return self._copies.runs

    def go(self, step: int, watched: Sequence[Watched] = (), *, through: bool = False) -> Arrival:
        """Bring the plan to a step, forwards or back.

        Args:
            step: the step.
            watched: expressions; the plan goes on from where it is, and stops where one of their values changes.
            through: whether it doesn't: the changes are only noted, up to the step.

        Raises:
            PlanEnded: its process has ended before; it is at no step then.
            Interrupted: by Ctrl-C, twice, as it came to no step; it is where it was before.
            ReplayError: it is another plan, whose first record differs.
        """
        copies = self._copies
        if copies.now is None and watched:
            self.go(self.step)
        now = copies.now
        usable = [now] if watched else [now, *copies.waiting]
        before = [
            each
            for each in usable
            if each is not None and not each.parted and (each.step < step or (each.step == step and not each.between))
        ]
        origin = max(before, key=lambda each: each.step, default=None)
        if now is not None and now is not origin and now not in copies.waiting:
            copies.end(now)
        if origin is not None and origin.step == step and not watched:
            copies.now, self.step = origin, step
            return Arrival(step)
        left = self.step
        try:
            message: Message | None = None
            if origin is None:
                message = copies.start()
                origin = copies.now
            if origin is not None and not origin.parted and (origin.step < step or watched):
                expressions = [[each.expression, each.file, each.first] for each in watched]
                message = copies.go_on(
                    origin,
                    {
                        "until": step,
                        "checkpoints": list(_halving(origin.step, step)) if step < left else [],
                        "watched": expressions,
                        "through": through,
                    },
                )
        except EndedByInterrupt:
            if step > 0 or left >= 0:
                self.go(max(left, 0))
            raise Interrupted(self.step) from None
        arrival = self._arrived(message) if message is not None else Arrival(step)
        copies.thin_out(self.step)
        return arrival

    def _arrived(self, message: Message) -> Arrival:
        found = message["difference"]
        if message["step"] < 0 and found is not None:
            raise ReplayError(f"this isn't the plan of the recording: {found['text']}")
        self.step = message["step"]
        if found is not None:
            difference = Difference(**found)
            self.last = difference.step - 1
            self.parted = "; ".join((difference.text, *likely_reasons(self._log, difference)))
        return Arrival(self.step, message["reason"], self.parted if found else "", message["changes"])

    def ask(self, what: str, **arguments: object) -> Any:
        """Ask the stopped plan something; see :meth:`replay.debug.stops.StoppingSink._answer`.

        Raises:
            PlanEnded: its process has ended.
            ReplayError: it can't be answered there.
            KeyboardInterrupt: somebody has pressed Ctrl-C; nothing has changed.
        """
        answer = self._copies.ask({"do": what, **arguments})
        if "error" in answer:
            raise ReplayError(answer["error"])
        return answer["answer"]


def _spacing(log: RecordReader) -> int:
    """Return the nanoseconds of the recording between copies: by its own clock, as this machine may be busy or idle."""
    return max(log[-1].monotonic_ns // _PARTS, _SHORTEST)


def _halving(start: int, step: int) -> Iterator[int]:
    """Yield steps from one to another, each half as far from it as the one before."""
    while step - start >= _FINEST:
        start += (step - start) // 2
        yield start
