"""Waiting for fluents, from many threads: no value is missed, and cancelling ends it at once."""

from __future__ import annotations

import math
import signal
import threading

import pytest

from pycram.failures import BadArgument
from pycram.fluent import Fluent, network, whenever
from pycram.fluents.fluent import StateStream
from pycram.language import par, pursue
from pycram.scheduling.cancellation import CancelScope, checkpoint, entered
from recorder.tracing.span import Cancelled
from tests.pycram.fluents.waiters import HANG_TIMEOUT, Running, waiting


def test_a_wait_ends_with_its_timeout() -> None:
    fluent = Fluent(1)
    assert (fluent > 3).wait_for(timeout=0.01) is False
    assert (fluent > 3).wait_for(0) is False
    assert (fluent < 3).wait_for(0) is True
    assert fluent.wait_for(1e300) is True
    with pytest.raises(BadArgument, match="timeout"):
        fluent.wait_for(math.nan)


def test_setting_false_notifies_waits_for_not() -> None:
    fluent = Fluent(True)
    with waiting(fluent.NOT()) as running:
        fluent.set_value(False)
        assert running.end() is True


def test_a_wait_is_notified_when_there_is_a_state_to_look_at(monkeypatch: pytest.MonkeyPatch) -> None:
    fluent, seen = Fluent(1), []
    with StateStream(fluent.expression) as stream:
        next(stream.states())
        monkeypatch.setattr(stream._news, "notify_all", lambda: seen.append(len(stream._states)))
        fluent.set_value(2)
    assert seen == [1]


@pytest.mark.slow
def test_threads_that_wait_miss_no_state_whenever_they_look() -> None:
    last = 299
    for _ in range(30):
        counter = Fluent(None)
        waits = [(counter.IS(None).OR(True).AND(counter == last)).wait_for for _ in range(8)]
        threads = [threading.Thread(target=wait_for, kwargs={"timeout": 100}, daemon=True) for wait_for in waits]
        for thread in threads:
            thread.start()
        for number in range(last + 1):
            counter.set_value(number)
        for thread in threads:
            thread.join(20)
        assert not [thread for thread in threads if thread.is_alive()]


def test_all_waits_are_notified() -> None:
    fluent = Fluent()
    with waiting(fluent) as first, waiting(fluent > 3) as second, waiting(fluent) as third:
        fluent.set_value(4)
        assert [running.end() for running in (first, second, third)] == [True] * 3


def test_a_value_is_seen_however_short_it_lasts() -> None:
    fluent = Fluent(0)
    with waiting(fluent == 1) as running:
        fluent.set_value(1)
        fluent.set_value(0)
        assert running.end() is True


def test_a_reaction_does_not_lag_behind_the_values_before_it() -> None:
    """A simulation assigns 30 values a second in one turn; a wait looks at all of them in its next turn."""
    height = Fluent(100)
    seen: list[object] = []

    def fall() -> None:
        for value in reversed(range(100)):
            height.set_value(value)
        for _ in range(5):
            checkpoint()

    with pursue as s:
        s(lambda: seen.append((height == 0).wait_for()))
        s(fall)
    assert seen == [True]


def test_a_network_never_shows_a_mix_of_two_moments() -> None:
    a = Fluent(0)
    mixed = network(lambda low, high: None if high - low == 1 else (low, high), a, a + 1)
    with waiting(mixed.OR(a == -1)) as running:
        setting = Running(lambda: [a.set_value(number) for number in range(2000)])
        while setting.thread.is_alive():
            assert mixed.get_value() is None
        setting.end()
        assert running.outcome is None  # the one who waits saw all 2000 and no mix
        a.set_value(-1)
        assert running.end() is True
    assert mixed.get_value() is None


def test_functions_of_networks_run_in_the_waiting_thread_without_a_lock() -> None:
    a = Fluent(1)
    where: list[str] = []

    def function(value: int) -> int | None:
        where.append(threading.current_thread().name)
        reading = Running(lambda: a.pulsed().get_value())  # needs the lock of all fluents
        assert reading.end() is None
        return value if value > 1 else None

    with waiting(network(function, a)) as running:
        a.set_value(2)
        assert running.end() is True
    assert threading.current_thread().name not in where


