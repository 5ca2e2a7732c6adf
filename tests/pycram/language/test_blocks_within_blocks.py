"""Blocks in the bodies of others: read where they stand, and run in their turn."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import pytest

from pycram import tasks
from pycram.failures import Unreachable
from pycram.fluent import Fluent, whenever
from pycram.language import failure_handling, finally_, par, pursue, seq, timeout, try_in_order
from pycram.language.branch import NoResult
from pycram.scheduling.future import branch_of
from tests.pycram.language.gates import C, F, Gate, Meeting, S, fails, succeeds


def test_blocks_in_a_concurrent_body_run_concurrently_and_in_order_inside() -> None:
    meeting = Meeting(3)
    order: list[str] = []
    with par as s:
        for name in "ab":
            with seq as t:
                t(order.append, name + "1")
                t(meeting.wait)
                t(order.append, name + "2")
        s(meeting.wait)
    assert s.state is S
    for name in "ab":
        assert order.index(name + "1") < order.index(name + "2")
    assert {*order[:2]} == {"a1", "b1"}


def test_a_block_in_a_sequence_in_a_concurrent_body_waits_for_its_turn() -> None:
    gate = Gate()
    order: list[object] = []
    with par as s:
        with seq as t:
            t(gate.pass_through)
            with par as u:
                u(order.append, 2)
            t(order.append, 3)
        s(lambda: (order.append(1), gate.open()))
    assert order == [1, 2, 3]
    assert (s.state, t.state, u.state) == (S, S, S)


def test_a_sequence_in_a_concurrent_body_stops_at_its_first_failure() -> None:
    done: list[int] = []
    with pytest.raises(Unreachable), par as s:
        with seq as t:
            t(fails)
            late = t(done.append, 1)
        s(done.append, 2)
    assert done == [2]
    assert t.state is F
    assert branch_of(late).state is C
    with pytest.raises(NoResult):
        late.result()


def test_a_future_used_in_the_body_is_awaited_or_ends_the_body() -> None:
    done = []
    with par as s:
        with seq as t:
            first = t(succeeds, 3)
            done.append(first + 0 if isinstance(first, int) else None)
        with pursue as u:
            gate = Gate()
            slow = u(gate.pass_through)
            u(succeeds)
            slow.result()  # is cancelled, and with it the rest of this body, not of the body around it
            done.append("never")
        s(done.append, "after")
    assert sorted(map(str, done)) == ["3", "after"]
    assert (s.state, t.state, u.state) == (S, S, S)


def test_attempts_timeouts_and_cleanups_in_a_read_body_keep_its_order() -> None:
    gate, order = Gate(), []
    with par as s:
        with seq as t:
            t(lambda: (gate.pass_through(0.05), order.append(1)))  # late
            with par as u:
                u(order.append, 2)
                with timeout(60):
                    order.append(3 if 1 in order else "too early")
            with finally_(order.append, 5):
                t(order.append, 4)
            for attempt in failure_handling(2):
                with attempt:
                    order.append(6)
                    if attempt.number < 2:
                        fails()
            t(order.append, 7)
        s(succeeds)
    assert s.state is S
    assert (order[0], sorted(order[1:3]), order[3:]) == (1, [2, 3], [4, 5, 6, 6, 7])


def test_waits_for_fluents_in_a_read_body_keep_its_order() -> None:
    gate, order, fluent = Gate(), [], Fluent(True)
    with par as s:
        with seq as t:
            t(lambda: (gate.pass_through(0.05), order.append(1)))  # late
            assert fluent.wait_for()
            order.append(2)
            t(order.append, 3)
            for _ in whenever(fluent):
                order.append(4)
                break
        s(succeeds)
    assert order == [1, 2, 3, 4]
    (block,) = [node for node in tasks.tree().roots[-1].children if node.name == "seq"]
    assert [node.kind for node in block.children] == ["branch", "wait", "branch"]
    assert all(node.created.wall_ns >= block.start.wall_ns for node in block.children)


def test_trying_in_order_goes_on_after_a_failed_block_or_body() -> None:
    tried = []
    with try_in_order as s:
        with seq as t:
            t(tried.append, 1)
            fails()
        with par as u:
            u(tried.append, 2)
            u(fails)
        with seq as v:
            v(tried.append, 3)
        with seq:
            tried.append("never")
    assert tried in ([1, 2, 3], [1, 2, 3])
    assert [x.state for x in (s, t, u, v)] == [S, F, F, S]
    assert [failure.block for failure in s.failures] == ["seq", "par"]
