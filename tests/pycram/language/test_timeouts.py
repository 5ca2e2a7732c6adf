"""Timeouts: what misses its deadline is cancelled at its next wait."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.failures import BadArgument, OutlivesTimeout
from pycram.language import failure_handling, par, timeout
from pycram.language.timeouts import TimedOut
from tests.pycram.language.gates import KINDS, C, Gate, succeeds

if TYPE_CHECKING:
    from pycram.bullet_world import BulletWorld


@pytest.mark.slow
def test_what_takes_too_long_times_out_at_its_next_wait() -> None:
    gate = Gate()
    with pytest.raises(TimedOut, match=r"within 0\.02 s") as raised, timeout(0.02):
        gate.pass_through()
    assert (raised.value.seconds, raised.value.clock) == (0.02, "wall")
    with pytest.raises(TimedOut), timeout(1), par as s:  # long enough to start both on a busy machine
        s(gate.pass_through)
        s(par, gate.pass_through, gate.pass_through)
    assert [branch.state for branch in s.branches] == [C, C]
    with timeout(60):
        succeeds()
    with pytest.raises(TimedOut), timeout(0):
        pass
    with pytest.raises(TimedOut), timeout(60), timeout(0.02):
        gate.pass_through()
    with pytest.raises(TimedOut, match=r"0\.02"), timeout(0.02), timeout(60):
        gate.pass_through()
    runs = []
    with pytest.raises(TimedOut):
        for attempt in failure_handling(2):
            with attempt, timeout(0):
                runs.append(1)
    assert not runs
    for wrong in (-1, "soon", float("nan")):
        with pytest.raises(BadArgument), timeout(wrong):
            pass


def test_waiting_with_a_timeout_of_its_own_goes_on_in_a_longer_one() -> None:
    with timeout(60):
        assert Gate().pass_through(0.01) is False


def test_what_is_done_as_a_whole_and_ends_after_the_deadline_has_missed_it(world: BulletWorld) -> None:
    with timeout(1, simulated=True):
        world.simulate(1)  # just in time
    done = []
    with pytest.raises(TimedOut, match="within 1 s of simulated time"), timeout(1, simulated=True):
        world.simulate(1.5)
        done.append(1)  # plain Python is no checkpoint
    assert done == [1]
    with pytest.raises(TimedOut), timeout(60), timeout(2, simulated=True), timeout(3, simulated=True):
        world.simulate(2.5)
    with pytest.raises(ZeroDivisionError), timeout(1, simulated=True):
        world.simulate(2)
        raise ZeroDivisionError  # it says more


@pytest.mark.parametrize("kind", KINDS)
def test_a_branch_that_would_outlive_a_timeout_is_refused(kind: str) -> None:
    gate = Gate()
    message = rf"test_timeouts.py:\d+ adds Gate.pass_through inside a timeout.*`with timeout.*{kind} as s"
    with pytest.raises(OutlivesTimeout, match=message) as raised, KINDS[kind] as s, timeout(0.02):
        s(gate.pass_through)  # nothing would ever end it
    assert (raised.value.block, raised.value.branch) == (kind, "Gate.pass_through")
    with pytest.raises(OutlivesTimeout), par, KINDS[kind] as s, timeout(60), par:
        s(succeeds)


def test_branches_within_a_timeout_may_add_branches_anywhere() -> None:
    added = []

    def adds() -> None:
        with timeout(60):
            s(added.append, 1)

    with par as s, timeout(60), par as t:
        t(succeeds)
    with par as s:
        s(adds)
    assert added == [1]
