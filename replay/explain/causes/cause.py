"""A cause of a failure: the base class of all kinds, which have their data, finder and words in one file.

The names of ``kind`` and of the fields are those of ``why --json`` (docs/why.md): they don't change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from recorder.records import argument_values
from replay.report import phrases

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import Self

    from recorder.records import Task
    from replay.explain.causes.case import FailureCase
    from replay.history.source import Line


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause of a failure."""

    kind: ClassVar[str]
    steps: tuple[int, ...]  # of the records that it rests on, in order

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Self]:
        """Yield the causes of this kind."""
        raise NotImplementedError

    def _words(self) -> Iterator[str]:
        raise NotImplementedError

    def is_explained(self, found: Sequence[Cause]) -> bool:  # noqa: ARG002  most kinds stand whatever else was found
        """Return whether a deeper cause that was found explains the same."""
        return False

    def lines(self) -> Iterator[str]:
        """Yield the words with the details indented."""
        first, *details = self._words()
        yield first
        yield from (f"  {line}" for line in details)


@dataclass(frozen=True, slots=True)
class CausingChange:
    """A record that changed a body or joint."""

    step: int
    body: str
    joint: str = ""  # "": the body's pose changed
    #: as in :class:`replay.history.blame.Blame`, or "attached", "detached", "joints", "gravity", "in-hand" (it was
    #: moved itself while a hand held it, and stays in that hand)
    how: str = ""
    task: Task | None = None  # the start of its innermost motion or handler, or else task; None: the plan itself did it
    line: Line | None = None  # the plan's line that requested it
    mover: str = ""  # what the command moved, if that is something else: a body, or ``JOINT of BODY``
    distance: float = 0.0  # m, of a revolute joint rad
    angle: float = 0.0  # rad
    handler: Task | None = None  # the start of the handler's call that it is part of
    by_fork: bool = False  # whoever forked the run did it, not the plan

    @property
    def originator(self) -> str:
        """Who made the change, and the plan's line."""
        if self.by_fork:
            return ", by the fork"
        task, handler, by = self.task, self.handler, ""
        if task is not None and task is handler:
            by = f", by {phrases.handler(task)}"
        elif task is not None:
            by = f", by {phrases.task(task.kind, task.name, argument_values(task.parameters))}"
        by += phrases.at(self.line)
        return by + (f", in {phrases.handler(handler)}" if handler is not None and task is not handler else "")

    def __str__(self) -> str:
        name = f"{self.body}.{self.joint}" if self.joint else self.body
        has_size = self.distance and math.isfinite(self.distance) and not self.joint
        size = f" by {phrases.length(self.distance)}" if has_size else ""
        return f"{phrases.change(name, self.how, self.mover)}{size}{self.originator}"

    @property
    def row(self) -> str:
        """The step and the change."""
        return f"step {self.step}: {self}"


def since(change: CausingChange | None, verb: str = "") -> str:
    """Return since which step something is so, and who did it; "" if it always was."""
    if change is None:
        return ""
    return f", {f'{verb} at' if verb else 'since'} step {change.step}{change.originator}"
