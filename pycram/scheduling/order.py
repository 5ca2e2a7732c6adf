"""Orders of branches that exploration requests.

Branches have ranks, at first in the order in which they were added. The ready branch with the first rank runs until it
waits or ends. The text ``added:2-1@3`` adds a :class:`Precedence`: branch 2 overtakes branch 1 at the third stop of
branch 1. ``pct:17:3:120`` is the order that :class:`Pct` draws for number 17, depth 3 and 120 turns.
"""

from __future__ import annotations

import random
import re
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from pycram.foundation.errors import export
from pycram.foundation.failures import BadArgument, UsageError

if TYPE_CHECKING:
    from pycram.scheduling.schedule import Ready

MOST_IN_A_ROW: Final = 100  # after this many turns in a row of a branch that polls, for example, all other branches run
ADDED: Final = "added"
OUTSIDE: Final = "0"
_PCT: Final = re.compile(r"pct:(\d+):([1-9]\d*):([1-9]\d*)")
_PRECEDENCE: Final = re.compile(r"(\d+(?:\.\d+)*)-(\d+(?:\.\d+)*)@(\d+)")


@dataclass(frozen=True, slots=True)
class BlockedWait:
    """A wait that no event can end."""

    branch: str  # name of the waiting branch, or of the thread if the code is outside of all branches
    line: str  # The plan's line that waits, as FILE:LINE; "" if unknown
    reason: str  # what the branch waits for; "" if unknown
    depends_on: tuple[str, ...]  # names of the branches that could end the wait, or that last set the awaited value

    def __str__(self) -> str:
        return f"{self.branch}{self.line and f' at {self.line}'}{self.reason and f' waits for {self.reason}'}"


class DeadlockedBranches(UsageError):
    """All branches wait, and no deadline, and no thread or signal handler of the plan, can end a wait."""

    def __init__(self, waits: Sequence[BlockedWait]) -> None:
        self.waits = tuple(waits)
        self.cycle = _cycle(waits)  # names of branches that wait in a circle; the first is also the last; () for none
        where = "; ".join(map(str, waits))
        cycle = f"; cycle: {' -> '.join(self.cycle)}" if self.cycle else ""
        super().__init__(f"deadlock: all branches wait, and nothing can wake them: {where}{cycle}")

    @property
    def waiting(self) -> dict[str, str]:
        """FILE:LINE where each branch waits, by the branch's name."""
        return {each.branch: each.line for each in self.waits}


def _cycle(waits: Sequence[BlockedWait]) -> tuple[str, ...]:
    depends_on = {each.branch: each.depends_on for each in waits}
    for start in depends_on:
        paths: list[tuple[str, ...]] = [(start,)]
        seen = {start}
        for path in paths:  # the loop itself appends paths
            for name in depends_on.get(path[-1], ()):
                if name == start:
                    return (*path, start)
                if name not in seen:
                    seen.add(name)
                    paths.append((*path, name))
    return ()


export("pycram.failures", DeadlockedBranches)


class Precedence(NamedTuple):
    """A rule: a branch overtakes the branch with the first rank, and stays ahead of it."""

    branch: str  # number of the branch that overtakes
    before: str  # number of the branch that is overtaken
    stop: int  # stop of the overtaken branch at which the rule applies

    def __str__(self) -> str:
        return f"{self.branch}-{self.before}@{self.stop}"


class BranchLine(NamedTuple):
    """The plan's line at which a branch waits or will continue."""

    branch: str  # name of the branch, or of the thread for code outside of branches
    file: str  # "" if unknown
    line: int  # the next line of the branch; the line that added the branch if it hasn't begun
    label: str = ""  # the branch's name with its arguments, for people; "" if it equals the name


class AppliedPrecedence(NamedTuple):
    """A precedence that changed the order of branches in a run."""

    precedence: Precedence
    first: BranchLine  # line of the branch that ran first
    second: BranchLine  # line of the other branch
    passed: list[Precedence]  # weaker precedences: the branch comes before only some of the branches that it overtook


@dataclass(slots=True, eq=False)
class Ranked:
    """A branch, or the code outside of all branches, as an order sees it."""

    number: str  # "2" is the second branch that code outside of branches began, "2.1" the first that branch 2 began
    stops: int = 0  # number of checkpoints and waits that the branch has passed; at its start 0
    begun: int = 0  # number of branches that this branch has begun


