"""The blocks of the plan language: who decides them, what becomes of the others, of failures and of results.

Timing is controlled by gates, never by the clock: a branch that waits at a gate goes on when the test opens it, or stops
when it is cancelled.
"""

# ruff: noqa: PT012, PT031  the blocks under test have bodies
from __future__ import annotations

import copy
import faulthandler
import os
import pickle
import signal
import sys
import threading
import traceback
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pycram import nesting, tasks
from pycram.branch import NoResult
from pycram.cancellation import Cancelled, checkpoint, current_scope, wait
from pycram.failures import (
    BadArgument,
    BranchesFailed,
    InCollision,
    LookingFailed,
    NotCleanedUp,
    PlanFailure,
    Unreachable,
    UsageError,
)
from pycram.fluent import Fluent, whenever
from pycram.handle import branch_of
from pycram.language import (
    NeverOpened,
    State,
    failure_handling,
    finally_,
    par,
    pursue,
    retry,
    seq,
    timeout,
    try_all,
    try_in_order,
)
from pycram.nested_blocks import Deferred
from pycram.nesting import BlocksMixed
from pycram.open_block import BlockClosed, current_block
from pycram.retries import FailureLeft
from pycram.timeouts import TimedOut

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.language import Kind
    from pycram.open_block import OpenBlock

KINDS = {"par": par, "pursue": pursue, "try_all": try_all, "seq": seq, "try_in_order": try_in_order}
S, F, C = State.SUCCEEDED, State.FAILED, State.CANCELLED


