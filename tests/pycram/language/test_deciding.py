"""The table of semantics: which end of a branch decides a block, and what becomes of the others."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

from pycram.failures import BadArgument, BranchesFailed, LookingFailed, Unreachable
from pycram.language import State, par, pursue
from recorder.tracing.span import Cancelled
from tests.pycram.language.gates import KINDS, C, F, Gate, S, fails, fails_to_look, has_a_bug, is_wrong, succeeds

if TYPE_CHECKING:
    from collections.abc import Callable


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
        future = s(succeeds, 5)
    assert s.state is S
    assert future == 5
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
    assert [type(failure) for failure in raised.value.failures] == [Unreachable, LookingFailed][:count]
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
def test_bugs_are_raised_by_every_block_as_they_are(name: str, bug: Callable[[], None]) -> None:
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
def test_a_bug_in_the_body_of_a_block_that_is_read_is_raised_too(name: str) -> None:
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
            future = t(succeeds, 7)
        with KINDS[inner] as u:  # try_in_order doesn't come here
            done.append("body")
            u(done.append, 8)
        s(done.append, 9) if outer in ("par", "seq") else None
    assert s.state is S
    if outer == "try_in_order":
        assert not done
    if outer in ("par", "seq"):
        assert future == 7
        assert (t.state, u.state) == (S, S)
        assert sorted(done[1:]) == [8, 9]
    with pytest.raises(Unreachable), KINDS[outer] as s:
        with KINDS[inner]:
            fails()
        if outer != "pursue":
            KINDS[inner](fails)
    assert s.state is F


@pytest.mark.parametrize("name", KINDS)
def test_a_block_is_cancelled_by_the_one_around_it(name: str) -> None:
    """It stops at its next wait or action, and the code after it isn't run."""
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
        reached.append("after")

    with pursue as outer:
        outer(inner)
        outer(inside.pass_through)
    assert [branch.state for branch in outer.branches] == [C, S]
    (s,) = reached
    assert s.state is C
    assert {branch.state for branch in s.branches} == {C}
    assert len(s.branches) == 1 or s.policy.concurrent


def test_cancelled_is_raised_in_a_cancelled_branch() -> None:
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
