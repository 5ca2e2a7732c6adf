"""Printed and logged lines: streams behave as before, and each line is a record with task and plan line."""

from __future__ import annotations

import io
import logging
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.language import par
from recorder.records import Event, Output, Run
from recorder.tracing import journal
from recorder.tracing.journal import Journal
from recorder.tracing.output import MAX_CHARACTERS, recorded_output
from recorder.tracing.span import span
from replay.cli.main import main
from replay.restore.verify import verify

if TYPE_CHECKING:
    from recorder.records import Record
    from recorder.records.values import AssetFile


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "x.mcap"


def said(file: Path) -> list[tuple[str, str]]:
    with replay.open(file) as log:
        return [(record.stream, record.text) for record in log.records(Output)]


def test_lines_are_printed_as_before_and_recorded_with_task_and_line(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with recorder.record(file, output=True, source=__file__):
        print("before")
        with span("motion", "inner") as inner:
            print("one", 2, sep=", ")
            sys.stderr.write("and\nmore\n\n")
        print("\x1b[31mred\x1b[0m")
    output = capsys.readouterr()
    assert output.err == "and\nmore\n\n"
    assert output.out.startswith("before\none, 2\n\x1b[31mred")
    with replay.open(file) as log:
        lines = list(log.records(Output))
        assert [(line.stream, line.text, line.task) for line in lines] == [
            ("stdout", "before", 0),
            ("stdout", "one, 2", inner.id),
            ("stderr", "and", inner.id),
            ("stderr", "more", inner.id),
            ("stdout", "red", 0),
        ]
        source = Path(__file__).read_text(encoding="utf-8").splitlines()
        printed = next(at for at, text in enumerate(source, 1) if 'print("one"' in text)
        assert (lines[1].source_file, lines[1].source_line) == (__file__, printed)
        assert verify(log).sound


def test_nothing_is_recorded_unless_asked_for(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sys.stdout, sys.stderr, logging.Logger.callHandlers
    with recorder.record(file):
        assert (sys.stdout, sys.stderr, logging.Logger.callHandlers) == before
        print("quiet")
    assert said(file) == []
    with recorder.record(file, output=True, overwrite=True):
        assert sys.stdout is not before[0]
    assert (sys.stdout, sys.stderr, logging.Logger.callHandlers) == before


def test_a_line_that_is_printed_bit_by_bit_is_one_record(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(file, output=True):
        print("a", end="")
        sys.stdout.flush()
        print("b", end="")
        print("c\nd", end="")
        for percent in (10, 50, 100):
            sys.stderr.write(f"\r{percent} %")
        sys.stderr.write("\n")
        for percent in (20, 100):
            sys.stderr.write(f"{percent} %\r")
        sys.stderr.writelines(["\n", "x" * (MAX_CHARACTERS + 1), "\n"])
        print("the end", end="")
    assert said(file) == [
        ("stdout", "abc"),
        ("stderr", "100 %"),
        ("stderr", "100 %"),
        ("stderr", "x" * MAX_CHARACTERS),
        ("stderr", "x"),
        ("stdout", "dthe end"),
    ]


def test_threads_and_branches_have_lines_of_their_own(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    turns = threading.Barrier(2)

    def talk(name: str) -> None:
        for word in (f"{name} says", " this", "\n"):
            turns.wait()
            print(word, end="")

    with recorder.record(file, output=True):
        threads = [threading.Thread(target=talk, args=[name], name=name) for name in ("Ada", "Bob")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        print("left ", end="")
        with par as s:
            s(lambda: print("right"))
        print("over")
    assert sorted(said(file)) == [
        ("stdout", "Ada says this"),
        ("stdout", "Bob says this"),
        ("stdout", "left over"),
        ("stdout", "right"),
    ]


class Terminal(io.StringIO):
    """A terminal of another encoding."""

    encoding = "latin-1"  # type: ignore[assignment]

    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        return 42


def test_all_else_that_a_stream_can_do_is_as_before(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    with recorder.record(file, output=True):
        kept = sys.stdout
        assert kept.isatty()
        assert kept.encoding == "latin-1"
        assert kept.fileno() == 42
        assert isinstance(kept, io.TextIOBase)
        assert kept.write("four") == 4
        with pytest.raises(TypeError):
            kept.write(b"bytes")  # type: ignore[arg-type]
        monkeypatch.setattr(sys, "stdout", other := io.StringIO())  # a plan's own stream is its own
        print("elsewhere")
    assert sys.stdout is other
    kept.write(" after the end")  # by a handler that kept it
    assert terminal.getvalue() == "four after the end"
    assert said(file) == [("stdout", "four")]


def test_messages_of_logging_are_recorded_once_with_logger_and_level(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logger = logging.getLogger("test.output")
    with recorder.record(file, output=True):
        made = logging.StreamHandler()  # which keeps the stream that records
        logger.addHandler(made)
        logger.propagate = False  # pytest's own handler raises what a wrong format does
        try:
            logger.info("too fine")
            logger.warning("careful with %s", "eggs")
            try:
                int("spoon")
            except ValueError:
                logger.exception("lost")
            logger.error("%d", "no number")
        finally:
            logger.propagate = True
            logger.removeHandler(made)
    with replay.open(file) as log:
        messages = [record for record in log.records(Output) if record.stream == "logging"]
        assert [(record.level, record.logger, record.text) for record in messages] == [
            ("WARNING", "test.output", "careful with eggs"),
            ("ERROR", "test.output", "lost: ValueError: invalid literal for int() with base 10: 'spoon'"),
            ("ERROR", "test.output", "%d"),
        ]
        assert all(record.source_file == __file__ for record in messages)
        assert sum(1 for _ in log.records(Output)) == 3
    assert "careful with eggs\nlost\nTraceback" in capsys.readouterr().err


class Talkative:
    """A sink that prints and logs whatever it gets."""

    def __init__(self) -> None:
        self.records: list[Record] = []

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self.records.append(type(record).FromString(payload))
        print("wrote", topic)
        logging.getLogger("test.sink").warning("wrote %s", topic)

    def attach(self, asset: AssetFile) -> None:
        print("attached", asset.name)

    def flush(self) -> None: ...

    def close(self) -> None:
        print("closed")


def test_a_sink_that_prints_and_logs_has_no_echo_without_end(capsys: pytest.CaptureFixture[str]) -> None:
    sink = Talkative()
    log = Journal([sink])
    journal.open_journal(log)
    try:
        with recorded_output(log):
            for _ in range(10):
                log.append(Event(name="beep"))
            print("the plan")
    finally:
        journal.close_journal(log)
    assert sum(isinstance(record, Event) for record in sink.records) == 10
    assert "the plan" in [record.text for record in sink.records if isinstance(record, Output)]
    assert [record.seq for record in sink.records] == list(range(len(sink.records)))
    assert len(sink.records) < 50


class Alarming:
    """A sink during whose work a signal arrives, whose handler prints."""

    def __init__(self) -> None:
        self.records: list[Record] = []

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        if isinstance(record, Event):
            signal.raise_signal(signal.SIGUSR1)
        self.records.append(type(record).FromString(payload))

    def attach(self, asset: AssetFile) -> None:
        """Nothing."""

    def flush(self) -> None: ...

    def close(self) -> None:
        """Nothing."""


def test_what_a_signal_handler_prints_while_a_record_is_written_comes_after_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    sink = Alarming()
    log = Journal([sink])
    before = signal.signal(signal.SIGUSR1, lambda *_: print("alarm"))
    journal.open_journal(log)
    try:
        with recorded_output(log):
            log.append(Event(name="beep"))
    finally:
        journal.close_journal(log)
        signal.signal(signal.SIGUSR1, before)
    assert [(type(record), record.seq) for record in sink.records] == [(Event, 0), (Output, 1)]
    assert sink.records[1].text == "alarm"
    assert capsys.readouterr().out == "alarm\n"


def test_two_recordings_at_once_have_each_line_once(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other, without = tmp_path / "y.mcap", tmp_path / "z.mcap"
    with recorder.record(file, output=True), recorder.record(without), recorder.record(other, output=True):
        print("hello")
    assert capsys.readouterr().out == "hello\n"
    assert said(file) == said(other) == [("stdout", "hello")]
    assert said(without) == []


def test_log_and_tree_show_output_where_it_belongs(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(file, output=True), BulletWorld(name="lab"):
        Object("milk", "milk", "milk.stl")
        with span("motion", "outer"):
            print("begin")
            with span("process-module", "Inner"):
                logging.getLogger("plan").error("hot")
            print("end")
        for number in range(9):
            print(number)
    capsys.readouterr()
    assert main(["log", str(file), "--kind", "output", "--task", "outer"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [line.split("output")[1].strip() for line in shown] == [
        "stdout: begin",
        "plan ERROR: hot",
        "stdout: end",
    ]
    assert main(["tree", str(file)]) == 0
    tree = [line.partition("  [")[0].rstrip() for line in capsys.readouterr().out.splitlines()]
    assert tree == [
        "  + outer",
        "    stdout: begin",
        "    + Inner",
        "      plan ERROR: hot",
        "    stdout: end",
        "  stdout: 0",
        "  stdout: 1",
        "  ... 5 more lines",
        "  stdout: 7",
        "  stdout: 8",
    ]


def test_output_ends_before_the_run_does(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def fail() -> None:
        print("almost", end="")
        print(1 // 0)

    with pytest.raises(ZeroDivisionError), recorder.record(file, output=True):
        fail()
    with replay.open(file) as log:
        *_, last, end = log
        assert isinstance(last, Output)
        assert last.text == "almost"
        assert isinstance(end, Run)
        assert end.failure.type == "ZeroDivisionError"