def test_many_threads_set_and_wait() -> None:
    turn = Fluent(0)
    count = 8

    def play(number: int) -> int:
        for round_ in range(10):
            assert (turn == round_ * count + number).wait_for(HANG_TIMEOUT)
            turn.set_value(turn.get_value() + 1)
        return number

    players = [Running(lambda number=number: play(number)) for number in range(count)]
    assert [player.end() for player in players] == list(range(count))
    assert turn.get_value() == 10 * count


@pytest.mark.parametrize("kind", ["value", "network", "pulsed", "whenever"])
def test_cancelling_a_branch_ends_its_wait(kind: str) -> None:
    fluent = Fluent()
    if kind == "whenever":
        looked = threading.Event()
        watched = network(lambda value: (looked.set(), value)[1], fluent)
        running = Running(lambda: [None for _ in whenever(watched)])
        assert looked.wait(HANG_TIMEOUT)
        running.scope.cancel()
    else:
        awaited = {"value": fluent, "network": fluent.IS(3), "pulsed": fluent.pulsed()}[kind]
        with waiting(awaited) as running:
            running.scope.cancel()
    assert isinstance(running.end(), Cancelled)
    assert not fluent.expression.waiters
    fluent.set_value(3)


def test_a_wait_ends_in_time_however_often_the_value_changes() -> None:
    fluent = Fluent(0)
    looked = threading.Event()

    def another(value: int) -> None:
        fluent.set_value(value + 1)
        if value > 100:
            looked.set()

    restless = network(another, fluent)
    assert restless.wait_for(timeout=0.01) is False
    running = Running(restless.wait_for)
    assert looked.wait(HANG_TIMEOUT)
    running.scope.cancel()
    assert isinstance(running.end(), Cancelled)


def test_waiting_in_a_cancelled_branch_raises_even_if_there_is_a_value() -> None:
    fluent = Fluent(1)
    scope = CancelScope()
    scope.cancel()
    with entered(scope):
        with pytest.raises(Cancelled):
            fluent.wait_for()
        with pytest.raises(Cancelled):
            next(whenever(fluent))


def test_interrupting_a_block_ends_the_waits_in_it() -> None:
    battery, charged = Fluent(100, "battery"), Fluent(0)
    threads = threading.active_count()

    def charge() -> None:
        battery.set_value(100)
        charged.set_value(charged.get_value() + 1)

    def plan() -> None:
        with par as s:
            s(whenever, battery < 20, charge)
            s((battery < 0).wait_for)
            for times in range(1, 4):
                battery.set_value(10)
                assert (charged == times).wait_for(HANG_TIMEOUT)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan()
    assert threading.active_count() == threads
    assert not battery.expression.waiters


def test_an_old_values_finalizer_may_use_fluents() -> None:
    fluent, finalized = Fluent(), Fluent(0)

    class Old:
        def __del__(self) -> None:
            assert Running(lambda: finalized.set_value(finalized.get_value() + 1)).end() is None  # in another thread

    fluent.set_value(Old())
    fluent.set_value(None)
    assert finalized.get_value() == 1


def test_ctrl_c_ends_a_wait() -> None:
    fluent = Fluent()
    main = threading.get_ident()
    looked = threading.Event()
    watched = network(lambda value: (looked.set(), value)[1], fluent)
    over = threading.Event()

    def press() -> None:
        assert looked.wait(HANG_TIMEOUT)
        signal.pthread_kill(main, signal.SIGINT)
        if not over.wait(1):  # CPython sees one only later that comes just before it goes to sleep
            signal.pthread_kill(main, signal.SIGINT)

    running = Running(press)
    with pytest.raises(KeyboardInterrupt):
        watched.wait_for(HANG_TIMEOUT)
    over.set()
    running.end()
    assert not fluent.expression.waiters
