"""Long recordings are translated by two processes: what comes of it, and of the other process, whatever happens."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

import replay
from recorder.mcap.sink import McapSink
from recorder.records import TOPICS, Argument, Picture, Query
from replay.cli.main import main
from replay.errors import ReplayError
from replay.view import translation, worker
from replay.view.rrd import convert
from tests.viewer.shown import Shown, in_front, looked_for, small

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import rerun as rr

    from recorder.records import Record
    from tests.viewer.conftest import Headless

REPO = Path(__file__).parent.parent.parent
GOLDEN = REPO / "tests" / "replay" / "golden" / "0.1.0.mcap"
PROGRAM = """
import sys
from replay import translation
from replay.cli.main import main
translation._LONG = 0
sys.exit(main(["view", sys.argv[1], "--save", sys.argv[2]]))
"""


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any recording is long, and there is more than one core."""
    monkeypatch.setattr(translation, "_LONG", 0)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)


@pytest.fixture
def converting(tmp_path: Path, until: Callable[..., None]) -> Iterator[subprocess.Popen[str]]:
    """A process that translates, with the other one begun."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, GOLDEN, tmp_path / "log.rrd"],
        env=os.environ | {"PYTHONPATH": str(REPO)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        until(lambda: tellers(tmp_path), "the other process begins")
        yield process
    finally:
        process.kill()
        process.communicate()


def tellers(folder: Path) -> list[str]:
    """Command lines of the processes that write into a folder below this one."""
    lines = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            line = (process / "cmdline").read_text(errors="replace")
        except OSError:  # it has ended meanwhile
            continue
        if f"{folder}/.told." in line:
            lines.append(line)
    return lines


def entities(file: Path) -> Iterator[str]:
    """The entity of each row that holds at all times."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RerunWarning)
        for chunk in RrdReader(file).stream():
            if chunk.is_static:
                yield from [chunk.entity_path] * chunk.num_rows


def write(log: Path, *records: Record) -> Path:
    sink = McapSink(log, {})
    for seq, record in enumerate(records):
        record.seq = seq
        sink.write(TOPICS[type(record)], record, record.SerializeToString())
    sink.close()
    return log


@pytest.mark.slow
def test_two_processes_show_what_one_shows(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    logs = [GOLDEN, small(tmp_path / "small.mcap")]
    with replay.open(logs[0]) as first, replay.open(logs[1]) as second:
        convert([first], tmp_path / "one.rrd")
        convert([first, second], tmp_path / "one_beside.rrd")
        request.getfixturevalue("two")
        convert([first], tmp_path / "two.rrd")
        convert([first, second], tmp_path / "two_beside.rrd")
    for name in ("", "_beside"):
        one, both = tmp_path / f"one{name}.rrd", tmp_path / f"two{name}.rrd"
        shown, together = Shown(one), Shown(both)
        for file in (shown, together):
            del file.fixed["/__properties"]["RecordingInfo:start_time"]  # when it was translated
        assert len(shown.rows) > 30
        assert Counter(entities(one)) == Counter(entities(both))
        assert shown.rows == together.rows
        assert shown.fixed == together.fixed
        assert looked_for(one) == looked_for(both)
        assert in_front(one) == in_front(both)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.slow
@pytest.mark.usefixtures("two")
def test_the_viewer_opens_what_two_processes_have_made(
    tmp_path: Path, headless: Headless, until: Callable[..., None]
) -> None:
    with replay.open(GOLDEN) as log:
        convert([log], tmp_path / "log.rrd")
        headless.open(tmp_path / "log.rrd")
        until(lambda: headless.end_of("step") == len(log) - 1, "the viewer has all of it")
    until(lambda: not headless.complaints(), "nothing is missed in it")  # as it is while it is being loaded


@pytest.mark.slow
@pytest.mark.usefixtures("two")
def test_what_was_written_since_the_recording_was_opened_is_in_neither_half(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    sink = McapSink(log, {})
    for seq in range(300):
        if seq == 200:
            half = replay.open(log)
        sink.write("/query", record := Query(seq=seq, name="x", answer_json="1"), record.SerializeToString())
    sink.close()
    with half:
        known = len(half)
        convert([half], tmp_path / "log.rrd")
    assert 100 < known < 300
    assert len(Shown(tmp_path / "log.rrd").rows["/records/query"]) == known


@pytest.mark.slow
@pytest.mark.usefixtures("two")
@pytest.mark.parametrize(
    "record",
    [
        Query(name="visible", answer_json="true", picture=Picture(width=1, height=1, pixels=b"no picture")),
        Query(world="w", name="x", answer_json="1", evidence=[Argument(name="points", json="3")]),
    ],
    ids=["of what is told", "of what is seen"],
)
def test_nonsense_is_told_with_its_step(tmp_path: Path, capsys: pytest.CaptureFixture[str], record: Record) -> None:
    log = write(tmp_path / "log.mcap", Query(name="x", answer_json="1"), record)
    assert main(["view", str(log), "--save", str(tmp_path / "log.rrd")]) == 3
    told = capsys.readouterr()
    assert f"{log}: step 1 is damaged: it makes no sense: " in told.err
    assert not told.out
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]
    assert not tellers(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("processes", ["one", "two"])
def test_a_time_that_is_longer_than_any_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest, processes: str
) -> None:
    if processes == "two":
        request.getfixturevalue("two")
    log = write(tmp_path / "log.mcap", Query(world="w", name="x", answer_json="1", sim_step=2**62))
    assert main(["view", str(log), "--save", str(tmp_path / "log.rrd")]) == 3
    told = capsys.readouterr()
    assert f"{log}: a record is damaged: it makes no sense: " in told.err
    assert not told.out
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]