class Gate:
    """Something to wait for; who is cancelled waits no more."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.is_open = False

    def open(self) -> None:
        with self.changed:
            self.is_open = True
            self.changed.notify_all()

    def pass_through(self, timeout: float | None = None) -> bool:
        return wait(self.changed, lambda: self.is_open, timeout)


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


@pytest.fixture(autouse=True)
def _watched() -> Iterator[None]:
    """Nothing hangs, no thread outlives its block, and nothing runs on in the task tree."""
    faulthandler.dump_traceback_later(60, exit=True)
    before = threading.active_count()
    yield
    faulthandler.cancel_dump_traceback_later()
    assert threading.active_count() == before
    assert all(node.finished for _, node in tasks.tree().walk())


# --- the table: who decides -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "block", "second"),
    [("par", S, S), ("pursue", S, C), ("try_all", S, C), ("seq", S, S), ("try_in_order", S, C)],
)
def test_when_the_first_succeeds(name: str, block: State, second: State) -> None:
    gate = Gate()
    with KINDS[name] as s:
        s(lambda: gate.open() if second is S else None)
        s(gate.pass_through)
    assert s.state is block
    assert [branch.state for branch in s.branches] == [S, second]


@pytest.mark.parametrize(
    ("name", "block", "second"),
    [("par", F, S), ("pursue", F, C), ("try_all", S, S), ("seq", F, None), ("try_in_order", S, S)],
)
def test_when_the_first_fails(name: str, block: State, second: State | None) -> None:
    gate = Gate()

    def first() -> None:
        if second is S:
            gate.open()
        fails()

    failures: list[BaseException] = []
    with KINDS[name](failures) as s:
        s(first)
        s(gate.pass_through)
    assert s.state is block
    assert [branch.state for branch in s.branches] == [F, *([second] if second else [])]
    assert [type(failure) for failure in failures] == [Unreachable]  # also those of a block that succeeded


@pytest.mark.parametrize("name", KINDS)
def test_when_all_succeed(name: str) -> None:
    with KINDS[name] as s:
        handle = s(succeeds, 5)
    assert s.state is S
    assert handle == 5
    assert not s.failures
    assert KINDS[name](lambda: 1, lambda: 1) in (1, [1, 1])


@pytest.mark.parametrize(
    ("name", "count"), [("par", 2), ("pursue", 1), ("try_all", 2), ("seq", 1), ("try_in_order", 2)]
)
def test_when_all_fail(name: str, count: int) -> None:
    gate = Gate()
    both = count == 2
    with pytest.raises(BranchesFailed, match=f"^{name} failed: Unreachable") as raised, KINDS[name] as s:
        s(fails)
        s(fails_to_look if both else gate.pass_through)
    assert s.state is F
    assert [type(one) for one in raised.value.failures] == [Unreachable, LookingFailed][:count]
    assert raised.value.failures == s.failures
    with pytest.raises(BranchesFailed):
        KINDS[name](fails, fails)


@pytest.mark.parametrize("name", KINDS)
def test_empty_blocks_succeed(name: str) -> None:
    with KINDS[name]() as s:
        assert s.state is State.RUNNING
    assert s.state is S
    with KINDS[name]:
        pass


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("bug", [is_wrong, has_a_bug])
def test_bugs_come_out_of_every_block_as_they_are(name: str, bug: Callable[[], None]) -> None:
    kind = BadArgument if bug is is_wrong else ZeroDivisionError
    gate = Gate()
    failures: list[BaseException] = []
    with pytest.raises(kind) as raised, KINDS[name](failures) as s:
        s(fails) if name in ("par", "try_all", "try_in_order") else None
        s(bug)
        s(gate.pass_through)  # nobody opens it: a bug ends the others
    assert type(raised.value) is kind
    assert not failures
    with pytest.raises(kind), KINDS[name](failures):
        bug()  # in the body
    with pytest.raises(kind):
        KINDS[name](bug)


@pytest.mark.parametrize("name", KINDS)
def test_a_bug_in_the_body_of_a_block_that_is_read_comes_out_too(name: str) -> None:
    gate = Gate()
    with pytest.raises(ZeroDivisionError), par as s:
        s(gate.pass_through)
        with KINDS[name] as t:
            t(gate.pass_through)
            has_a_bug()
    assert (s.state, t.state) == (F, F)
    with pytest.raises(ZeroDivisionError), par as s, suppress(ZeroDivisionError), KINDS[name] as t:
        t(gate.pass_through)  # nobody opens it
        has_a_bug()
    assert (s.state, t.state) == (F, F)


@pytest.mark.parametrize("outer", KINDS)
@pytest.mark.parametrize("inner", KINDS)
def test_every_block_in_every_other(outer: str, inner: str) -> None:
    done = []
    with KINDS[outer] as s:
        with KINDS[inner] as t:
            handle = t(succeeds, 7)
        with KINDS[inner] as u:  # try_in_order doesn't come here
            done.append("body")
            u(done.append, 8)
        s(done.append, 9) if outer in ("par", "seq") else None
    assert s.state is S
    if outer == "try_in_order":
        assert not done
    if outer in ("par", "seq"):
        assert handle == 7
        assert (t.state, u.state) == (S, S)
        assert sorted(done[1:]) == [8, 9]
    with pytest.raises(Unreachable), KINDS[outer] as s:
        with KINDS[inner]:
            fails()
        if outer != "pursue":
            KINDS[inner](fails)
    assert s.state is F


@pytest.mark.parametrize("name", KINDS)
def test_a_block_that_is_told_to_stop_by_the_one_around_it(name: str) -> None:
    """It stops at its next wait or action, and what is behind it isn't run."""
    gate, inside = Gate(), Gate()
    reached = []

    def stops() -> None:
        inside.open()
        gate.pass_through()
        reached.append("never")

    def inner() -> None:
        with KINDS[name] as s:
            reached.append(s)
            s(stops)
            s(stops)
        reached.append("behind")

    with pursue as outer:
        outer(inner)
        outer(inside.pass_through)
    assert [branch.state for branch in outer.branches] == [C, S]
    (s,) = reached
    assert s.state is C
    assert {branch.state for branch in s.branches} == {C}
    assert len(s.branches) == 1 or s.rule.concurrent


# --- blocks within blocks ---------------------------------------------------------------------------------------------


def test_blocks_in_a_concurrent_body_run_beside_each_other_and_in_order_inside() -> None:
    meeting = threading.Barrier(3, timeout=20)
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


