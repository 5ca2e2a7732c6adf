"""A plan goes on from a step of its recording: as it did, as an edited plan has it, or after it was killed."""

from __future__ import annotations

import functools
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Mutation, Run
from replay.cli.main import main
from replay.compare import differing
from replay.errors import ReplayError
from replay.retrace.fork import NotForked, fork, resume
from replay.retrace.retrace import retrace
from tests.measures import seeded
from tests.replay.retrace.bits import assert_same_bits
from tests.replay.retrace.control_plans import PLANS
from tests.replay.retrace.test_retrace import record, text

if TYPE_CHECKING:
    from collections.abc import Callable

    from replay.retrace.fork import Fork


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("fork") / "plan.py"
    file.write_text(text())
    return record(file)


def forked(log: Path, step: int, file: Path, plan: Path | None = None) -> Fork:
    with replay.open(log) as recording:
        return fork(recording, step, file, plan=plan)


PARTS = 50  # of a plan's steps; a case has one part of each of two plans


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Gives the recording of a plan, which is made once."""
    folder = tmp_path_factory.mktemp("plans")

    @functools.cache
    def made(name: str) -> Path:
        file = folder / f"{name.replace(' ', '_')}.py"
        file.write_text(PLANS[name])
        return record(file)

    return made


@seeded("forks without a change, at every step of 21 plans", range(PARTS * len(PLANS)), 1)
def test_a_fork_without_a_change_goes_on_as_the_original(
    recorded: Callable[[str], Path], tmp_path: Path, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    forks = 0
    for seed in seeds:
        name = list(PLANS)[seed % len(PLANS)]
        log, file = recorded(name), tmp_path / "fork.mcap"
        with replay.open(log) as recording:
            steps, end = len(recording), recording[-1]
        for step in random.Random(name).sample(range(steps), steps)[seed // len(PLANS) :: PARTS]:
            result = forked(log, step, file)
            assert (result.step, result.records, result.succeeded) == (step, steps, end.succeeded), (name, step)
            assert_same_bits(log, file)
            forks += 1
    record_property("forks", forks)


@pytest.mark.costly
def test_an_edited_plan_goes_on_from_where_it_is_another(log: Path, tmp_path: Path) -> None:
    edited = tmp_path / "edited.py"
    edited.write_text(text().replace("level.set_value(5)", "level.set_value(7)"))
    with replay.open(log) as recording:
        last = next(each.seq for each in recording if getattr(each, "after_json", "") == "5") - 1
        began = recording[0].wall_time_ns
    file = tmp_path / "edited.mcap"
    assert forked(log, last, file, edited).succeeded
    with replay.open(log) as recording, replay.open(file) as other:
        assert all(not differing(recording[step], other[step]) for step in range(last + 1))
        assert other[last + 1].after_json == "7"
        start = other[0]
        assert isinstance(start, Run)
        assert (start.origin.recording, start.origin.step, start.origin.wall_time_ns) == (log.name, last, began)
    with pytest.raises(NotForked) as refused:
        forked(log, last + 1, tmp_path / "late.mcap", edited)
    assert refused.value.difference.step == last + 1
    assert refused.value.difference.line.endswith(f"edited.py:{1 + text().splitlines().index('level.set_value(5)')}")
    assert not (tmp_path / "late.mcap").exists()


def test_what_is_printed_before_the_fork_is_held_back(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "prints.py"
    file.write_text(
        "import sys\n"
        "from pycram.bullet_world import BulletWorld\n"
        "print('before')\n"
        "print('before', file=sys.stderr)\n"
        "world = BulletWorld()\n"
        "world.set_gravity([0, 0, -1])\n"
        "print('after')\n"
    )
    log = record(file)
    assert main(["fork", str(log), "--at", "4"]) == 0
    printed = capfd.readouterr()
    assert (
        printed.out == f"{log.with_suffix('.fork.mcap')}: 7 records, the first 5 equal to {log}; the plan succeeded\n"
    )
    assert "after\n" in printed.err
    assert "before\n" not in printed.err
    assert main(["info", str(log.with_suffix(".fork.mcap"))]) == 0
    assert f"forked from {log.name} after step 4" in capfd.readouterr().out


PROJECTS = """\
from pycram.bullet_world import BulletWorld, Object
from pycram.projection import project, project_all
world = BulletWorld()
milk = Object("milk", "milk", "milk.stl", [0, 0, 1])
def move(x):
    milk.set_position([x, 0, 1])
    if not x:
        raise RuntimeError("not there")
