"""Reading: by step, by name, backwards, while it is written, after a kill, and where no physics engine is installed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from recorder.records import Event, MoveBody, Mutation, Task
from recorder.tracing import journal
from recorder.tracing.span import span
from replay.cli.main import VERBS, main

if TYPE_CHECKING:
    from pathlib import Path

WRITER = """
import os, sys
import recorder
from recorder.tracing import journal
from recorder.records import Event
with recorder.record(sys.argv[1]):
    print("open", flush=True)
    for line in sys.stdin:
        for number in range(int(line)):
            journal.emit(Event(name=f"tick{number}"))
        print("done", flush=True)
"""


@pytest.fixture
def writer(tmp_path: Path):
    """A process that writes as many records as it is told to."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path / "x.mcap")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "open\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()
    if not process.stdin.closed:
        process.stdin.close()


def write(writer: subprocess.Popen, count: int) -> None:
    writer.stdin.write(f"{count}\n")
    writer.stdin.flush()
    assert writer.stdout.readline() == "done\n"


def follow(file: Path, *more: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "replay", "log", str(file), "--follow", *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_follow_prints_new_records_until_the_recording_is_closed(writer: subprocess.Popen, tmp_path: Path) -> None:
    write(writer, 30)
    reader = follow(tmp_path / "x.mcap", "--json")
    seen = [json.loads(reader.stdout.readline())["step"] for _ in range(31)]
    write(writer, 200)
    seen += [json.loads(reader.stdout.readline())["step"] for _ in range(200)]
    writer.communicate()
    rest, said = reader.communicate(timeout=100)
    seen += [json.loads(line)["step"] for line in rest.splitlines()]
    assert seen == list(range(232))
    assert reader.returncode == 0, said


@pytest.mark.slow
def test_follow_ends_when_the_writer_is_killed(writer: subprocess.Popen, tmp_path: Path) -> None:
    write(writer, 60)
    reader = follow(tmp_path / "x.mcap")
    for _ in range(51):  # what is in a closed chunk is there
        reader.stdout.readline()
    writer.kill()
    _, said = reader.communicate(timeout=100)
    assert reader.returncode == 3
    assert "ended without closing it" in said
    assert "killed" in said


@pytest.mark.slow
def test_a_live_and_a_cut_recording_report_it(writer: subprocess.Popen, tmp_path: Path) -> None:
    write(writer, 120)
    with replay.open(tmp_path / "x.mcap") as log:
        assert log.live
        assert "still being written" in log.problems
        before = len(log)
        write(writer, 100)
        assert log.refresh()
        assert len(log) >= before + 50
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        assert not log.live
        assert "killed" in log.problems
        log.refresh()
        assert [record.seq for record in log] == list(range(len(log)))


def test_backwards_is_the_reverse_of_forwards(small_log: Path) -> None:
    with replay.open(small_log) as log:
        forwards = [record.SerializeToString() for record in log]
        assert [record.SerializeToString() for record in log.backwards()] == forwards[::-1]
        assert [record.seq for record in log.backwards(50, Task)] == [
            record.seq for record in reversed(list(log.records(Task, 0, 51)))
        ]
        assert [log[step].seq for step in range(-len(log), 0)] == list(range(len(log)))


def run_tasks(file: Path) -> None:
    with recorder.record(file):
        with span("motion", "pick-up"), span("process-module", "PickUp"):
            journal.emit(Event(name="in the first"))
        with span("block", "par"), span("motion", "pick-up"):
            journal.emit(Event(name="in the second"))
        with pytest.raises(KeyError), span("motion", "place"):
            raise KeyError("no")
        for number in range(4):
            journal.emit(Mutation(move_body=MoveBody(body="cup")), world="w", sim_step=number * 120)


def test_steps_by_name(tmp_path: Path) -> None:
    run_tasks(tmp_path / "x.mcap")
    with replay.open(tmp_path / "x.mcap") as log:
        first, module, module_end, first_end, block, second, second_end, *_ = (task.seq for task in log.records(Task))
        assert (log.step("task:pick-up@start"), log.step("task:pick-up@end")) == (first, first_end)
        assert log.step("task:PickUp@start") == module
        assert log.step("task:pick-up/PickUp@end") == module_end
        assert log.step("task:par@start") == block
        assert log.step("task:pick-up#2@start") == log.step("task:par/pick-up@start") == second
        assert log.step("task:pick-up#-1@end") == log.step("task:par/pick-up@end") == second_end
        assert log.step(f"task:{log[second].task}@start") == second
        assert log.step("failure") == log.step("task:place@end")
        assert log.step("last") == log.step(-1) == len(log) - 1
        assert log.step("-10") == len(log) - 10
        assert [record.sim_step for record in log.records(Mutation)] == [0, 120, 240, 360]
        assert log[log.step("0.5s")].sim_step == log[log.step("0.9s")].sim_step == 120
        assert log[log.step("1s")].sim_step == 240


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("task:pick-it@end", "did you mean pick-up"),
        ("task:pick-up#9@start", "2 tasks match"),
        ("task:pick-up", "task:PATH@start"),
        ("10000", "steps 0 to"),
        ("-10000", "steps 0 to"),
        ("2h", "a step is"),
        ("99s", "ends at"),
        ("-1s", "starts at"),
        ("nans", "a step is"),
        ("infs", "a step is"),
        ("", "a step is"),
    ],
)
def test_an_unknown_step_gives_a_hint(tmp_path: Path, name: str, hint: str) -> None:
    run_tasks(tmp_path / "x.mcap")
    with replay.open(tmp_path / "x.mcap") as log, pytest.raises(replay.NoSuchStep, match=hint):
        log.step(name)