def test_who_looks_at_a_handle_in_the_body_waits_for_it_or_leaves_the_body() -> None:
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
    gate, order, here = Gate(), [], Fluent(True)
    with par as s:
        with seq as t:
            t(lambda: (gate.pass_through(0.05), order.append(1)))  # late
            assert here.wait_for()
            order.append(2)
            t(order.append, 3)
            for _ in whenever(here):
                order.append(4)
                break
        s(succeeds)
    assert order == [1, 2, 3, 4]
    (block,) = [node for node in tasks.tree().roots[-1].children if node.name == "seq"]
    assert [node.kind for node in block.children] == ["branch", "wait", "branch"]
    assert all(node.created.wall_ns >= block.start.wall_ns for node in block.children)


def test_functions_in_a_body_are_branches() -> None:
    meeting = threading.Barrier(2, timeout=20)
    with par:
        results = par(meeting.wait, lambda: 3)
        other = try_in_order(fails, meeting.wait)
    assert results[1] == 3
    assert {results[0], other.result()} == {0, 1}


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


# --- failures ---------------------------------------------------------------------------------------------------------


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
        inner = late()  # read here, done in a thread of its own
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
        s(lambda: gate.pass_through() if not s.scope.told else succeeds())
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


def test_interrupting_the_body_stops_the_branches() -> None:
    gate = Gate()
    for kind in (par, pursue, try_all):
        with pytest.raises(KeyboardInterrupt), kind as s:
            s(gate.pass_through)
            raise KeyboardInterrupt
        assert s.branches[0].state is C


@pytest.mark.parametrize("times", range(5))
def test_ctrl_c_ends_a_block_and_its_threads(times: int) -> None:
    gate = Gate()

    def interrupt() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        gate.pass_through()

    with pytest.raises(KeyboardInterrupt), par as s:
        with pursue as t:
            t(gate.pass_through)
        s(gate.pass_through)
        s(interrupt)
    assert {branch.state for branch in s.branches} == {C}


def test_pressing_ctrl_c_again_leaves_no_thread_either(monkeypatch: pytest.MonkeyPatch) -> None:
    told = threading.Event()

    class Screen:
        text = ""

        def write(self, text: str) -> None:
            self.text += text
            told.set()

    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)

    def busy() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        while not s.scope.told:
            pass
        while not told.is_set():
            os.kill(os.getpid(), signal.SIGINT)
            told.wait(0.05)

    with pytest.raises(KeyboardInterrupt), par as s:
        s(busy)
    assert s.branches[0].state is S
    assert "waiting for par-1" in screen.text


