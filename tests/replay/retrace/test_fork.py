"""A plan goes on from a step of its recording: as it did, as an edited plan has it, or after it was killed."""

from __future__ import annotations

import random
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Run
from replay.cli.main import main
from replay.errors import ReplayError
from replay.explain.compare_runs import differing
from replay.restore.verify import verify
from replay.retrace.fork import NotForked, fork, resume
from replay.retrace.retrace import retrace
from tests.measures import seeded
from tests.replay.retrace.test_retrace import record, text

if TYPE_CHECKING:
    from pathlib import Path

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


def assert_same(first: Path, second: Path) -> None:
    """Both have the same records in the same order, and the second can be executed again."""
    with replay.open(first) as one, replay.open(second) as other:
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert not differing(a, b), f"step {a.seq}"
        assert verify(other).exact


@seeded("forks without a change, at each step", range(60), 2)
def test_a_fork_without_a_change_goes_on_as_the_original(log: Path, tmp_path: Path, seeds: range) -> None:
    with replay.open(log) as recording:
        steps = len(recording)
    for step in (seed * 7 % steps for seed in seeds):
        file = tmp_path / f"{step}.mcap"
        result = forked(log, step, file)
        assert (result.step, result.records, result.succeeded) == (step, steps, True)
        assert_same(log, file)


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
    assert printed.out == f"{log.with_suffix('.fork.mcap')}: 7 records, the first 5 as in {log}; the plan succeeded\n"
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
    assert_same(log, tmp_path / "on.mcap")
    assert len(list(tmp_path.glob("on.projection-*.mcap"))) >= 3


def test_a_program_that_projects_runs_again(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    inside = "".join(f"    {line}\n" for line in PROJECTS.splitlines())
    file.write_text(f'import recorder\nwith recorder.record("run.mcap"):\n{inside}')
    subprocess.run([sys.executable, file], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    log = tmp_path / "run.mcap"
    assert forked(log, 4, tmp_path / "on.mcap").succeeded
    assert_same(log, tmp_path / "on.mcap")


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
        assert_same(log, tmp_path / "fork" / f"{name}.mcap")
        with replay.open(log) as recording:
            assert retrace(recording).identical
    assert {each: each.read_bytes() for each in tmp_path.glob("*.mcap")} == before


def test_secret_arguments_can_be_given_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plan.py"
    file.write_text("import sys\nassert sys.argv[1:] == ['--token', 'abc']\n")
    log = record(file, "--token", "abc")
    on = str(tmp_path / "on.mcap")
    assert main(["fork", str(log), "--at", "0", "-o", on]) == 2
    assert "give all with --arguments, last" in capsys.readouterr().err
    assert main(["fork", str(log), "--at", "0", "-o", on, "--arguments", "--token", "abc"]) == 0


def test_a_folder_that_is_not_there_is_said_before_it_runs(tmp_path: Path) -> None:
    file = tmp_path / "plan.py"
    file.write_text("from pathlib import Path\nPath('ran').touch()\n")
    log = record(file)
    (tmp_path / "ran").unlink()
    with pytest.raises(ReplayError, match="make the folder first"):
        forked(log, 1, tmp_path / "nowhere" / "on.mcap")
    assert not (tmp_path / "ran").exists()


def test_a_run_that_has_ended_is_not_resumed(log: Path, tmp_path: Path) -> None:
    with replay.open(log) as recording, pytest.raises(ReplayError, match="has come to its end"):
        resume(recording, tmp_path / "on.mcap")
    assert not (tmp_path / "on.mcap").exists()


@seeded("killed runs, resumed", range(50), 1)
def test_a_killed_plan_goes_on_and_ends_as_the_undisturbed_one(tmp_path: Path, seeds: range) -> None:
    file, order = tmp_path / "plan.py", tmp_path / "kill_at"
    loop = (
        "import os\n"
        "for height in range(60):\n"
        "    milk.set_position([0, random.random(), height / 100])\n"
        "    world.simulate(0.02)\n"
        "    if os.path.exists('kill_at') and int(open('kill_at').read()) == height:\n"
        "        os.unlink('kill_at')\n"
        "        os.kill(os.getpid(), 9)\n"
    )
    file.write_text(text().replace("cup.remove()", f"{loop}cup.remove()"))
    whole = record(file).rename(tmp_path / "whole.mcap")
    for seed in seeds:
        order.write_text(str(random.Random(seed).randrange(60)))
        with replay.open(record(file)) as recording:
            killed_at = len(recording)
            result = resume(recording, tmp_path / f"{seed}.mcap")
        assert result.step == killed_at - 1 < result.records - 2
        assert_same(whole, result.file)
