"""The journal numbers records in order, without a gap, with any threads and clocks."""

from __future__ import annotations

import contextvars
import threading
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from recorder.records import Event, Task
from recorder.tracing import journal
from recorder.tracing.span import span

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.records import Record
    from recorder.records.values import AssetFile


@pytest.mark.slow
def test_records_of_eight_threads_have_no_gap_and_keep_each_thread_s_order(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"

    def work(number: int) -> None:
        for count in range(500):
            journal.emit(Event(name="tick", sender=f"{number}/{count}"))

    with recorder.record(file):
        threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    with replay.open(file) as log:
        assert [record.seq for record in log] == list(range(4002))
        for number in range(8):
            mine = [r.sender for r in log.records(Event) if r.sender.startswith(f"{number}/")]
            assert mine == [f"{number}/{count}" for count in range(500)]


class Times:
    def __init__(self) -> None:
        self.times: list[int] = []

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        self.times.append(record.wall_time_ns)

    def attach(self, asset: AssetFile) -> None:
        pass

    def flush(self) -> None: ...

    def close(self) -> None:
        pass


def test_log_time_never_decreases_even_if_the_clock_does() -> None:
    clock = iter([50, 40, 60, 10])
    sink = Times()
    log = journal.Journal([sink], clock_ns=lambda: next(clock))
    for _ in range(4):
        log.append(Event(name="tick"))
    assert sink.times == [50, 50, 60, 60]


def test_a_thread_that_runs_in_a_copied_context_has_its_creator_s_task_as_parent(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"

    def work() -> None:
        with span("motion", "inner"):
            journal.emit(Event(name="inside"))

    with recorder.record(file), span("plan", "outer"):
        thread = threading.Thread(target=contextvars.copy_context().run, args=(work,))
        thread.start()
        thread.join()
    with replay.open(file) as log:
        outer, inner, *_ = log.records(Task)
        (event,) = log.records(Event)
        assert (inner.parent, event.task) == (outer.task, inner.task)
        assert inner.thread != outer.thread
