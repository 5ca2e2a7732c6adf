"""An error that the handler of a signal raises, wherever it comes, ends a plan's blocks; no branch is lost, none hangs."""

from __future__ import annotations

import itertools
import signal
from typing import TYPE_CHECKING

import pytest

from pycram import tasks
from pycram.language import par, pursue, seq, try_all
from pycram.language.branch import current_block
from pycram.scheduling import schedule
from pycram.scheduling.cancellation import checkpoint, current_scope
from tests.pycram.language.gates import Gate, Meeting, S, fails, succeeds
from tests.signal_at_line import modules, reached

if TYPE_CHECKING:
    from collections.abc import Iterator


class OutOfTime(Exception):
    """Raised by the handler, as plans do that limit their time with ``signal.alarm``."""


@pytest.fixture(autouse=True)
def _handler() -> Iterator[None]:
    def handler(*_: object) -> None:
        raise OutOfTime

    before = signal.signal(signal.SIGALRM, handler)
    yield
    signal.signal(signal.SIGALRM, before)


def plan() -> None:
    """Let branches begin, take turns, wait with and without time limits, wake each other and be cancelled."""
    gate, meeting = Gate(), Meeting(2)
    with par as s:
        s(gate.pass_through)
        s(meeting.wait)
        with pursue as t:
            t(Gate().pass_through)
            t(Gate().pass_through, 100)
            t(lambda: (checkpoint(), meeting.wait()))
        s(lambda: try_all(fails, lambda: (checkpoint(), gate.open())))
        s(Gate().pass_through, 0)
        with seq as t:
            t(gate.pass_through)
            t(succeeds)
        s(checkpoint)
    assert s.state is S


TRACED = modules("pycram/scheduling/schedule.py")


@pytest.mark.slow
@pytest.mark.parametrize("every", [13, pytest.param(1, marks=pytest.mark.long)])
def test_an_error_of_a_signal_handler_at_any_line_of_the_scheduler_loses_no_branch(every: int) -> None:
    raised = 0
    for number in itertools.count(1, every):
        try:
            came_there = reached(number, signal.SIGALRM, plan, TRACED)
        except OutOfTime:
            raised += 1
        else:
            if not came_there:
                break
            pytest.fail(f"the error at line {number} was lost")
        assert (current_block(), current_scope(), tasks.current()) == (None, None, None)
        assert not schedule.scheduler().branches
        plan()
    assert raised * every > 1000