@pytest.mark.parametrize("opened", ["par", "seq in it"])
def test_ctrl_c_between_a_block_and_its_body_leaves_nothing_waiting(
    opened: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = ["par", "seq in it"]

    def interrupted() -> int:
        if left and left.pop(0) == opened:
            raise KeyboardInterrupt
        return 0

    monkeypatch.setattr(nesting, "_generator", interrupted)
    with pytest.raises(KeyboardInterrupt), par as s:
        s(succeeds)
        with seq as q:
            q(succeeds)
    assert current_block() is None
    assert current_scope() is None


def test_ctrl_c_that_a_block_never_hears_of_ends_it_with_the_block_around_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(block: Deferred, *_: object) -> bool:
        block._exits.close()
        raise KeyboardInterrupt

    monkeypatch.setattr(Deferred, "__exit__", interrupted)
    begun = Gate()
    with pytest.raises(KeyboardInterrupt), par, seq as q:
        q(begun.open)
        begun.pass_through()


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


# --- handles ----------------------------------------------------------------------------------------------------------


def test_handles_are_their_results() -> None:
    gate = Gate()
    with par as s:
        handle = s(lambda: gate.pass_through() and [3, 1, 2])
        gate.open()
        assert sorted(handle) == [1, 2, 3]
    assert handle == [3, 1, 2]
    assert isinstance(handle, list)
    assert handle + [0] == [3, 1, 2, 0]  # noqa: RUF005  the handle's own operator
    with par as s:
        number = s(succeeds, 7)
    assert (number + 1, 10 - number, -number, number % 4, range(9)[number]) == (8, 3, -7, 3, 7)
    with suppress(PlanFailure), par as s:
        failed = s(fails)
    with pytest.raises(Unreachable):
        failed.arm  # noqa: B018
    with pursue as s:
        stopped = s(Gate().pass_through)
        s(succeeds)
    with pytest.raises(NoResult, match="was cancelled"):
        bool(stopped)


def test_a_branch_may_ask_for_others_until_the_block_has_ended() -> None:
    done = []
    with par as s:
        s(lambda: s(lambda: s(done.append, 1)))
    assert done == [1]
    assert len(s.branches) == 3
    with pytest.raises(BlockClosed):
        s(succeeds)
    with pytest.raises(BadArgument):
        par(1)
    with pytest.raises(BadArgument), par as s:
        s("not a function")


@pytest.mark.parametrize("name", KINDS)
def test_no_functions_give_no_results(name: str) -> None:
    functions: list[Callable[[], object]] = []
    results = KINDS[name](*functions)
    assert results == []
    assert [*results] == []


def test_a_forgotten_with_is_told() -> None:
    failures: list[BaseException] = []
    with pytest.warns(NeverOpened, match=r"write `with par\(failures\) as s:`") as warned:
        par(failures)
    assert warned[0].filename == __file__


def test_blocks_in_generators_that_end_out_of_order_are_refused() -> None:
    def plan(kind: Kind) -> Iterator[OpenBlock]:
        with kind as s:
            yield s

    for kind in (par, seq):
        first, second = plan(kind), plan(par)
        s, t = next(first), next(second)
        gate = Gate()
        if kind is par:
            s(gate.pass_through)
        t(gate.pass_through)
        with pytest.raises(BlocksMixed, match=f"a {kind} block ends while one"):
            list(first)
        assert State.RUNNING not in {branch.state for block in (s, t) for branch in block.branches}
        with pytest.raises(BlocksMixed):
            list(second)
        assert current_block() is None
        left = plan(kind)
        with pytest.raises(BlocksMixed), par:
            next(left)
        with pytest.raises(BlocksMixed):
            list(left)
        assert current_block() is None
        with par as u:
            for v in plan(kind):
                v(succeeds)
        assert (u.state, v.state) == (S, S)


def test_timeouts_attempts_and_cleanups_in_generators_that_end_out_of_order_are_refused() -> None:
    def in_time() -> Iterator[None]:
        with timeout(100):
            yield

    def cleaning() -> Iterator[None]:
        with finally_(succeeds):
            yield

    def trying() -> Iterator[None]:
        for attempt in failure_handling(1):
            with attempt:
                yield

    for plan, name in ((in_time, "timeout"), (cleaning, "finally"), (trying, "failure_handling")):
        for other in (in_time, cleaning, trying):
            first, second = plan(), other()
            next(first)
            next(second)
            with pytest.raises(BlocksMixed, match=name):
                list(first)
            with suppress(BlocksMixed):
                list(second)
            assert (current_scope(), current_block(), tasks.current()) == (None, None, None)
        assert list(zip(plan(), strict=True)) == [(None,)]


def test_what_began_in_one_thread_does_not_end_in_another() -> None:
    def plan() -> Iterator[None]:
        with timeout(100):
            yield

    with pytest.raises(BlocksMixed, match="a seq block"), seq:  # which ends the timeout
        begun = plan()
        next(begun)
        try:
            par(lambda: list(begun))
        except UsageError as error:
            refused = error
    assert isinstance(refused, BlocksMixed)
    assert refused.block == "timeout"
    assert current_scope() is None


def test_timeouts_and_cleanups_as_decorators() -> None:
    cleaned = []

    @timeout(100)
    @finally_(cleaned.append, 1)
    def act() -> int:
        return 3

    assert (act(), act(), cleaned) == (3, 3, [1, 1])


def test_blocks_in_context_managers() -> None:
    @contextmanager
    def beside(action: Callable[[], object]) -> Iterator[OpenBlock]:
        with par as s:
            s(action)
            yield s

    done: list[int] = []
    with beside(lambda: done.append(1)) as s, beside(lambda: done.append(2)) as t, ExitStack() as stack:
        u = stack.enter_context(par)
        u(done.append, 3)
        stack.enter_context(seq)(done.append, 4)
    assert sorted(done) == [1, 2, 3, 4]
    assert (s.state, t.state, u.state) == (S, S, S)


def test_the_five_words_may_be_used_again_in_threads_and_within_themselves() -> None:
    def deep(levels: int) -> int:
        if not levels:
            return 1
        with par as s:
            parts = [s(deep, levels - 1) for _ in range(2)]
        return sum(part.result() for part in parts)

    assert deep(4) == 16
    opening = par()
    with opening as s, opening as t:
        assert s is not t
    assert repr(par) == "par"


# --- trying again -----------------------------------------------------------------------------------------------------


def test_five_retries_are_six_runs_and_then_the_last_failure_with_the_earlier_ones() -> None:
    runs = []

    def run() -> None:
        runs.append(1)
        raise Unreachable("left", [len(runs), 0, 0])

    with pytest.raises(Unreachable) as raised:
        for attempt in failure_handling(5):
            with attempt:
                run()
    assert len(runs) == 6
    assert raised.value.target[0] == 6
    text = "".join(traceback.format_exception(raised.value))
    assert all(f"[{number}.000" in text for number in range(1, 7))
    node = tasks.tree().find(kind="failure-handling")[-1]
    assert [part.attempt for part in node.attempts] == [1, 2, 3, 4, 5, 6]
    assert {part.status for part in node.attempts} == {F}
    assert [part.failure.type for part in node.attempts] == ["Unreachable"] * 6
    assert node.status is F


def test_retry_as_the_original_says_it() -> None:
    seen = []
    for attempt in failure_handling(5, arm="left"):
        with attempt:
            try:
                seen.append((attempt.number, attempt["arm"]))
                if attempt["arm"] == "left":
                    fails()
            except Unreachable:
                retry(arm="right")
    assert seen == [(1, "left"), (2, "right")]
    node = tasks.tree().find(kind="failure-handling")[-1]
    assert [part.status for part in node.attempts] == [F, S]
    assert [part.parameters for part in node.attempts] == [{"arm": "left"}, {"arm": "right"}]
    runs = []
    with pytest.raises(Unreachable):
        for attempt in failure_handling(2):
            with attempt:
                runs.append(1)
                try:
                    fails()
                except Unreachable:
                    retry()
    assert len(runs) == 3
    with pytest.raises(PlanFailure, match="all 1 retries"):
        for attempt in failure_handling(1):
            with attempt:
                retry()
    with pytest.raises(UsageError, match="belongs into"):
        retry()


def test_retry_in_a_branch_reaches_its_attempt() -> None:
    runs = []

    def branch() -> None:
        runs.append(1)
        if len(runs) < 3:
            retry()

    for attempt in failure_handling(5):
        with attempt, par as s:
            s(branch)
            s(succeeds)
    assert len(runs) == 3


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt, SystemExit])
def test_trying_again_in_one_branch_does_not_hide_a_bug_or_ctrl_c_in_another(error: type[BaseException]) -> None:
    runs, begun = [], Gate()

    def tries_again() -> None:
        begun.pass_through()
        retry()

    def breaks_off() -> None:
        begun.open()
        raise error

    with pytest.raises(error):
        for attempt in failure_handling(5):
            with attempt:
                runs.append(1)
                par(tries_again, breaks_off)
    assert len(runs) == 1


