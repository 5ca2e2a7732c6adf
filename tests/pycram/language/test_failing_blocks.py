"""What comes out of a block that failed: all failures, as what they have in common, and every bug."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import traceback
from contextlib import suppress

import pytest

from pycram import tasks
from pycram.failures import BranchesFailed, InCollision, LookingFailed, PlanFailure, Unreachable
from pycram.language import par, pursue, seq, try_all
from tests.pycram.language.gates import KINDS, C, F, Gate, S, fails, fails_to_look, has_a_bug, succeeds


def test_a_failed_block_can_be_caught_as_what_all_its_failures_are() -> None:
    with pytest.raises(Unreachable) as one:
        par(fails, lambda: 1)
    assert isinstance(one.value, BranchesFailed)
    assert (one.value.arm, one.value.distance) == ("left", 0.2)
    assert one.value.__cause__ is one.value.failures[0]
    with pytest.raises(Unreachable):
        par(fails, lambda: par(fails, fails))
    with pytest.raises(BranchesFailed) as two:
        par(fails, fails_to_look)
    assert not isinstance(two.value, (Unreachable, LookingFailed))
    text = "".join(traceback.format_exception(two.value))
    for part in ("1 of 2", "in fails", "in fails_to_look", "can't reach", "can't look"):
        assert part in text
    told = two.value.data["failures"]
    assert [failure["type"] for failure in told] == ["Unreachable", "LookingFailed"]
    assert told[0]["data"]["arm"] == "left"


def test_types_that_cannot_be_combined_still_come_in_one_failure() -> None:
    class Odd(PlanFailure, OSError):
        pass

    def odd() -> None:
        raise Odd("odd")

    with pytest.raises(BranchesFailed, match="par failed: Odd: odd") as raised:
        par(odd)
    assert isinstance(raised.value.failures[0], Odd)


def test_failures_of_all_levels_are_told() -> None:
    with pytest.raises(BranchesFailed) as raised, par as s:
        s(fails)
        with seq as t:
            t(succeeds)
            t(fails_to_look)
        raise InCollision([0, 0, 0], [0, 0, 0, 1], ["kitchen"])
    assert [type(one) for one in raised.value.leaves] == [Unreachable, LookingFailed, InCollision]
    assert all(word in str(raised.value) for word in ("can't reach", "can't look", "kitchen"))
    with pytest.raises(Unreachable, match=r"^par failed: seq failed: Unreachable: left arm"):
        par(lambda: seq(fails))


def test_a_failing_body_lets_the_branches_of_par_run_and_stops_those_of_others() -> None:
    gate = Gate()
    with pytest.raises(Unreachable), par as s:
        s(gate.pass_through)
        s(gate.open)
        fails()
    assert [branch.state for branch in s.branches] == [S, S]
    gate = Gate()
    with pytest.raises(Unreachable), pursue as s:
        s(gate.pass_through)
        fails()
    assert [branch.state for branch in s.branches] == [C]


@pytest.mark.parametrize("name", ["pursue", "try_all", "try_in_order"])
def test_a_decided_block_stands_whatever_its_body_does_then(name: str) -> None:
    def late(failures: list[BaseException] | None = None) -> object:
        with KINDS[name](failures) if failures is not None else KINDS[name] as s:
            s(succeeds)
            s.branches[0].wait()
            fails()
        return s

    s = late()
    assert s.state is S
    assert [type(one) for one in s.failures] == [Unreachable]  # nothing vanishes
    node = tasks.tree().roots[-1]
    assert node.status is S
    assert [(part.name, part.status) for part in node.children] == [("succeeds", S), ("body", F)]
    assert node.children[1].failure.type == "Unreachable"
    failures: list[BaseException] = []
    assert late(failures).state is S
    assert [type(one) for one in failures] == [Unreachable]
    with par as outer:
        inner = late()  # read here, done by a branch
        outer(succeeds)
    assert (outer.state, inner.state) == (S, S)
    assert [type(one) for one in inner.failures] == [Unreachable]


def test_a_failing_body_is_one_more_that_was_tried() -> None:
    gate = Gate()
    with try_all as s:
        s(gate.pass_through)
        s(gate.open)
        fails()
    assert s.state is S
    with pytest.raises(BranchesFailed, match=r"Look.*Unreach") as raised, try_all as s:
        s(fails_to_look)
        fails()
    assert len(raised.value.failures) == 2
    gate = Gate()
    with pytest.raises(Unreachable), pursue as s:  # was first
        s(lambda: gate.pass_through() if not s.scope.cancel_called else succeeds())
        fails()
    gate = Gate()
    with pytest.raises(Unreachable), par, par as t:  # the same for a block that is read
        t(gate.pass_through)
        t(gate.open)
        fails()
    assert [branch.state for branch in t.branches] == [S, S]


def test_a_cancelled_block_hands_over_what_failed_in_it() -> None:
    failed, failures = Gate(), []

    def inner() -> None:
        with par(failures) as s:
            s(fails)
            s.branches[0].wait()
            s(failed.open)
            s(Gate().pass_through)

    with pursue as s:
        s(inner)
        s(failed.pass_through)
    assert s.branches[0].state is C
    assert [type(one) for one in failures] == [Unreachable]


def test_a_sequence_goes_on_when_its_body_handles_the_failure() -> None:
    done = []
    with seq as s:
        try:
            s(fails)
        except Unreachable:
            done.append("handled")
        s(done.append, "next")
    assert done == ["handled", "next"]
    assert s.state is S
    assert s.failures == ()
    with pytest.raises(ZeroDivisionError), seq as s, suppress(ZeroDivisionError):
        s(has_a_bug)


def test_plain_python_exceptions_are_swallowed_by_nobody_and_cancellation_not_by_except_exception() -> None:
    gate = Gate()
    swallowed = []

    def stubborn() -> None:
        try:
            gate.pass_through()
        except Exception as error:  # noqa: BLE001
            swallowed.append(error)

    with pursue as s:
        s(stubborn)
        s(succeeds)
    assert not swallowed
    assert s.branches[0].state is C
