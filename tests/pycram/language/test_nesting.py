"""Blocks, timeouts, attempts and cleanups end in the order of ``with`` statements, or are refused."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

from contextlib import ExitStack, contextmanager, suppress
from contextvars import copy_context
from typing import TYPE_CHECKING

import pytest

from pycram import tasks
from pycram.failures import UsageError
from pycram.language import State, failure_handling, finally_, par, seq, timeout
from pycram.language.branch import current_block
from pycram.language.nesting import Misnested
from pycram.scheduling.cancellation import current_scope
from tests.pycram.language.gates import C, F, Gate, S, succeeds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.language import Kind
    from pycram.language.block import Block


def test_blocks_in_generators_that_end_out_of_order_are_refused() -> None:
    def plan(kind: Kind) -> Iterator[Block]:
        with kind as s:
            yield s

    for kind in (par, seq):
        first, second = plan(kind), plan(par)
        s, t = next(first), next(second)
        gate = Gate()
        if kind is par:
            s(gate.pass_through)
        t(gate.pass_through)
        with pytest.raises(Misnested, match=f"a {kind} block must end in the branch that opened it"):
            list(first)
        assert State.RUNNING not in {branch.state for block in (s, t) for branch in block.branches}
        with pytest.raises(Misnested):
            list(second)
        assert current_block() is None
        left = plan(kind)
        with pytest.raises(Misnested), par:
            next(left)
        with pytest.raises(Misnested):
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
        for other_plan in (in_time, cleaning, trying):
            first, second = plan(), other_plan()
            next(first)
            next(second)
            with pytest.raises(Misnested, match=name):
                list(first)
            with suppress(Misnested):
                list(second)
            assert (current_scope(), current_block(), tasks.current()) == (None, None, None)
        assert list(zip(plan(), strict=True)) == [(None,)]


def test_a_scope_opened_in_one_branch_is_not_ended_by_another() -> None:
    def plan() -> Iterator[None]:
        with timeout(100):
            yield

    with pytest.raises(Misnested, match="a seq block"), seq:  # which ends the timeout
        begun = plan()
        next(begun)
        try:
            par(lambda: list(begun))
        except UsageError as error:
            refused = error
    assert isinstance(refused, Misnested)
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
    def beside(action: Callable[[], object]) -> Iterator[Block]:
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


def test_a_block_that_an_exit_stack_ends_before_a_later_one_is_refused() -> None:
    gate = Gate()
    stack = ExitStack()
    first = stack.enter_context(par())
    with pytest.raises(Misnested), seq:
        first(gate.pass_through)
        stack.close()
    assert [branch.state for branch in first.branches] == [F, C]  # the later one, and what it left waiting
    assert current_block() is None
    assert current_scope() is None


def test_a_block_that_another_context_ends_has_failed() -> None:
    def in_pieces() -> Iterator[None]:
        with par as s:
            s(succeeds)
            yield

    pieces = in_pieces()
    begun = copy_context()
    begun.run(next, pieces)
    with pytest.raises(ValueError, match="different Context"):
        begun.run(copy_context).run(next, pieces)
    block = tasks.tree().find(kind="block")[-1]
    assert (block.status, [branch.status for branch in block.children]) == (F, [S])
