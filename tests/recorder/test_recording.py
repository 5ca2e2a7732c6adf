"""``recorder.record``: the recorded worlds and tasks, and the files that it refuses to write."""

from __future__ import annotations

import subprocess
import sys
import threading
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder import RecordingError
from recorder.records import Event, Keyframe, Mutation, Run, Task
from recorder.tracing import journal
from recorder.tracing.span import span

if TYPE_CHECKING:
    from pathlib import Path


def run_tasks() -> None:
    with span("plan", "outer"), span("motion", "inner", {"target": [1, 2, 3]}):
        raise KeyError("gone")


def test_nested_tasks_and_their_failure_are_recorded_and_the_error_is_raised(tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with pytest.raises(KeyError, match="gone"), recorder.record(file, name="broken"):
        run_tasks()
    with replay.open(file) as log:
        assert log.complete
        outer, inner, inner_end, outer_end = log.records(Task)
        assert (outer.parent, inner.parent) == (0, outer.task)
        assert inner_end.failure.type == outer_end.failure.type == "KeyError"
        assert "run_tasks" in inner_end.failure.traceback
        assert outer.source_file.endswith("test_recording.py")
        end = log[-1]
        assert isinstance(end, Run)
        assert not end.succeeded


@pytest.mark.slow
def test_a_world_that_exists_already_begins_with_its_keyframe(tmp_path: Path) -> None:
    """Another thread changes the world while the recording begins: changes before the keyframe are part of it."""
    file = tmp_path / "x.mcap"
    with BulletWorld() as world, BulletWorld():
        cup = Object("cup", "cup", "cup.stl", world=world)
        stop, changed = threading.Event(), threading.Semaphore(0)

        def change() -> None:
            count = 0
            while not stop.is_set():
                count += 1
                cup.set_position([count, 0, 1])
                changed.release()

        thread = threading.Thread(target=change)
        thread.start()
        try:
            for _ in range(10):
                with recorder.record(file, overwrite=True):
                    while changed.acquire(blocking=False):
                        pass
                    for _ in range(20):
                        changed.acquire()
                with replay.open(file) as log:
                    kinds = [type(record) for record in log if record.world == world.name]
                    assert kinds[0] is Keyframe
                    assert kinds.count(Mutation) >= 10
                    assert [record.seq for record in log] == list(range(len(log)))
        finally:
            stop.set()
            thread.join()


def test_a_disk_that_is_full_from_the_start_is_an_error_before_the_block_runs(tmp_path: Path) -> None:
    full = tmp_path / "full.mcap"
    full.symlink_to("/dev/full")
    ran = []
    with pytest.raises(recorder.RecordingError, match="No space left"), recorder.record(full):
        ran.append(True)
    assert not ran


def test_only_finished_recordings_are_overwritten_and_only_on_request(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    precious = tmp_path / "thesis.txt"
    precious.write_text("years of work")
    with pytest.raises(recorder.RecordingError, match="isn't a recording"), recorder.record(precious):
        pass
    assert precious.read_text() == "years of work"
    file = tmp_path / "x.mcap"
    with recorder.record(file):
        with pytest.raises(recorder.RecordingError, match="another recording"), recorder.record(file, overwrite=True):
            pass
        with recorder.record(tmp_path / "y.mcap") as second:
            journal.emit(Event(name="both"))
        assert second.length == 3
    for number in (2, 3):
        with recorder.record(file) as recording, BulletWorld():
            assert recording.path == tmp_path / f"x.{number}.mcap"
        assert f"x.mcap exists already; recording to {recording.path}" in capsys.readouterr().err
    (tmp_path / "x.2.mcap").unlink()  # the highest number is the latest run, whatever is deleted
    with recorder.record(file) as recording:
        assert recording.path == tmp_path / "x.4.mcap"
    with recorder.record(file, overwrite=True) as recording, BulletWorld():
        assert recording.path == file
    assert "is there already" not in capsys.readouterr().err.partition("x.4.mcap")[2]
    with replay.open(file) as log:
        assert log.complete
        assert log.state_at("last").worlds


@pytest.mark.parametrize("where", ["nowhere/x.mcap", "."])
def test_a_path_that_can_t_be_written_is_an_error_before_the_block_runs(tmp_path: Path, where: str) -> None:
    ran = []
    with pytest.raises(recorder.RecordingError, match="can't record"), recorder.record(tmp_path / where):
        ran.append(True)
    assert not ran


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": None}, "isn't the path"),
        ({"path": "a\0b"}, "isn't the path"),
        ({"name": 5}, "name is 5"),
        ({"live": 5}, "live is 5"),
        ({"source": "nowhere.py"}, "no source"),
    ],
)
def test_invalid_arguments_are_refused(tmp_path: Path, arguments: dict[str, object], message: str) -> None:
    file = tmp_path / "x.mcap"
    with pytest.raises(RecordingError, match=message), recorder.record(**{"path": file, **arguments}):
        pass
    assert not file.exists()


def test_start_and_stop_record_what_happens_between_them(tmp_path: Path) -> None:
    """Cells of a notebook: a second start stops the first recording, a second stop finds none."""
    first = recorder.start(tmp_path / "x.mcap", name="cells")
    with BulletWorld():
        second = recorder.start(tmp_path / "y.mcap", seed=5)
        Object("cup", "cup", "cup.stl").set_position([1, 2, 3])
        assert recorder.stop() is second
        Object("bowl", "bowl", "bowl.stl")
    assert recorder.stop() is None
    with replay.open(first.path) as log:
        assert log.complete
        assert log[-1].succeeded
        assert log[0].name == "cells"
        assert "cup" not in log.state_at("last").world().bodies
    with replay.open(second.path) as log:
        assert log.complete
        assert log[0].seed == "5"
        assert list(log.state_at("last").world().bodies) == ["cup"]


def test_what_was_started_is_complete_at_the_end_of_the_process(tmp_path: Path) -> None:
    program = (
        "import recorder; from pycram.bullet_world import BulletWorld; recorder.start('x.mcap'); w = BulletWorld()"
    )
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.complete