outcomes = [project(move, 1), *project_all([(move, 0), (move, 2), (move, 3)])]
assert all(outcome.recording.exists() for outcome in outcomes)
move(4)
"""


@pytest.mark.costly
def test_a_plan_that_projects_runs_again_and_its_fork_has_recordings_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "plan.py"
    file.write_text(PROJECTS)
    log = record(file)
    files = sorted(tmp_path.glob("*.mcap"))
    with replay.open(log) as recording:
        result = retrace(recording)
        last = len(recording) - 1
    assert result.identical
    assert result.equal == result.steps
    assert sorted(tmp_path.glob("*.mcap")) == files
    assert forked(log, last, tmp_path / "on.mcap").succeeded
    assert_same_bits(log, tmp_path / "on.mcap")
    assert len(list(tmp_path.glob("on.projection-*.mcap"))) >= 3


@pytest.mark.costly
def test_a_program_that_projects_runs_again(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    inside = "".join(f"    {line}\n" for line in PROJECTS.splitlines())
    file.write_text(f'import recorder\nwith recorder.record("run.mcap"):\n{inside}')
    subprocess.run([sys.executable, file], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    log = tmp_path / "run.mcap"
    assert forked(log, 4, tmp_path / "on.mcap").succeeded
    assert_same_bits(log, tmp_path / "on.mcap")


@pytest.mark.long
def test_of_a_program_that_records_twice_the_one_in_question_is_forked(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text(
        "import recorder\n"
        "from pycram.bullet_world import BulletWorld, Object\n"
        'for number, name in enumerate(["first", "second"]):\n'
        '    with recorder.record(f"{name}.mcap", name=name, overwrite=True):\n'
        "        with BulletWorld():\n"
        '            Object("milk", "milk", "milk.stl", [number, 0, 1])\n'
    )
    subprocess.run([sys.executable, file], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    (tmp_path / "fork").mkdir()
    before = {each: each.read_bytes() for each in tmp_path.glob("*.mcap")}
    for name in ("first", "second"):
        log = tmp_path / f"{name}.mcap"
        assert forked(log, 1, tmp_path / "fork" / f"{name}.mcap").succeeded
        assert_same_bits(log, tmp_path / "fork" / f"{name}.mcap")
        with replay.open(log) as recording:
            assert retrace(recording).identical
    assert {each: each.read_bytes() for each in tmp_path.glob("*.mcap")} == before


def test_secret_arguments_can_be_given_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plan.py"
    file.write_text("import sys\nassert sys.argv[1:] == ['--token', 'abc']\n")
    log = record(file, "--token", "abc")
    on = str(tmp_path / "on.mcap")
    assert main(["fork", str(log), "--at", "0", "-o", on]) == 2
    assert "give all arguments after --arguments" in capsys.readouterr().err
    assert main(["fork", str(log), "--at", "0", "-o", on, "--arguments", "--token", "abc"]) == 0


MOVES = """\
from pycram.bullet_world import BulletWorld, Object
with BulletWorld() as world:
    milk = Object("milk", "milk", "milk.stl", [1.0, 0, 1])
    milk.set_position([2.0, 0, 1])
"""


@pytest.mark.costly
def test_an_edited_plan_forks_where_it_first_differs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, edited, on = (tmp_path / name for name in ("plan.py", "edited.py", "on.mcap"))
    file.write_text(MOVES)
    log = record(file)
    edited.write_text(MOVES.replace("[2.0", "[3.0"))
    assert main(["fork", str(log), "--plan", str(edited), "-o", str(on)]) == 0
    with replay.open(log) as recording, replay.open(on) as forked:
        (moved,) = (record.seq for record in recording.records(Mutation) if record.HasField("move_body"))
        assert forked[0].origin.step == moved - 1
    capsys.readouterr()
    for options, why in ((["--plan", str(file)], "makes the same records"), ([], "--at STEP")):
        assert main(["fork", str(log), *options]) == 2
        assert why in capsys.readouterr().err


HANGS = """\
import os, signal
from pathlib import Path
from pycram.bullet_world import BulletWorld
world = BulletWorld()
if "HANGING" in os.environ:
    Path(os.environ["HANGING"]).write_text("here\\n")
    signal.pause()
