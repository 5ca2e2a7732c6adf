"""Questions to a world, on record: what was asked, the answer, and of choices what was considered and rejected.

The queries of :mod:`pycram.reasoning.queries` are such questions, and so is each choice of a process module: a grasp, a
posture, where something is put down. While one is answered, its world's lock is held and the world refuses changes.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import UsageError
from recorder import records
from recorder.tracing import journal, span

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pycram.reasoning.rejections import Rejection
    from pycram.world.world import BulletWorld
    from recorder.tracing.journal import Journal

_MAX_GROUPS: Final = 8  # of candidates that are listed; the rest is counted
_MAX_NAMES: Final = 4  # of the candidates of a group


@dataclass(slots=True)
class Question:
    """A question while it is answered."""

    name: str  # what is asked for
    arguments: Mapping[str, object]  # what about, by name
    answer: object = None  # the answer
    evidence: Mapping[str, object] = field(default_factory=dict)  # what it rests on
    picture: records.Picture | None = None  # what the camera saw, if one was asked
    considered: Choice | None = None  # what was considered for the answer, if it was one of several
    steps: Mapping[Journal, int] = field(default_factory=dict)  # of its record in each recording, once it is answered

    @contextmanager
    def asked(self, world: BulletWorld, *, trace: bool = True) -> Iterator[None]:
        """Answer it in the block, with the world locked against changes; then it is on record, also if it failed.

        Args:
            world: what it is about.
            trace: whether a failure's traceback goes on record.

        Raises:
            WorldClosed: the world has ended.
        """
        with world.lock, self.recorded(lambda: (world.name, world.sim_step), trace=trace):
            transactions = world.transactions
            outer, transactions.query = transactions.query, ""  # asked inside another question: that one is fine
            try:
                transactions.check(f"ask {self.name}")
                transactions.query = self.name
                yield
            finally:
                transactions.query = outer

    @contextmanager
    def recorded(self, where: Callable[[], tuple[str, int]], *, trace: bool = True) -> Iterator[None]:
        """Answer it in the block; then it is on record, also if it failed, but not if it can't be asked (UsageError).

        Args:
            where: gives name and simulated steps of the world that the record names.
            trace: whether a failure's traceback goes on record.
        """
        start = time.perf_counter_ns()
        error: BaseException | None = None
        try:
            yield
        except BaseException as raised:
            error = raised
            raise
        finally:
            if journal.recording() and not isinstance(error, UsageError):
                record = self._record(error, trace=trace)
                record.duration_ns = time.perf_counter_ns() - start
                world, sim_step = where()
                self.steps = span.emit(record, world=world, sim_step=sim_step)

    def _record(self, error: BaseException | None, *, trace: bool) -> records.Query:
        record = records.Query(
            name=self.name,
            arguments=records.arguments(self.arguments),
            answer_json=records.to_json(self.answer),
            evidence=records.arguments(self.evidence),
            failure=records.failure(error, trace=trace) if error is not None else None,
            picture=self.picture,
        )
        if self.considered is not None:
            self.considered.add_candidates(record)
        return record


class Choice(Question):
    """A question whose answer is one of several candidates. A candidate has what was said last of it."""

    __slots__ = ("_rejected", "chosen", "wanted")

    def __init__(self, name: str, arguments: Mapping[str, object], *, wanted: bool = True) -> None:
        super().__init__(name, arguments, considered=self)
        self.wanted = wanted  # whether anybody will know of the candidates: reasons that cost time needn't be found
        self._rejected: dict[str, tuple[Rejection, int]] = {}
        self.chosen = ""  # name of the candidate that was taken

    def reject(self, candidate: str, reason: Rejection, count: int = 1) -> None:
        """Say why a candidate won't do.

        Args:
            candidate: its name, as "front".
            count: how many alike it stands for, as postures for one grasp.
        """
        if self.wanted:
            self._rejected[candidate] = reason, count
            self.chosen = "" if candidate == self.chosen else self.chosen

    def reasons(self) -> list[Rejection]:
        """Return why candidates were rejected, in the order in which they were considered."""
        return [reason for reason, _ in self._rejected.values()]

    def take(self, candidate: str, answer: object = None, **evidence: object) -> None:
        """Say which candidate it is.

        Args:
            answer: the answer; its name by default.
            evidence: what else is to be known of it.
        """
        self._rejected.pop(candidate, None)
        self.chosen = candidate
        self.answer = candidate if answer is None else answer
        self.evidence = evidence

    def add_candidates(self, record: records.Query) -> Mapping[str, int]:
        """Put the candidates into a record: those rejected for the same reason as one, the chosen one last.

        Returns:
            For each candidate that is in the record, which one it belongs to there.
        """
        numbers: dict[str, int] = {}
        groups: dict[object, list[tuple[Rejection, str, int]]] = {}
        for name, (reason, count) in self._rejected.items():
            groups.setdefault((type(reason), reason.alike()), []).append((reason, name, count))
        for group in list(groups.values())[:_MAX_GROUPS]:
            group.sort(key=lambda item: item[0].miss())
            numbers |= dict.fromkeys((name for _, name, _ in group), len(record.candidates))
            reason = group[0][0]
            record.candidates.add(
                names=[name for _, name, _ in group[:_MAX_NAMES]],
                count=sum(count for *_, count in group),
                reason=type(reason).__name__,
                data=records.arguments(reason.data()),
            )
        left_out = sum(count for group in list(groups.values())[_MAX_GROUPS:] for *_, count in group)
        if left_out:
            record.candidates.add(count=left_out)
        record.chosen = -1
        if self.chosen:
            record.chosen = numbers[self.chosen] = len(record.candidates)
            record.candidates.add(names=[self.chosen])
        return numbers


def considering() -> Choice:
    """Return what collects the candidates for the answer of a query, which hands it on with that answer."""
    return Choice("", {}, wanted=journal.recording())


UNRECORDED: Final = Choice("", {}, wanted=False)
"""For reasoning that nobody asks for its candidates."""


@contextmanager
def choosing(name: str, world: BulletWorld, /, **arguments: object) -> Iterator[Choice]:
    """Choose something in the block, before the world is changed: one record, also if it fails.

    For example::

        with choosing("grasp", robot.world, object=body, arm=arm.name) as choice:
            for side in sides:
                if too_wide(side):
                    choice.reject(side, Misfit(width, opening))
            choice.take("front", position=position)

    A failure has its traceback in the record of the task around it, and not in this one. Arguments that are None are
    left out.

    Args:
        name: what is chosen.
        world: where; it refuses changes meanwhile.
        arguments: what the choice is about.
    """
    given = {key: value for key, value in arguments.items() if value is not None}
    choice = Choice(name, given, wanted=journal.recording())
    with choice.asked(world, trace=False):
        yield choice