def test_recoveries_by_the_type_of_failure() -> None:
    recovered = []

    def step_back(failure: InCollision) -> None:
        recovered.append(failure.bodies)

    def other_arm(failure: Unreachable) -> dict[str, object]:
        return {"arm": {"left": "right"}[failure.arm]}

    handling = failure_handling(3).on(Unreachable, other_arm).on(InCollision, step_back)

    def act(arm: str = "left") -> str:
        if not recovered:
            raise InCollision([0, 0, 0], [0, 0, 0, 1], ["table"])
        if arm == "left":
            par(fails, fails)  # a failed block of that type is of that type
        return arm

    assert handling.run(act) == "right"
    assert recovered == [["table"]]
    recovered.clear()
    assert handling(act)() == "right"  # as a decorator, and a second time
    with pytest.raises(KeyError):  # what a recovery raises comes out
        handling.run(lambda **_: (_ for _ in ()).throw(Unreachable("both", [0, 0, 0])))
    with pytest.raises(BadArgument, match="result of the recovery"):
        failure_handling(1).on(PlanFailure, lambda _: 3).run(fails)


def test_only_the_named_failures_and_never_bugs_are_tried_again() -> None:
    runs = []

    def run(action: Callable[[], None]) -> None:
        runs.append(1)
        action()

    with pytest.raises(LookingFailed):
        failure_handling(5, Unreachable).run(run, fails_to_look)
    with pytest.raises(BadArgument):
        failure_handling(5).run(run, is_wrong)
    with pytest.raises(BadArgument):
        for attempt in failure_handling(5):
            with attempt:
                try:
                    run(is_wrong)
                except UsageError:
                    retry()
    assert len(runs) == 3
    for wrong in (-1, True, 1.5):
        with pytest.raises(BadArgument):
            failure_handling(wrong)
    with pytest.raises(BadArgument):
        failure_handling(1, ValueError)


