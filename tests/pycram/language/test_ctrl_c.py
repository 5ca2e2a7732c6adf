"""Ctrl-C ends blocks and their branches, whenever it arrives, and leaves nothing behind."""

# ruff: noqa: PT012  the blocks under test have bodies
from __future__ import annotations

import gc
import itertools
import os
import random
import signal
import sys
import threading

import pytest
from greenlet import greenlet

from pycram import tasks
from pycram.language import failure_handling, finally_, par, pursue, seq, timeout, try_all, try_in_order
from pycram.language.branch import current_block
from pycram.language.nesting import Scope
from pycram.scheduling.cancellation import checkpoint, current_scope
from pycram.scheduling.schedule import scheduler
from recorder.tracing import interrupts, journal
from recorder.tracing.span import span
from tests.pycram.language.gates import C, F, Gate, S, fails, succeeds
from tests.signal_at_line import modules, reached


def press() -> None:
    signal.raise_signal(signal.SIGINT)


def assert_nothing_left() -> None:
    assert current_block() is None
    assert current_scope() is None
    assert journal.task_id() == 0
    assert not interrupts.is_pending()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert not scheduler().branches
    with seq as s, seq as t:  # no scope is left open
        t(succeeds)
    assert s.state is S


def test_interrupting_the_body_cancels_the_branches() -> None:
    gate = Gate()
    for kind in (par, pursue, try_all):
        with pytest.raises(KeyboardInterrupt), kind as s:
            s(gate.pass_through)
            raise KeyboardInterrupt
        assert s.branches[0].state is C


def test_ctrl_c_in_the_plan_s_own_python_is_raised_at_once() -> None:
    reached = []
    with pytest.raises(KeyboardInterrupt), par as s:
        s(Gate().pass_through)
        press()
        reached.append("never")
    assert not reached
    with pytest.raises(KeyboardInterrupt), seq as s:
        s(lambda: (press(), reached.append("never")))
    assert not reached
    assert_nothing_left()


def test_ctrl_c_in_a_branch_is_raised_in_the_outermost_block_at_the_next_checkpoint() -> None:
    gate, reached = Gate(), []

    def interrupted() -> None:
        press()
        reached.append("goes on")
        checkpoint()
        reached.append("never")

    with pytest.raises(KeyboardInterrupt), par as s:
        with pursue as t:
            t(gate.pass_through)
        s(gate.pass_through)
        s(interrupted)
    assert reached == ["goes on"]
    assert {branch.state for branch in s.branches} == {C}
    assert_nothing_left()


@pytest.mark.slow
def test_one_ctrl_c_while_all_branches_wait_ends_them() -> None:
    main, rounds = threading.get_ident(), 40
    go = threading.Semaphore(0)
    gates: list[Gate] = []

    def press_once_a_round() -> None:
        for _ in range(rounds):
            go.acquire()
            signal.pthread_kill(main, signal.SIGINT)  # perhaps just before the thread goes to sleep
            if not go.acquire(timeout=20):
                gates[-1].open()
                go.acquire()

    thread = threading.Thread(target=press_once_a_round)
    thread.start()
    interrupted = 0
    for _ in range(rounds):
        gates.append(gate := Gate())
        try:
            with par as s:
                s(gate.pass_through)
                s(lambda gate=gate: (go.release(), gate.pass_through()))
        except KeyboardInterrupt:
            interrupted += 1
            assert {branch.state for branch in s.branches} == {C}
        go.release()
    thread.join()
    assert interrupted == rounds
    assert_nothing_left()


def test_a_second_ctrl_c_prints_the_branches_that_it_waits_for(monkeypatch: pytest.MonkeyPatch) -> None:
    class Screen:
        text = ""

        def write(self, text: str) -> None:
            self.text += text

    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)

    def busy() -> None:
        press()
        assert not screen.text
        press()
        assert "waiting for par-1" in screen.text

    with pytest.raises(KeyboardInterrupt), par as s:
        s(busy)
    assert s.branches[0].state is S
    screen.text = ""

    def cleans_up_slowly() -> None:
        with finally_(press):
            press()
            checkpoint()

    with pytest.raises(KeyboardInterrupt), par as s:
        s(cleans_up_slowly)
    assert "waiting for par-1" in screen.text
    assert_nothing_left()


