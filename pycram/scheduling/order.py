"""Orders of branches that somebody asks for: explored ones, and those that are told in words afterwards.

In these branches have ranks, at first in the order in which they were added, and the first one in rank that is ready
runs until it waits or ends. A :class:`Precedence` is an exception to that: "branch 2 before branch 1 at its 3rd stop".
Any order is ranks and exceptions, so what is drawn can be told, made again, and made smaller, exception by exception.

As text, on the command line and on record:

- ``added``: the ranks alone;
- ``added:2-1@3,1.2-1.1@0``: with precedences. Branch 1.2 is the second one that branch 1 began, 0 the code outside of
  all; its stop 0 is its start, and each checkpoint and wait is another one;
- ``pct:17:3:120``: drawn by :class:`Pct`, number 17, of depth 3 over 120 turns.
"""

from __future__ import annotations

import random
import re
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from pycram.foundation.failures import BadArgument, UsageError
from pycram.foundation.names import export

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

#: Turns after which a branch that goes on and on, such as one that polls, lets all others run first.
MOST_IN_A_ROW: Final = 100
ADDED: Final = "added"
OUTSIDE: Final = "0"
_PCT: Final = re.compile(r"pct:(\d+):([1-9]\d*):([1-9]\d*)")
_PRECEDENCE: Final = re.compile(r"(\d+(?:\.\d+)*)-(\d+(?:\.\d+)*)@(\d+)")


class DeadlockedBranches(UsageError):
    """All branches wait, and nothing is left that could wake one.

    Only orders that are asked for by name tell it, and projections, in which the branches around stand still: otherwise
    a plan may wait for what a signal brings.

    Attributes:
        waiting: Where each branch waits, FILE:LINE by its name.
    """

    def __init__(self, waiting: Mapping[str, str]) -> None:
        where = ", ".join(f"{name} at {line}" for name, line in waiting.items())
        super().__init__(f"deadlock: all wait, and nothing can wake them: {where}")
        self.waiting = dict(waiting)


export("pycram.failures", DeadlockedBranches)


class Precedence(NamedTuple):
    """A branch goes before another one, which is first in rank, and stays ahead of it.

    Attributes:
        branch: Number of the one that goes first.
        before: Number of the other one.
        stop: At which of its stops that waits.
    """

    branch: str
    before: str
    stop: int

    def __str__(self) -> str:
        return f"{self.branch}-{self.before}@{self.stop}"


class Standing(NamedTuple):
    """Where a branch stands that is ready.

    Attributes:
        branch: Its name; that of the thread outside of branches.
        file: The plan's file; "" if none is known.
        line: The plan's line that it goes on with, or that added it if it hasn't begun.
    """

    branch: str
    file: str
    line: int


class Made(NamedTuple):
    """A precedence that has come about.

    Attributes:
        precedence: Itself.
        first: Where the branch stood that went first.
        second: Where the other one stood.
        passed: The precedences before those alone that are next in rank to the branch, the nearest first: it went
            before all of them.
    """

    precedence: Precedence
    first: Standing
    second: Standing
    passed: list[Precedence]


class Candidate(Protocol):
    """What can run next."""

    def standing(self) -> Standing:
        """Where it stands in the plan."""


@dataclass(slots=True, eq=False)
class Ranked:
    """A branch, or the code outside of all, as an order knows it.

    Attributes:
        number: "2" is the second branch that the code outside began, "2.1" the first that this one began.
        stops: Checkpoints and waits that it has come to.
        begun: Branches that it has begun.
    """

    number: str
    stops: int = 0
    begun: int = 0


class Pct:
    """Probabilistic concurrency testing: random priorities, which change at a few random moments.

    A race of depth d needs d orderings of two steps each. With n branches and k turns a run finds one of depth d or
    less with a probability of at least 1 / (n k^(d-1)), whatever the plan is (Burckhardt, Kothari, Musuvathi,
    Nagarakatte: A randomized scheduler with probabilistic guarantees of finding bugs, ASPLOS 2010). The bound holds
    for runs of up to k turns, in which no branch takes more than MOST_IN_A_ROW.

    Args:
        seed: The run's.
        number: Which of its draws.
        depth: d; there are d - 1 changes of priority.
        steps: k.
    """

    def __init__(self, seed: int | None, number: int, depth: int, steps: int) -> None:
        self._dice = random.Random(f"pct {seed} {number}")
        self._changes = {self._dice.randint(1, steps): priority for priority in range(min(depth - 1, steps))}
        self._depth = depth
        self._turns = 0
        self._lowest = 0
        self._priorities: dict[Ranked, float] = {}

    def choose(self, ready: Collection[Ranked]) -> Ranked:
        """Return the one of the highest priority."""
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
        """Give it the lowest priority."""
        self._lowest -= 1
        self._priorities[branch] = self._lowest


class Order:
    """Decides which branch of a thread runs next.

    Args:
        draw: Decides; None for the first in rank.
        precedences: Exceptions from that.

    Attributes:
        outside: The code outside of all branches.
        turns: How many there were with two or more to choose from.
        made: The precedences that have come about.
    """

    def __init__(self, draw: Pct | None = None, precedences: Iterable[Precedence] = ()) -> None:
        self.outside = Ranked(OUTSIDE)
        self.turns = 0
        self.made: list[Made] = []
        self._draw = draw
        self._asked: dict[tuple[str, int], deque[str]] = {}
        for each in precedences:
            self._asked.setdefault((each.before, each.stop), deque()).append(each.branch)
        self._ranks = [self.outside]
        self._latest: Ranked = self.outside
        self._in_a_row = 0

    def begin(self, by: Ranked) -> Ranked:
        """Give a new branch the last rank."""
        by.begun += 1
        number = str(by.begun) if by is self.outside else f"{by.number}.{by.begun}"
        self._ranks.append(branch := Ranked(number))
        return branch

    def end(self, branch: Ranked) -> None:
        """Forget a branch that has ended."""
        if branch in self._ranks:
            self._ranks.remove(branch)

    def choose(self, ready: Mapping[Ranked, Candidate]) -> Ranked:
        """Return which of two or more runs next; they come in the order in which they became ready."""
        self.turns += 1
        top = next(each for each in self._ranks if each in ready)
        chosen = self._preceding(top, ready) if self._draw is None else self._draw.choose(ready.keys())
        if chosen is not top:
            behind = [each for each in self._ranks[: self._ranks.index(chosen)] if each in ready]
            passed = [Precedence(chosen.number, each.number, each.stops) for each in reversed(behind)]
            self.made.append(Made(passed.pop(), ready[chosen].standing(), ready[top].standing(), passed))
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
        """Return who is asked to go before the first in rank: of several that can, the one that is asked for first."""
        asked = self._asked.get((top.number, top.stops), ())
        while asked:
            number = asked.popleft()  # one that isn't ready can't; its precedence is void
            for each in ready:
                if each.number == number:
                    return each
        return top


def order_of(text: str, seed: int | None) -> Order | None:
    """Return a new order by its text; None for "", the order in which the scheduler draws by itself.

    Args:
        text: See above.
        seed: The run's.

    Raises:
        BadArgument: It is no order.
    """
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
    """Return the text of the order of ranks with some precedences."""
    return ":".join(filter(None, (ADDED, ",".join(map(str, precedences)))))