def test_a_time_before_the_beginning_is_no_option(small_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["state", str(small_log), "-1.5s"]) == 2
    assert "there is no step -1.5s: simulated time starts at 0 s" in capsys.readouterr().err


WITHOUT_LIBRARIES = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in sys.argv[2].split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
from replay.cli.main import main
for verb in sys.argv[3:]:
    name, *rest = verb.split()
    print(verb, main([name, sys.argv[1], *rest]), file=sys.stderr)
"""


ENGINE_AND_VIEWER = "pybullet,pybullet_data,scipy,rerun,pyarrow"


def exit_codes_without(libraries: str, log: Path, *verbs: str) -> list[str]:
    command = [sys.executable, "-c", WITHOUT_LIBRARIES, str(log), libraries, *verbs]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    return [line.split()[-1] for line in ended.stderr.splitlines()]


@pytest.mark.slow
def test_reading_verbs_work_without_engine_viewer_and_meshes(small_log: Path) -> None:
    verbs = ["info", "log", "tree", "show 9", "state last", "diff 9 last", "blame milk", "why"]
    assert exit_codes_without(f"{ENGINE_AND_VIEWER},pycram,trimesh,collada,PIL", small_log, *verbs) == ["0"] * 8


@pytest.mark.slow
def test_most_verbs_need_no_numpy_which_takes_longer_to_load_than_they_do(small_log: Path) -> None:
    verbs = ["info", "log", "show 9", "state last", "blame milk"]
    assert exit_codes_without("numpy", small_log, *verbs) == ["0"] * 5


@pytest.mark.slow
def test_pictures_are_drawn_without_engine_and_viewer(small_log: Path, tmp_path: Path) -> None:
    verbs = [f"render 9 -o {tmp_path}/x.png", f"why --pictures {tmp_path}"]
    assert exit_codes_without(ENGINE_AND_VIEWER, small_log, *verbs) == ["0"] * 2
    assert {file.name for file in tmp_path.iterdir()} >= {"x.png", "step_144_side.png"}


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["log", "why"])
def test_a_closed_pipe_is_no_error(small_log: Path, verb: str) -> None:
    reader, pipe = os.pipe()
    os.close(reader)
    with os.fdopen(pipe, "wb") as closed:
        ended = subprocess.run(
            [sys.executable, "-m", "replay", verb, str(small_log)], stdout=closed, stderr=subprocess.PIPE, check=False
        )
    assert (ended.returncode, ended.stderr) == (0, b"")


@pytest.mark.parametrize(
    "verb", ["info", "tree", "show 9", "state last", "diff 9 last", "blame milk", "why", "blame milk --at 5"]
)
def test_json_is_one_document(small_log: Path, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    name, *rest = verb.split()
    assert main([name, str(small_log), *rest, "--json"]) == 0
    output = capsys.readouterr()
    json.loads(output.out)
    assert not output.err


@pytest.mark.parametrize(
    "wrong",
    [
        "",
        "dance x",
        "show {log}",
        "show {log} nowhere",
        "state {log} last nobody",
        "diff {log} 1",
        "blame {log} milk.lid",
    ],
)
def test_wrong_usage_exits_with_2_and_an_explanation(
    small_log: Path, capsys: pytest.CaptureFixture[str], wrong: str
) -> None:
    assert main(wrong.format(log=small_log).split()) == 2
    output = capsys.readouterr()
    assert not output.out
    assert "Traceback" not in output.err
    assert len(output.err) > 20


def test_every_verb_has_help(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in VERBS:
        assert main([verb, "--help"]) == 0
        assert "LOG" in capsys.readouterr().out


def test_reading_a_closed_recording_is_not_reported_as_damage(small_log: Path) -> None:
    with replay.open(small_log) as log:
        late = log.records()
    for read in (
        lambda: next(late),
        lambda: log[5],
        lambda: log.state_at(5),
        lambda: log.assets[next(iter(log.assets))],
    ):
        with pytest.raises(replay.LogClosed, match="open it again"):
            read()
    assert log.complete
    assert repr(log) == f"<Recording {small_log}: closed>"


EACH_VERB = """
import sys
from replay.cli.main import main
for verb, *rest in (["info"], ["log"], ["state", "last"], ["why"], ["show", "3"]):
    for more in ([], ["--json"]):
        assert main([verb, sys.argv[1], *rest, *more]) == 0, verb
"""


@pytest.mark.slow
def test_names_with_characters_that_a_terminal_lacks(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "x.mcap"), span("motion", "hole Löffel 🥄"):
        journal.emit(Mutation(move_body=MoveBody(body="Löffel 🥄")), world="Küche")
    ended = subprocess.run(
        [sys.executable, "-c", EACH_VERB, str(tmp_path / "x.mcap")],
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, b"")
    lines = ended.stdout.decode("ascii").splitlines()
    data = [json.loads(line) for line in lines if line.startswith("{")]
    assert any("L\\xf6ffel" in line for line in lines)
    assert any("Löffel 🥄" in str(facts) for facts in data)