"""


@pytest.mark.parametrize("edited", [False, True], ids=["both go on", "the control alone"])
def test_ctrl_c_ends_a_fork_and_its_control(tmp_path: Path, *, edited: bool) -> None:
    file, log, on, hanging = (tmp_path / name for name in ("plan.py", "plan.mcap", "on.mcap", "hanging"))
    file.write_text(HANGS)
    record(file)
    command = [sys.executable, "-m", "replay", "fork", log, "--at", "1", "-o", on, "--control"]
    if edited:
        (tmp_path / "edited.py").write_text(HANGS.replace("signal.pause()", ""))
        command += ["--plan", tmp_path / "edited.py"]
    os.mkfifo(hanging)
    alone = subprocess.Popen(  # so that Ctrl-C is for this process only
        command, env=os.environ | {"HANGING": str(hanging)}, start_new_session=True, stderr=subprocess.DEVNULL
    )
    with alone:
        try:
            with os.fdopen(os.open(hanging, os.O_RDWR)) as lines:
                assert [lines.readline() for _ in range(2)] == ["here\n"] * 2
            alone.send_signal(signal.SIGINT)
            assert alone.wait(timeout=60) == 130
        finally:
            alone.kill()
    with replay.open(log) as recording, replay.open(on) as other:
        assert other[0].origin.recording == log.name
        assert all(not differing(*pair) for pair in zip(list(recording)[1:], list(other)[1:-1], strict=False))


def test_a_folder_that_is_not_there_is_said_before_it_runs(tmp_path: Path) -> None:
    file = tmp_path / "plan.py"
    file.write_text("from pathlib import Path\nPath('ran').touch()\n")
    log = record(file)
    (tmp_path / "ran").unlink()
    with pytest.raises(ReplayError, match="make the folder first"):
        forked(log, 1, tmp_path / "nowhere" / "on.mcap")
    assert not (tmp_path / "ran").exists()


def test_a_fork_that_can_t_be_recorded_is_said_as_such(log: Path) -> None:
    file = Path("/proc/on.mcap")  # nobody can write there
    with pytest.raises(ReplayError, match=f"can't record to {file}"):
        forked(log, 1, file)


def test_a_run_that_has_ended_is_not_resumed(log: Path, tmp_path: Path) -> None:
    with replay.open(log) as recording, pytest.raises(ReplayError, match="this run has ended"):
        resume(recording, tmp_path / "on.mcap")
    assert not (tmp_path / "on.mcap").exists()


@dataclass(frozen=True)
class Undisturbed:
    """The demo, run to its end.

    Attributes:
        log: its recording.
        began: processor time that it had needed when its recording began, in s.
        ended: when it ended.
    """

    log: Path
    began: float
    ended: float


def demo(log: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "pycram", "demo", "--log", log, "--overwrite", "--seed", "5"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def processor_seconds(process: subprocess.Popen[bytes]) -> float:
    """What a process that runs, or that nobody has waited for, has needed so far."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def seconds_until(process: subprocess.Popen[bytes], happened: Callable[[], bool]) -> float:
    """Processor time that a process has needed when something happens, or when it ends, in s."""
    ended = False
    while not (ended or happened()):
        time.sleep(0.002)
        ended = os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    return processor_seconds(process)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    log = tmp_path_factory.mktemp("undisturbed") / "demo.mcap"
    with demo(log) as process:
        began = seconds_until(process, log.exists)
        ended = seconds_until(process, lambda: False)
    return Undisturbed(log, began, ended)


@pytest.mark.costly
@seeded("demos killed at any moment, resumed", range(50), 1)
def test_a_killed_demo_goes_on_and_ends_as_the_undisturbed_one(
    undisturbed: Undisturbed, tmp_path: Path, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    kept = 0
    for seed in seeds:
        log, dice = tmp_path / "demo.mcap", random.Random(seed)
        killed = False
        while not killed:  # it may need less time than the undisturbed one did, and end before
            with demo(log) as process:
                seconds_until(process, log.exists)
                moment = dice.uniform(undisturbed.began, undisturbed.ended)
                seconds_until(process, lambda process=process, at=moment: processor_seconds(process) >= at)
                process.kill()
            with replay.open(log) as recording:
                killed = not recording.closed
        with replay.open(log) as recording:
            result = resume(recording, tmp_path / "on.mcap")
        assert result.step < result.records - 1
        assert_same_bits(undisturbed.log, result.file)
        kept += result.step + 1
    record_property("records kept", kept)
