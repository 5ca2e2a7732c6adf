"""SIGTERM, SIGHUP and a second Ctrl-C: the recording is complete, and there is no traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from recorder.records import Event, Run
from recorder.tracing import interrupts, journal
from recorder.tracing.interrupts import Terminated
from tests.signal_at_line import modules, reached

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

REPO = Path(__file__).parents[3]
NUMBERS = pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])


@pytest.fixture(autouse=True)
def usual_handlers() -> Iterator[None]:
    """Handlers as a program has them that sets none; a test runner may have been started with others."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        assert signal.signal(number, handler) is signal.SIG_DFL, "it is as it was"


@NUMBERS
@pytest.mark.slow
def test_a_program_that_is_told_to_end_leaves_a_whole_recording_and_nothing_else(
    tmp_path: Path, number: signal.Signals
) -> None:
    program = """
import sys, threading
import recorder
from pycram.bullet_world import BulletWorld, Object
with recorder.record(sys.argv[1]), BulletWorld():
    Object("milk", "milk", "milk.stl")
    print("ready", flush=True)
    threading.Event().wait()
"""
    file, temporary = tmp_path / "x.mcap", tmp_path / "temporary"
    temporary.mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", program, str(file)],
        env=os.environ | {"PYTHONPATH": str(REPO), "TMPDIR": str(temporary)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        assert list(temporary.glob("pycram-models-*"))
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert errors == ""
    assert list(temporary.iterdir()) == []
    with replay.open(file) as log:
        assert log.complete
        assert isinstance(log[-1], Run)
        assert log[-1].interrupted_by == number.name


def tidy_up(tidied: list[int], number: int) -> None:
    try:
        signal.raise_signal(number)
    finally:
        tidied.append(number)


@NUMBERS
def test_the_signal_interrupts_the_plan_and_ends_the_program_after_that(tmp_path: Path, number: signal.Signals) -> None:
    tidied: list[int] = []
    with pytest.raises(Terminated) as ended, recorder.record(tmp_path / "x.mcap"):
        tidy_up(tidied, number)
    assert tidied
    assert (ended.value.code, ended.value.signal) == (128 + number, number.name)


def catch_it() -> None:
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    journal.emit(Event(name="tidied up"))


def test_a_plan_that_catches_the_interrupt_is_ended_after_its_recording(tmp_path: Path) -> None:
    with pytest.raises(Terminated), recorder.record(tmp_path / "x.mcap"):
        catch_it()
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.complete
        assert [record.name for record in log.records(Event)] == ["tidied up"]


@NUMBERS
@pytest.mark.parametrize("inside", [False, True])
def test_a_handler_of_the_program_s_own_stays(tmp_path: Path, number: signal.Signals, inside: bool) -> None:
    heard: list[int] = []

    def handler(got: int, _: object) -> None:
        heard.append(got)

    try:
        if not inside:
            signal.signal(number, handler)
        with recorder.record(tmp_path / "x.mcap"):
            if inside:
                signal.signal(number, handler)
            signal.raise_signal(number)
        assert signal.getsignal(number) is handler
    finally:
        signal.signal(number, signal.SIG_DFL)
    assert heard == [number]


def ignore_all_but_the_last() -> None:
    signal.raise_signal(signal.SIGHUP)
    signal.raise_signal(signal.SIGINT)
    with interrupts.Uninterrupted():
        signal.raise_signal(signal.SIGINT)
    journal.emit(Event(name="undisturbed"))
    with interrupts.Uninterrupted():
        signal.raise_signal(signal.SIGTERM)
        journal.emit(Event(name="whole"))
    journal.emit(Event(name="never"))


def test_what_is_ignored_stays_ignored(tmp_path: Path) -> None:
    """As of ``nohup``, and of Ctrl-C in the background, where SIGTERM ends the plan all the same."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        with pytest.raises(Terminated) as ended, recorder.record(tmp_path / "x.mcap"):
            ignore_all_but_the_last()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    assert ended.value.signal == "SIGTERM"
    with replay.open(tmp_path / "x.mcap") as log:
        assert [record.name for record in log.records(Event)] == ["undisturbed", "whole"]


def test_a_forked_child_dies_of_the_signal(tmp_path: Path) -> None:
    """As those of ``multiprocessing`` do, which are terminated so."""
    with recorder.record(tmp_path / "x.mcap"):
        child = os.fork()
        if child == 0:
            try:
                signal.raise_signal(signal.SIGTERM)
            finally:
                os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGTERM


@NUMBERS
def test_a_forked_child_needs_no_handler_to_die(tmp_path: Path, number: signal.Signals) -> None:
    """A worker of a pool that begins to wait for a lock as it is terminated would call none, and never end."""
    with recorder.record(tmp_path / "x.mcap"):
        child = os.fork()
        if child == 0:
            os._exit(signal.getsignal(number) is signal.SIG_DFL)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
        assert callable(signal.getsignal(number))


def interrupted(file: Path, ended: list[BaseException]) -> None:
    try:
        with recorder.record(file, overwrite=True):
            journal.emit(Event(name="tick"))
            signal.default_int_handler(signal.SIGINT, None)
    except KeyboardInterrupt as error:
        ended.append(error)


@pytest.mark.slow
def test_a_second_ctrl_c_while_the_recording_is_closed_changes_nothing(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    closing = modules("recorder/mcap_writer.py", "recorder/mcap_sink.py", "recorder/tracing/journal.py")
    lines = reached_lines(partial(interrupted, file, []), closing)
    for line in range(lines - 60, lines, 3):  # the last ones are run while it is closed
        ended: list[BaseException] = []
        assert reached(line, signal.SIGINT, partial(interrupted, file, ended), closing)
        (error,) = ended
        assert error.__context__ is None, f"line {line}: one error, no traceback of another"
        with replay.open(file) as log:
            assert log.complete
            assert isinstance(log[-1], Run)


def reached_lines(action: Callable[[], None], traced: frozenset[str]) -> int:
    """How many lines of these files an action runs."""
    count = 0

    def trace(frame: object, event: str, _: object) -> object:
        nonlocal count
        if frame.f_code.co_filename not in traced:  # type: ignore[attr-defined]
            return None
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)  # type: ignore[arg-type]
    try:
        action()
    finally:
        sys.settrace(before)
    return count