def test_a_cleanup_runs_also_after_ctrl_c() -> None:
    done = []

    def branch() -> None:
        with finally_(done.append, "cleaned up"):
            press()
            checkpoint()

    with pytest.raises(KeyboardInterrupt), par as s:
        s(branch)
    assert done == ["cleaned up"]


def plan() -> None:
    """Use every part of the language."""
    gate = Gate()
    with par as s:
        s(gate.open)
        s(gate.pass_through)
        with seq as t:
            t(succeeds)
            with pursue as u:
                u(gate.pass_through)
                u(checkpoint)
        s(lambda: try_all(fails, succeeds))
    with timeout(60), finally_(succeeds), try_in_order as s:
        with seq as t:
            t(fails)
        s(succeeds)
    for attempt in failure_handling(1):
        with attempt:
            succeeds()


TRACED = modules("pycram/language", "pycram/scheduling", "recorder/tracing/span.py")


@pytest.mark.slow
@pytest.mark.parametrize(
    "every", [41, pytest.param(13, marks=pytest.mark.costly), pytest.param(1, marks=pytest.mark.long)]
)
def test_ctrl_c_at_any_line_of_the_language_leaves_nothing_behind(every: int) -> None:
    ended = 0
    for number in itertools.count(1, every):
        try:
            came_there = reached(number, signal.SIGINT, plan, TRACED)
        except KeyboardInterrupt:
            ended += 1
        else:
            if not came_there:
                break
            pytest.fail(f"Ctrl-C at line {number} was lost")
        assert_nothing_left()
    assert ended * every > 500


@pytest.mark.slow
def test_ctrl_c_at_any_moment_leaves_nothing_behind() -> None:
    main, dice, rounds = threading.get_ident(), random.Random(1), 60
    go, pressed = threading.Semaphore(0), threading.Semaphore(0)

    def press_soon() -> None:
        for _ in range(rounds):
            go.acquire()
            sum(range(dice.randrange(60_000)))  # some time, so that it hits anywhere
            signal.pthread_kill(main, signal.SIGINT)
            pressed.release()

    thread = threading.Thread(target=press_soon)
    thread.start()
    ended = 0
    for _ in range(rounds):
        try:
            go.release()
            while True:
                plan()
        except KeyboardInterrupt:
            ended += 1
        pressed.acquire()
        assert_nothing_left()
    thread.join()
    assert ended == rounds
    assert not [g for g in gc.get_objects() if type(g) is greenlet and g and g.parent is not None]


def test_ctrl_c_that_keeps_a_block_from_ending_is_noticed_by_the_block_around_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = Scope.__exit__

    def never_called(opening: Scope[object], *raised: object) -> bool | None:
        if opening is pursue:
            raise KeyboardInterrupt
        return whole(opening, *raised)

    monkeypatch.setattr(Scope, "__exit__", never_called)
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


def test_a_handler_of_the_plan_s_own_is_called_and_stays() -> None:
    calls: list[str] = []
    before = signal.signal(signal.SIGINT, lambda *_: calls.append("pressed"))
    try:
        with par as s:
            s(press)
            s(os.getpid)
        assert calls == ["pressed"]
        assert signal.getsignal(signal.SIGINT)(0, None) is None
        assert calls == ["pressed", "pressed"]
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_error_that_a_handler_of_the_plan_s_own_raises_while_all_branches_wait_is_raised_in_the_block() -> None:
    main, gate, over = threading.get_ident(), Gate(), threading.Event()
    waiting = threading.Event()

    def handler(*_: object) -> None:
        raise ZeroDivisionError

    def press_when_all_wait() -> None:
        waiting.wait(20)
        while not over.wait(0.05):
            signal.pthread_kill(main, signal.SIGUSR1)

    before = signal.signal(signal.SIGUSR1, handler)
    thread = threading.Thread(target=press_when_all_wait)
    thread.start()
    try:
        with pytest.raises(ZeroDivisionError), par as s:
            s(lambda: (waiting.set(), gate.pass_through()))
            s(gate.pass_through)
    finally:
        over.set()
        thread.join()
        signal.signal(signal.SIGUSR1, before)
    assert {branch.state for branch in s.branches} == {C}
    assert_nothing_left()
    assert not [g for g in gc.get_objects() if type(g) is greenlet and g and g.parent is not None]
