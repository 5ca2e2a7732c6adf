"""Questions to a world, recorded with their answers; the record of a choice also has the rejected candidates.

A question is a reasoning query, or the choice of a process module, for example of a grasp or a place. While a question
is answered, its world is locked and refuses changes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import UsageError
from pycram.foundation.forcing import decider, forced
from recorder import records
from recorder.tracing import journal, span
from recorder.tracing.journal import Journal

if TYPE_CHECKING:
    from pycram.reasoning.rejections import Rejection
    from pycram.world.world import BulletWorld

_MAX_GROUPS: Final = 8  # maximum number of groups of candidates in a record; other candidates are only counted
_MAX_NAMES: Final = 4  # maximum number of names in a recorded group of candidates


@dataclass(slots=True)
class Question:
    """A question to a world, with its answer."""

    name: str  # name of the query or the choice
    arguments: Mapping[str, object]  # arguments by name
    answer: object = None
    evidence: Mapping[str, object] = field(default_factory=dict)  # facts behind the answer
    picture: records.Picture | None = None  # the camera's picture, if the query renders one
    considered: Choice | None = None  # the candidates, if the question is a choice
    steps: Mapping[Journal, int] = field(default_factory=dict)  # steps of the question's record, one in each recording

    @contextmanager
    def asked(self, world: BulletWorld, *, trace: bool = True) -> Iterator[None]:
        """Answer the question in the ``with`` block, with the world locked; record it at the end, also after an error.

        ``trace`` decides whether the record contains an error's traceback. WorldClosed is raised if the world has
        ended.
        """
        with world.lock, self.recorded(lambda: (world.name, world.sim_step), trace=trace):
            transactions = world.transactions
            outer, transactions.query = transactions.query, ""  # a question may ask another question
            try:
                transactions.check(f"ask {self.name}")
                transactions.query = self.name
                yield
            finally:
                transactions.query = outer

    @contextmanager
    def recorded(self, where: Callable[[], tuple[str, int]], *, trace: bool = True) -> Iterator[None]:
        """Answer the question in the ``with`` block; record it at the end, also after errors other than UsageError."""
        start = time.perf_counter_ns()
        error: BaseException | None = None
        try:
            yield
        except BaseException as raised:  # any error is recorded, also Ctrl-C
            error = raised
            raise
        finally:
            if journal.recording() and not isinstance(error, UsageError):
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
                    record.by_fork = bool(self.considered.forced)
                record.duration_ns = time.perf_counter_ns() - start
                world, sim_step = where()
                self.steps = span.emit(record, world=world, sim_step=sim_step)


class Choice(Question):
    """A choice among candidates. Only the latest result of each candidate counts."""

    __slots__ = ("_met", "_rejected", "chosen", "forced", "wanted")

    def __init__(self, name: str, arguments: Mapping[str, object], *, wanted: bool = True) -> None:
        super().__init__(name, arguments, considered=self)
        self.wanted = wanted  # whether the candidates are recorded; if not, callers needn't compute reasons
        self._rejected: dict[str, tuple[Rejection, int]] = {}
        self.chosen = ""  # name of the chosen candidate
        self.forced = ""  # name of the only candidate that a fork admits; "" if all candidates are admitted
        self._met = False  # whether the forced candidate was considered

    @contextmanager
    def asked(self, world: BulletWorld, *, trace: bool = True) -> Iterator[None]:
        """Choose a candidate in the ``with`` block; the choice is recorded at its end. A fork may force a candidate."""
        self.forced = forced(f"choice {self.name}", self.arguments) or ""
        try:
            with super().asked(world, trace=trace):
                yield
        finally:
            missing = self.forced and self._rejected and not self._met
            if missing and (decides := decider()) is not None:
                decides.missing(self.name, self.forced, list(self._rejected))

    def admits(self, candidate: str) -> bool:
        """Return whether a candidate may be chosen; reject it if a fork forces another candidate."""
        if not self.forced or candidate == self.forced or candidate.startswith(f"{self.forced}, "):
            self._met = True
            return True
        from pycram.reasoning.rejections import Excluded  # noqa: PLC0415  its 14 classes would delay the first query

        self.reject(candidate, Excluded())
        return False

    def reject(self, candidate: str, reason: Rejection, count: int = 1) -> None:
        """Reject a candidate by name; ``count`` is the number of similar candidates with the name, such as postures."""
        self._met |= candidate == self.forced
        if self.wanted:
            self._rejected[candidate] = reason, count
            self.chosen = "" if candidate == self.chosen else self.chosen

    def reasons(self) -> list[Rejection]:
        """Return the reasons against the rejected candidates, in the order of rejections."""
        return [reason for reason, _ in self._rejected.values()]

    def take(self, candidate: str, answer: object = None, **evidence: object) -> None:
        """Choose a candidate by name; the question's answer is ``answer``, or else this name."""
        self._met |= candidate == self.forced
        self._rejected.pop(candidate, None)
        self.chosen = candidate
        self.answer = candidate if answer is None else answer
        self.evidence = evidence

    def add_candidates(self, record: records.Query) -> Mapping[str, int]:
        """Add groups of rejected candidates with a common reason to a record, then the chosen candidate.

        The result has the index of each candidate's group in the record.
        """
        numbers: dict[str, int] = {}
        groups: dict[object, list[tuple[Rejection, str, int]]] = {}
        for name, (reason, count) in self._rejected.items():
            groups.setdefault(reason.group(), []).append((reason, name, count))
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
    """Return a choice among candidates for a query, which returns this choice with its answer."""
    return Choice("", {}, wanted=journal.recording())


UNRECORDED: Final = Choice("", {}, wanted=False)  # a choice that isn't recorded, for reasoning without a question


@contextmanager
def choosing(name: str, world: BulletWorld, /, **arguments: object) -> Iterator[Choice]:
    """Choose a candidate in the ``with`` block; the choice becomes one record, also after an error.

    For example::

        with choosing("grasp", robot.world, object=body, arm=arm.name) as choice:
            for side in sides:
                if too_wide(side):
                    choice.reject(side, Misfit(width, opening))
            choice.take("front", position=position)

    The world is locked and refuses changes. Arguments that are None are omitted. If an error is raised, the record of
    the surrounding task has its traceback.
    """
    given = {key: value for key, value in arguments.items() if value is not None}
    choice = Choice(name, given, wanted=journal.recording())
    with choice.asked(world, trace=False):
        yield choice