def test_what_python_cannot_run_again_says_so() -> None:
    with pytest.raises(UsageError, match="for attempt in failure_handling"), failure_handling(5):
        pass
    with pytest.raises(UsageError, match="has to be `with attempt:`"):
        for _ in failure_handling(5):
            pass


def test_leaving_the_loop_ends_the_handling_and_is_not_silent() -> None:
    with pytest.warns(FailureLeft, match="after attempt 2 had failed: Unreachable: left arm") as warned:
        for attempt in failure_handling(5):
            with attempt:
                fails()
            if attempt.number == 2:
                break
    assert warned[0].filename == __file__
    node = tasks.tree().find(kind="failure-handling")[-1]
    assert len(node.attempts) == 2
    assert node.status is F
    assert tasks.current() is None


def test_a_cancelled_branch_that_leaves_the_loop_is_not_warned() -> None:
    failed = Gate()

    def between_attempts() -> None:
        for attempt in failure_handling(5):
            with attempt:
                fails()
            failed.open()
            Gate().pass_through()

    with pursue as s:
        s(between_attempts)
        s(failed.pass_through)
    assert [branch.state for branch in s.branches] == [C, S]


def test_leaving_the_loop_with_the_failure_handled_or_raised() -> None:
    for attempt in failure_handling(5):
        with attempt:
            try:
                fails()
            except Unreachable:
                break
    with pytest.raises(LookingFailed):
        for attempt in failure_handling(5, Unreachable):
            with attempt:
                fails() if attempt.number == 1 else fails_to_look()


def test_attempts_in_a_concurrent_body_see_their_failures() -> None:
    runs = []

    def run() -> None:
        runs.append(1)
        if len(runs) < 3:
            fails()

    with par as s:
        for attempt in failure_handling(5):
            with attempt:
                par(run)
        s(failure_handling(5).run, run)
    assert len(runs) == 4


# --- time -------------------------------------------------------------------------------------------------------------


def test_what_takes_too_long_times_out_at_its_next_wait() -> None:
    gate = Gate()
    with pytest.raises(TimedOut, match=r"within 0\.02 s") as raised, timeout(0.02):
        gate.pass_through()
    assert (raised.value.seconds, raised.value.clock) == (0.02, "wall")
    with pytest.raises(TimedOut), timeout(0.02), par as s:
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


# --- at the end -------------------------------------------------------------------------------------------------------


def test_cleaning_up_happens_always_and_is_not_cancelled() -> None:
    gate, done = Gate(), []

    def clean(value: object) -> None:
        checkpoint()  # would stop a cancelled branch
        with par as s:
            s(done.append, value)

    def slow() -> None:
        with finally_(clean, "cancelled"):
            gate.pass_through()

    with pursue as s:
        s(slow)
        s(succeeds)
    assert s.branches[0].state is C
    with finally_(clean, "succeeded"):
        pass
    with pytest.raises(Unreachable), finally_(clean, "failed"):
        fails()
    assert done == ["cancelled", "succeeded", "failed"]
    with pytest.raises(BadArgument), finally_(3):
        pass


