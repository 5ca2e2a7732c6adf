"""Failed blocks raise all failures, as the types that these have in common, and every bug."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import sys
import traceback
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

from pycram import tasks
from pycram.failures import BranchesFailed, InCollision, LookingFailed, PlanFailure, Unreachable
from pycram.language import par, pursue, seq, try_all
from pycram.language.failures import MAX_LEVELS
from recorder.records import Task
from tests.pycram.language.gates import KINDS, C, F, Gate, S, fails, fails_to_look, has_a_bug, succeeds

if TYPE_CHECKING:
    from tests.conftest import MemorySink


def test_a_failed_block_can_be_caught_as_the_common_types_of_its_failures() -> None:
    with pytest.raises(Unreachable) as single:
        par(fails, lambda: 1)
    assert isinstance(single.value, BranchesFailed)
    assert (single.value.arm, single.value.distance) == ("left", 0.2)
    assert single.value.__cause__ is single.value.failures[0]
    with pytest.raises(Unreachable):
        par(fails, lambda: par(fails, fails))
    with pytest.raises(BranchesFailed) as several:
        par(fails, fails_to_look)
    assert not isinstance(several.value, (Unreachable, LookingFailed))
    text = "".join(traceback.format_exception(several.value))
    for part in ("1 of 2", "in fails", "in fails_to_look", "can't reach", "can't look"):
        assert part in text
    fields = several.value.data["failures"]
    assert [failure["type"] for failure in fields] == ["Unreachable", "LookingFailed"]
    assert fields[0]["data"]["arm"] == "left"


def test_types_that_cannot_be_combined_are_still_raised_as_one_failure() -> None:
    class Odd(PlanFailure, OSError):
        pass

    def odd() -> None:
        raise Odd("odd")

    with pytest.raises(BranchesFailed, match="par failed: Odd: odd") as raised:
        par(odd)
    assert isinstance(raised.value.failures[0], Odd)


def test_failures_of_all_levels_are_in_the_message() -> None:
    with pytest.raises(BranchesFailed) as raised, par as s:
        s(fails)
        with seq as t:
            t(succeeds)
            t(fails_to_look)
        raise InCollision([0, 0, 0], [0, 0, 0, 1], ["kitchen"])
    assert [type(failure) for failure in raised.value.leaves] == [Unreachable, LookingFailed, InCollision]
    assert all(word in str(raised.value) for word in ("can't reach", "can't look", "kitchen"))
    with pytest.raises(Unreachable, match=r"^par failed: seq failed: Unreachable: left arm"):
        par(lambda: seq(fails))


def test_tracebacks_of_failures_through_many_blocks_are_truncated_in_the_middle(sink: MemorySink) -> None:
    def nested(levels: int) -> None:
        if not levels:
            fails()
        with par as s:
            s(nested, levels - 1)

    most = []
    for levels in (4, 40):
        with pytest.raises(Unreachable) as raised:
            nested(levels)
        assert len(raised.value.leaves) == 1
        text = "".join(traceback.format_exception(raised.value))
        assert "in fails" in text
        ended = [task.failure.traceback for task in sink.of(Task) if task.phase == Task.FINISHED]
        assert all("in fails" in text for text in ended)
        most.append(max(text.count("Traceback (most recent") for text in ended))
    assert most == [4, MAX_LEVELS + 1]


def test_records_of_nested_blocks_that_fail_grow_with_their_number_only(sink: MemorySink) -> None:
    def nested(levels: int) -> None:
        if not levels:
            fails()
        with seq:
            nested(levels - 1)

    sizes = []
    for levels in (30, 60):
        before = len(sink.records)
        with pytest.raises(Unreachable) as raised:
            nested(levels)
        assert len(raised.value.leaves) == 1
        assert "can't reach" in str(raised.value)
        sizes.append(sum(record.ByteSize() for record in sink.records[before:]))
    assert sizes[1] < 2.5 * sizes[0]


@pytest.mark.slow
def test_tasks_end_where_the_stack_does(sink: MemorySink) -> None:
    def nested() -> None:
        with seq:
            nested()

    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(sum(1 for _ in traceback.walk_stack(None)) + 500)
    try:
        with pytest.raises(RecursionError):
            nested()
    finally:
        sys.setrecursionlimit(limit)
    tasks = sink.of(Task)
    begun, ended = ([task.task for task in tasks if task.phase == phase] for phase in (Task.STARTED, Task.FINISHED))
    assert len(begun) > 20
    assert ended == begun[::-1]


def test_a_failing_body_lets_branches_of_par_run_and_cancels_those_of_other_blocks() -> None:
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
    assert [type(failure) for failure in s.failures] == [Unreachable]  # nothing vanishes
    node = tasks.tree().roots[-1]
    assert node.status is S
    assert [(part.name, part.status) for part in node.children] == [("succeeds", S), ("body", F)]
    assert node.children[1].failure.type == "Unreachable"
    failures: list[BaseException] = []
    assert late(failures).state is S
    assert [type(failure) for failure in failures] == [Unreachable]
    with par as outer:
        inner = late()  # read here, run by a branch
        outer(succeeds)
    assert (outer.state, inner.state) == (S, S)
    assert [type(failure) for failure in inner.failures] == [Unreachable]


def test_a_failing_body_counts_as_one_more_branch() -> None:
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


def test_a_cancelled_block_collects_its_failures() -> None:
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
    assert [type(failure) for failure in failures] == [Unreachable]


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


def test_except_exception_does_not_swallow_cancellation() -> None:
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
