"""Actions and gates for plans under test.

Timing is controlled by gates, never by the clock: a branch that waits at a gate goes on when the test opens it, or stops
when it is cancelled.
"""

from __future__ import annotations

from pycram.failures import BadArgument, LookingFailed, Unreachable
from pycram.language import State, par, pursue, seq, try_all, try_in_order
from pycram.scheduling.cancellation import wait
from pycram.scheduling.schedule import Condition

KINDS = {"par": par, "pursue": pursue, "try_all": try_all, "seq": seq, "try_in_order": try_in_order}


S, F, C = State.SUCCEEDED, State.FAILED, State.CANCELLED


class Gate:
    """A condition that stays true once the test has opened it."""

    def __init__(self) -> None:
        self.changed = Condition()
        self.is_open = False

    def open(self) -> None:
        self.is_open = True
        self.changed.notify_all()

    def pass_through(self, timeout: float | None = None) -> bool:
        return wait(self.changed, lambda: self.is_open, timeout)


class Meeting:
    """A barrier for branches; each gets its number in the order of arrival."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.arrived = 0
        self.gate = Gate()

    def wait(self) -> int:
        self.arrived += 1
        number = self.arrived - 1
        if self.arrived == self.count:
            self.gate.open()
        assert self.gate.pass_through(20), "some don't arrive"
        return number


def fails() -> None:
    raise Unreachable("left", [1, 2, 3], 0.2)


def fails_to_look() -> None:
    raise LookingFailed([1, 2, 3], 0.2)


def succeeds(value: object = 1) -> object:
    return value


def is_wrong() -> None:
    raise BadArgument("x", 1, "2")


def has_a_bug() -> None:
    raise ZeroDivisionError
