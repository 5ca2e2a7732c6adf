"""Recordings are translated into files for the viewer: errors are reported, and leave no files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.mcap_sink import McapSink
from recorder.records import TOPICS, Argument, Failure, Picture, Query, Task
from replay.cli.main import main
from replay.view import convert
from tests.recorder.viewer.shown import Shown

if TYPE_CHECKING:
    from recorder.records import Record

REPO = Path(__file__).parents[3]
GOLDEN = REPO / "tests" / "replay" / "golden" / "0.1.0.mcap"
# Presses Ctrl-C when the temporary folder has just been made, or when the first record comes.
VIEW = """
import signal, sys, tempfile
from recorder.viewer.translator import Translator
from replay.cli.main import main

def show(*_):
    signal.raise_signal(signal.SIGINT)

def make(*arguments, **named):
    folder = mkdtemp(*arguments, **named)
    if ".log.rrd." in folder:
        signal.raise_signal(signal.SIGINT)
    return folder

if sys.argv[3] == "folder":
    mkdtemp, tempfile.mkdtemp = tempfile.mkdtemp, make
else:
    Translator.show = show
sys.exit(main(["view", sys.argv[1], "--save", sys.argv[2]]))
"""


def write(log: Path, *records: Record) -> Path:
    sink = McapSink(log, {})
    for seq, record in enumerate(records):
        record.seq = seq
        sink.write(TOPICS[type(record)], record, record.SerializeToString())
    sink.close()
    return log


@pytest.mark.slow
def test_records_written_after_the_recording_was_opened_are_left_out(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    sink = McapSink(log, {})
    for seq in range(300):
        if seq == 200:
            opened = replay.open(log)
        sink.write("/query", record := Query(seq=seq, name="x", answer_json="1"), record.SerializeToString())
    sink.close()
    with opened:
        known = len(opened)
        convert([opened], tmp_path / "log.rrd")
    assert 100 < known < 300
    assert len(Shown(tmp_path / "log.rrd").rows["/records/query"]) == known


@pytest.mark.parametrize(
    "record",
    [
        Query(name="visible", answer_json="true", picture=Picture(width=1, height=1, pixels=b"no picture")),
        Task(phase=Task.FINISHED, status=Task.FAILED, failure=Failure(type="F", data=[Argument(name="x", json="{")])),
        Query(world="w", name="x", answer_json="1", evidence=[Argument(name="points", json="3")]),
    ],
    ids=["picture", "failure", "points"],
)
def test_nonsense_is_reported_with_its_step(tmp_path: Path, capsys: pytest.CaptureFixture[str], record: Record) -> None:
    log = write(tmp_path / "log.mcap", Query(name="x", answer_json="1"), record)
    assert main(["view", str(log), "--save", str(tmp_path / "log.rrd")]) == 3
    printed = capsys.readouterr()
    assert f"{log}: step 1 is damaged: the content is inconsistent: " in printed.err
    assert not printed.out
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]


def test_a_time_beyond_the_viewers_range_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write(tmp_path / "log.mcap", Query(world="w", name="x", answer_json="1", sim_step=2**62))
    assert main(["view", str(log), "--save", str(tmp_path / "log.rrd")]) == 3
    printed = capsys.readouterr()
    assert f"{log}: a record is damaged: the content is inconsistent: " in printed.err
    assert not printed.out
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]


@pytest.mark.parametrize("moment", ["folder", "record"])
def test_ctrl_c_leaves_no_file_behind(tmp_path: Path, moment: str) -> None:
    command = [sys.executable, "-c", VIEW, GOLDEN, tmp_path / "log.rrd", moment]
    ended = subprocess.run(command, cwd=REPO, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 130
    said = [line for line in ended.stderr.splitlines() if "re_sdk" not in line]  # a rare warning of the library's own
    assert (ended.stdout, said) == ("", [])
    assert not list(tmp_path.iterdir())
