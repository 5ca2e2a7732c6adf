"""Cleanups run at the end of a scope, however it ended."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import traceback

import pytest

from pycram import tasks
from pycram.failures import BadArgument, LookingFailed, NotCleanedUp, Unreachable
from pycram.language import failure_handling, finally_, par, pursue, timeout, try_all
from pycram.language.timeouts import TimedOut
from pycram.scheduling.cancellation import checkpoint
from tests.pycram.language.gates import C, F, Gate, S, fails, fails_to_look, is_wrong, succeeds


def test_cleanups_run_always_and_are_not_cancelled() -> None:
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


def test_failures_of_cleanups_are_not_lost() -> None:
    with pytest.raises(Unreachable), finally_(fails):
        pass
    with pytest.raises(LookingFailed) as raised, finally_(fails):
        fails_to_look()
    assert "can't reach" in "".join(traceback.format_exception(raised.value))
    with pytest.raises(BadArgument), finally_(is_wrong):
        fails()


def test_a_failed_cleanup_of_a_cancelled_branch_fails_the_block() -> None:
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
        with pytest.raises(NotCleanedUp, match=r"fails, the cleanup .* Unreachable: left arm") as raised, pursue as s:
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


def test_a_failed_cleanup_after_a_timeout_may_be_retried() -> None:
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