@pytest.mark.slow
@pytest.mark.usefixtures("two")
def test_one_process_does_it_all_where_it_cannot_begin_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    log = small(tmp_path / "log.mcap")
    with replay.open(log) as recording:
        convert([recording], tmp_path / "log.rrd")
    assert {"/log/mutation", "/w/bodies/cup"} <= Shown(tmp_path / "log.rrd").rows.keys()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mcap", "log.rrd"]


@pytest.mark.usefixtures("two")
def test_a_process_that_was_killed_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker, "_CODE", "import os; os.kill(os.getpid(), 9)")
    log = small(tmp_path / "log.mcap")
    with replay.open(log) as recording, pytest.raises(ReplayError, match=r"log.mcap: .* was ended \(status -9\)"):
        convert([recording], tmp_path / "log.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]


@pytest.mark.slow
@pytest.mark.usefixtures("two")
def test_a_recording_that_has_gone_is_told(tmp_path: Path) -> None:
    log = small(tmp_path / "log.mcap")
    with replay.open(log) as recording:
        log.unlink()
        with pytest.raises(ReplayError, match=r"log.mcap: .*No such file"):
            convert([recording], tmp_path / "log.rrd")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.usefixtures("two")
def test_a_recording_that_was_replaced_is_not_mixed_with_the_other_one(tmp_path: Path) -> None:
    log, other = small(tmp_path / "log.mcap"), small(tmp_path / "other.mcap")
    with replay.open(log) as recording:
        other.replace(log)
        with pytest.raises(ReplayError, match=r"log.mcap: another file stands there"):
            convert([recording], tmp_path / "log.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]


@pytest.mark.slow
@pytest.mark.usefixtures("two")
def test_a_file_that_has_gone_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Robbed(worker.Worker):
        def hand_over(self, stream: rr.RecordingStream) -> None:
            self._process.wait()
            self._file.unlink()
            super().hand_over(stream)

    monkeypatch.setattr(translation, "Worker", Robbed)
    log = small(tmp_path / "log.mcap")
    with replay.open(log) as recording, pytest.raises(ReplayError, match=r"log.rrd: can't be written: .*not found"):
        convert([recording], tmp_path / "log.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]


@pytest.mark.slow
@pytest.mark.parametrize("found", [str(REPO), ""], ids=["by its name", "in the folder that one works in"])
def test_both_are_of_the_same_software(tmp_path: Path, found: str) -> None:
    (tmp_path / "replay").mkdir()
    (tmp_path / "replay" / "__init__.py").write_text("raise ImportError('another release')")
    log = small(tmp_path / "log.mcap")
    command = [sys.executable, "-c", f"import sys; sys.path[0] = {found!r}{PROGRAM}", log, tmp_path / "log.rrd"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    ended = subprocess.run(command, cwd=REPO, env=environment, capture_output=True, text=True, check=False)
    assert not ended.stderr
    assert ended.returncode == 0


@pytest.mark.slow
def test_a_disk_that_is_full_is_told(tmp_path: Path) -> None:
    limit = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
"""
    file = tmp_path / "log.rrd"
    command = [sys.executable, "-c", limit + PROGRAM, GOLDEN, file]
    ended = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": str(REPO)}, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2
    assert f"{file}: can't be written" in ended.stderr
    assert not ended.stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_ctrl_c_ends_both_and_leaves_nothing(tmp_path: Path, converting: subprocess.Popen[str]) -> None:
    os.killpg(converting.pid, signal.SIGINT)
    out, err = converting.communicate(timeout=60)
    assert converting.returncode == 130
    assert (out, err) == ("", "")
    assert not tellers(tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_one_that_is_killed_takes_the_other_and_its_file_along(
    tmp_path: Path, converting: subprocess.Popen[str], until: Callable[..., None]
) -> None:
    converting.kill()
    converting.communicate(timeout=60)
    until(lambda: not tellers(tmp_path), "the other process ends")
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".told.")]