def test_failures_of_cleaning_up_are_not_lost() -> None:
    with pytest.raises(Unreachable), finally_(fails):
        pass
    with pytest.raises(LookingFailed) as raised, finally_(fails):
        fails_to_look()
    assert "can't reach" in "".join(traceback.format_exception(raised.value))
    with pytest.raises(BadArgument), finally_(is_wrong):
        fails()


def test_a_branch_that_cannot_clean_up_when_it_is_stopped_fails_the_block() -> None:
    inside = Gate()

    def slow() -> None:
        with finally_(fails):
            inside.open()
            Gate().pass_through()

    def in_a_block() -> None:
        with par as s:
            s(slow)

    def tried_again() -> None:
        failure_handling(3).run(slow)

    for branch in (slow, in_a_block, tried_again):
        inside.is_open = False
        with pytest.raises(NotCleanedUp, match=r"fails, done as .* Unreachable: left arm") as raised, pursue as s:
            s(branch)
            s(inside.pass_through)
        assert [branch.state for branch in s.branches] == [F, S]
        assert s.state is F
        text = "".join(traceback.format_exception(raised.value))
        assert "in fails" in text
    inside.is_open = False
    failures: list[BaseException] = []
    with try_all(failures) as s:
        s(slow)
        s(inside.pass_through)
    assert s.state is F
    assert isinstance(failures[0].failure, Unreachable)


def test_cleaning_up_that_fails_after_a_timeout_may_be_tried_again() -> None:
    cleaned: list[int] = []

    def clean() -> None:
        cleaned.append(1)
        if len(cleaned) < 3:
            fails()

    with pytest.raises(TimedOut):
        for attempt in failure_handling(2):
            with attempt, timeout(0.01), finally_(clean):
                Gate().pass_through()
    assert len(cleaned) == 3
    node = tasks.tree().find(kind="failure-handling")[-1]
    assert [part.failure.type for part in node.attempts] == ["NotCleanedUp", "NotCleanedUp", "TimedOut"]


def test_cancelled_is_what_a_cancelled_branch_sees() -> None:
    seen = []

    def branch() -> None:
        try:
            Gate().pass_through()
        except Cancelled:
            seen.append(1)
            raise

    with pursue as s:
        s(branch)
        s(lambda: None)
    assert seen in ([1], [])  # it may have been cancelled before it began


def test_handles_are_formatted_rounded_changed_and_copied_as_their_results() -> None:
    with par as s:
        number = s(lambda: 3.14159)
        table = s(lambda: {"a": [1]})
    assert f"{number:.2f} {round(number, 1)} {round(number)}" == "3.14 3.1 3"
    table["b"] = 2
    del table["a"]
    assert table.result() == {"b": 2}
    assert copy.copy(table) == copy.deepcopy(table) == {"b": 2}
    assert type(copy.copy(table)) is dict


def test_whatever_is_done_with_a_handle_is_done_with_its_result(tmp_path: Path) -> None:
    file = tmp_path / "x"
    file.write_text("text")
    with par as s:
        seven, names, path = s(lambda: 7), s(lambda: ["a", "b"]), s(lambda: file)
        opened, letters = s(file.open), s(lambda: iter("ab"))
    assert (divmod(seven, 2), divmod(15, seven), seven << 1, 1 << seven, ~seven, +seven) == (
        (3, 1),
        (2, 1),
        14,
        128,
        -8,
        7,
    )
    assert [*reversed(names)] == ["b", "a"]
    assert Path(path).read_text() == Path(os.path.join(path, "")[:-1]).read_text() == "text"  # noqa: PTH118
    with opened as stream:
        assert stream.read() == "text"
    assert opened.closed
    assert (next(letters), next(letters)) == ("a", "b")
    assert type(pickle.loads(pickle.dumps(names))) is list
