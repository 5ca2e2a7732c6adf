"""Timeouts: what misses its deadline is cancelled at its next wait."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import pytest

from pycram.failures import BadArgument
from pycram.language import failure_handling, par, timeout
from pycram.language.timeouts import TimedOut
from tests.pycram.language.gates import C, Gate, succeeds


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