class Pct:
    """Probabilistic concurrency testing: random priorities, which change at a few random moments.

    A race of depth d needs d ordered pairs of steps. With n branches and k turns or fewer, a run finds a race of depth
    d or less with a probability of at least 1 / (n k^(d-1)) (Burckhardt, Kothari, Musuvathi, Nagarakatte: A randomized
    scheduler with probabilistic guarantees of finding bugs, ASPLOS 2010), if no branch exceeds MOST_IN_A_ROW turns.
    ``depth`` is d, and ``steps`` is the expected number k. Priorities change d - 1 times.
    """

    def __init__(self, seed: int | None, number: int, depth: int, steps: int) -> None:
        self._dice = random.Random(f"pct {seed} {number}")
        self._changes = {self._dice.randint(1, steps): priority for priority in range(min(depth - 1, steps))}
        self._depth = depth
        self._turns = 0
        self._lowest = 0
        self._priorities: dict[Ranked, float] = {}

    def choose(self, ready: Collection[Ranked]) -> Ranked:
        """Return the ready branch with the highest priority."""
        self._turns += 1
        for each in ready:
            if each not in self._priorities:
                self._priorities[each] = self._depth + self._dice.random()
        highest = max(ready, key=self._priorities.__getitem__)
        if self._turns in self._changes:
            self._priorities[highest] = self._changes[self._turns]
            highest = max(ready, key=self._priorities.__getitem__)
        return highest

    def postpone(self, branch: Ranked) -> None:
        """Give a branch the lowest priority."""
        self._lowest -= 1
        self._priorities[branch] = self._lowest


class Order:
    """Decides which branch of a thread runs next: ``draw`` draws the branch; without ``draw``, the ranks decide."""

    def __init__(self, draw: Pct | None = None, precedences: Iterable[Precedence] = ()) -> None:
        self.outside = Ranked(OUTSIDE)  # the code outside of all branches
        self.turns = 0  # number of choices between two or more branches
        self.applied: list[AppliedPrecedence] = []
        self._draw = draw
        self._asked: dict[tuple[str, int], deque[str]] = {}
        for each in precedences:
            self._asked.setdefault((each.before, each.stop), deque()).append(each.branch)
        self._ranks = [self.outside]
        self._latest: Ranked = self.outside
        self._in_a_row = 0

    def begin(self, by: Ranked) -> Ranked:
        """Return the rank of a new branch, which is the last rank."""
        by.begun += 1
        self._ranks.append(branch := Ranked(str(by.begun) if by is self.outside else f"{by.number}.{by.begun}"))
        return branch

    def end(self, branch: Ranked) -> None:
        """Remove the rank of a branch that has ended."""
        if branch in self._ranks:
            self._ranks.remove(branch)

    def choose(self, ready: Mapping[Ranked, Ready]) -> Ranked:
        """Return which of two or more ready branches runs next; the branch that has been ready longest is first."""
        self.turns += 1
        top = next(each for each in self._ranks if each in ready)
        chosen = self._preceding(top, ready) if self._draw is None else self._draw.choose(ready.keys())
        if chosen is not top:
            behind = [each for each in self._ranks[: self._ranks.index(chosen)] if each in ready]
            passed = [Precedence(chosen.number, each.number, each.stops) for each in reversed(behind)]
            self.applied.append(
                AppliedPrecedence(passed.pop(), ready[chosen].plan_line(), ready[top].plan_line(), passed)
            )
            self._ranks.remove(chosen)
            self._ranks.insert(self._ranks.index(top), chosen)
        self._in_a_row = self._in_a_row + 1 if chosen is self._latest else 1
        self._latest = chosen
        if self._in_a_row == MOST_IN_A_ROW:
            self._in_a_row = 0
            self._ranks.remove(chosen)
            self._ranks.append(chosen)
            if self._draw is not None:
                self._draw.postpone(chosen)
        return chosen

    def _preceding(self, top: Ranked, ready: Collection[Ranked]) -> Ranked:
        """Return the branch that a precedence puts before the first branch by rank; earlier precedences win."""
        asked = self._asked.get((top.number, top.stops), ())
        while asked:
            number = asked.popleft()
            for each in ready:  # if the preferred branch isn't ready, the precedence has no effect
                if each.number == number:
                    return each
        return top


def order_of(text: str, seed: int | None) -> Order | None:
    """Return a new order from a text (see the module) and the run's seed; None for ""; raise BadArgument if invalid."""
    if not text:
        return None
    if drawn := _PCT.fullmatch(text):
        number, depth, steps = map(int, drawn.groups())
        return Order(Pct(seed, number, depth, steps))
    name, colon, rest = text.partition(":")
    found = [_PRECEDENCE.fullmatch(each) for each in rest.split(",")] if colon else []
    matches = [each for each in found if each is not None]
    if name != ADDED or len(matches) < len(found):
        raise BadArgument("order", text, '"added", "added:2-1@3,1.2-1.1@0" or "pct:NUMBER:DEPTH:TURNS"')
    return Order(None, [Precedence(each[1], each[2], int(each[3])) for each in matches])


def text_of(precedences: Iterable[Precedence]) -> str:
    """Return the text of an order of ranks with precedences."""
    return ":".join(filter(None, (ADDED, ",".join(map(str, precedences)))))
