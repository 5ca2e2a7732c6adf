"""Ctrl-C ends blocks and their threads, wherever it comes."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import itertools
import os
import signal
import sys
import threading
from contextlib import _GeneratorContextManager
from typing import TYPE_CHECKING

import pytest

from pycram import nesting, tasks
from pycram.binding import Binding
from pycram.cancellation import current_scope
from pycram.language import failure_handling, finally_, par, pursue, seq, timeout, try_all
from pycram.nested_blocks import Deferred, _Asked
from pycram.open_block import current_block
from recorder.tasks import State
from recorder.tracing import journal
from recorder.tracing.span import Span, span
from tests.pycram.language.gates import KINDS, C, F, Gate, S, succeeds

if TYPE_CHECKING:
    from collections.abc import Callable


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


def plan_of_blocks() -> None:
    with par as s, seq as q:
        q(succeeds)
        s(succeeds)


def plan_of_attempts() -> None:
    for attempt in failure_handling(1):
        with attempt:
            succeeds()


@pytest.mark.parametrize(
    ("plan", "kind", "moment", "number"),
    [
        *itertools.product([plan_of_blocks], [Binding], ["__enter__", "__exit__"], range(4)),
        (plan_of_attempts, _GeneratorContextManager, "__exit__", 0),
        (plan_of_attempts, Span, "__enter__", 0),
    ],
)
def test_ctrl_c_while_context_is_bound_or_freed_leaves_nothing_bound(
    plan: Callable[[], None], kind: type, moment: str, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    bind = getattr(kind, moment)
    left = [number]

    def interrupted(binding: object, *told: object) -> None:
        here = threading.current_thread() is threading.main_thread()
        hit = here and left == [0]
        if here and left:
            left[0] -= 1
        if moment == "__enter__":
            bind(binding, *told)
        if hit:
            signal.raise_signal(signal.SIGINT)
        if moment == "__exit__":
            bind(binding, *told)

    monkeypatch.setattr(kind, moment, interrupted)
    with pytest.raises(KeyboardInterrupt):
        plan()
    assert left[0] < 0
    assert current_block() is None
    assert current_scope() is None
    assert journal.task_id() == 0
    assert tasks.tree().find(status=State.RUNNING) == []


def test_ctrl_c_that_a_block_never_hears_of_ends_it_with_the_block_around_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(block: Deferred, *_: object) -> bool:
        block._exits.close()
        raise KeyboardInterrupt

    monkeypatch.setattr(Deferred, "__exit__", interrupted)
    begun = Gate()
    with pytest.raises(KeyboardInterrupt), par, seq as q:
        q(begun.open)
        begun.pass_through()


@pytest.mark.parametrize("interrupted", [4, 5, 6])
@pytest.mark.parametrize("name", [*KINDS, "timeout", "attempt", "cleanup"])
def test_ctrl_c_between_the_end_of_a_body_and_that_of_its_block_ends_all(
    name: str, interrupted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate()
    looked = []

    def look() -> int:
        looked.append(name)
        if len(looked) == interrupted:  # after three beginnings
            raise KeyboardInterrupt
        return 0

    openings = {
        "timeout": lambda: timeout(60),
        "attempt": lambda: next(iter(failure_handling(1))),
        "cleanup": lambda: finally_(succeeds),
    }
    opening = KINDS.get(name) or openings[name]()
    monkeypatch.setattr(nesting, "_generator", look)
    with pytest.raises(KeyboardInterrupt), par as s, opening, pursue as t:
        s(succeeds)
        t(gate.pass_through)
        t(succeeds)
    assert len(looked) >= interrupted
    assert {branch.done for branch in (*s.branches, *t.branches)} == {True}
    assert current_block() is None
    assert current_scope() is None
    with seq as s:  # nothing that was left open is in its way
        s(succeeds)


def test_ctrl_c_that_keeps_a_block_from_ending_is_noticed_by_the_one_around_it(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = nesting.Nested.__exit__

    def never_called(opening: nesting.Nested[object], *raised: object) -> bool | None:
        if opening is pursue:
            raise KeyboardInterrupt
        return whole(opening, *raised)

    monkeypatch.setattr(nesting.Nested, "__exit__", never_called)
    gate = Gate()
    with pytest.raises(KeyboardInterrupt), seq, pursue as s:
        s(gate.pass_through)
    assert s.branches[0].state is C
    assert current_block() is None
    assert current_scope() is None


def test_ctrl_c_before_the_record_of_a_tasks_end_leaves_no_task_running(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = []

    def interrupted() -> bool:
        ended.append(True)
        if len(ended) == 1:
            raise KeyboardInterrupt
        return False

    task = span("motion", "moving")
    with pytest.raises(KeyboardInterrupt), task:
        monkeypatch.setattr(journal, "recording", interrupted)
    assert tasks.tree().nodes[task.id].status is F


@pytest.mark.parametrize("saying", [_Asked.put, _Asked.end])
def test_ctrl_c_while_a_block_in_another_is_told_something_keeps_no_lock_of_it(
    saying: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    enter = threading.Condition.__enter__
    left = [saying.__code__]

    def interrupted(condition: threading.Condition) -> bool:
        taken = enter(condition)
        if [sys._getframe(1).f_code] == left:
            left.clear()
            signal.raise_signal(signal.SIGINT)
        return taken

    monkeypatch.setattr(threading.Condition, "__enter__", interrupted)
    with pytest.raises(KeyboardInterrupt), par, seq as q:
        q(succeeds)
    assert not left
