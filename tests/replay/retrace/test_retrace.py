"""A recorded plan runs again beside its recording: it does the same, or the first difference is named, and its line."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Fluent, Mutation, Task
from replay.cli.main import main
from replay.errors import Damaged
from replay.retrace.fork import fork
from replay.retrace.plan_process import CantRetrace, FirstDifference
from replay.retrace.retrace import likely_reasons, reads_before, retrace
from tests.measures import seeded
from tests.replay.copies import CHUNK, container_records, zeroed
from tests.replay.restore.test_verify import rewritten

if TYPE_CHECKING:
    from collections.abc import Callable

    from recorder.records import Record
    from replay.retrace.retrace import Retracing

pytestmark = pytest.mark.slow

REPO = Path(__file__).parents[3]
#: A line of a plan, and what somebody has made of it: none, so that it is left out, or others.
LINES: tuple[tuple[str, ...], ...] = (
    ("world = BulletWorld()", "world = BulletWorld(name='other')"),
    ("world.set_gravity([0, 0, -9.8])", "world.set_gravity([0, 0, -9])", ""),
    ('floor = Object("floor", "environment", "plane.urdf")', 'floor = Object("ground", "environment", "plane.urdf")'),
    (
        'milk = Object("milk", "milk", "milk.stl", [0, 0, 0.2])',
        'milk = Object("milk", "drink", "milk.stl", [0, 0, 0.2])',
        'milk = Object("milk", "milk", "milk.stl", [0, 0, 0.2000001])',
        'milk = Object("milk", "milk", "milk.stl", [0, 0, 0.2], color=[1, 0, 0, 1])',
    ),
    (
        'cup = Object("cup", "cup", "cup.stl", [1, 0, 0.1])',
        'cup = Object("cup", "cup", "bowl.stl", [1, 0, 0.1])',
        'cup = Object("cup", "cup", "cup.stl", [1, 0, 0.1], [0, 0, 1, 0])',
    ),
    ("world.simulate(0.1)", "world.simulate(0.2)", "pass", "world.settle()"),
    ('pressed = Event("pressed")', 'pressed = Event("released")'),
    ("pressed += lambda: milk.set_position([1, 1, 1])", "pressed += lambda: milk.set_position([1, 1, 2])", "pass"),
    ("pressed()", "pass", "pressed(); pressed()"),
    ('level = Fluent(1, name="level")', 'level = Fluent(2, name="level")', 'level = Fluent(1, name="height")'),
    ("level.set_value(5)", "level.set_value(6)", "level.pulse()", "pass"),
    ("print(btr.contact(milk, cup))", "print(btr.contact(milk, floor))", "print(btr.supporting(milk, cup))", "pass"),
    ("milk.attach(cup)", "cup.attach(milk)", "pass"),
    ("milk.set_position([0, 1, 1])", "cup.set_position([0, 1, 1])", "milk.set_position([0, 1, 1.1])"),
    ("milk.detach(cup)", "milk.set_color([0, 0, 1, 1])"),
    ("par(one, two)", "par(two, one)", "par(one)", "seq(one, two)"),
    ("fails(3)", "fails(2)", "pass"),
    ("cup.set_position([random.random(), 0, 1])", "random.random(); cup.set_position([random.random(), 0, 1])"),
    ("cup.remove()", "milk.remove()", "pass"),
    ("sys.exit(0)", "sys.exit(1)", "world.exit()", "raise ValueError(level)"),
)
HEAD = """\
import random
import sys
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.event import Event
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.language import failure_handling, par, seq
def one(): milk.set_color([1, 0, 0, 1])
def two(): cup.set_color([1, 0, 0, 1])
def fails(times):
    for attempt in failure_handling(3):
        with attempt:
            if attempt.number <= times:
                raise PlanFailure("not yet")
"""
CHANGES = [(number, change) for number, (_, *changes) in enumerate(LINES) for change in changes]


def text(changed: int = -1, change: str = "") -> str:
    lines = [change if number == changed else line for number, (line, *_) in enumerate(LINES)]
    return HEAD + "\n".join(lines) + "\n"


def record(file: Path, *arguments: str, seed: int = 5) -> Path:
    """Records a plan, by the command."""
    log = file.with_suffix(".mcap")
    command = [sys.executable, "-m", "pycram", "run", file, "--log", log, "--overwrite", "--seed", str(seed)]
    subprocess.run([*command, "--", *arguments], cwd=file.parent, capture_output=True, check=False, timeout=600)
    return log


def retraced(log: Path, plan: Path | None = None) -> Retracing:
    with replay.open(log) as recording:
        return retrace(recording, plan=plan)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("retrace") / "plan.py"
    file.write_text(text())
    record(file)
    return file


@pytest.mark.costly
@pytest.mark.parametrize("demo", ["demo_log", "failed_log"])
def test_the_demos_do_the_same_again(
    demo: str, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["retrace", str(request.getfixturevalue(demo)), "--json"]) == 0
    (result,) = json.loads(capsys.readouterr().out)
    assert result["identical"]
    assert result["equal"] == result["steps"] > 100
    assert not result["notes"]


RANDOM = f"""\
import sys
sys.path.insert(0, {str(REPO)!r})
from pycram.bullet_world import BulletWorld
from tests.pycram.scheduling.random_orders import Plan
with BulletWorld() as world:
    Plan(int(sys.argv[1]), world).run()
"""


@seeded("random concurrent plans, retraced", range(200), 1)
def test_random_concurrent_plans_do_the_same_again(
    tmp_path: Path, seeds: range, record_property: Callable[[str, object], None]
) -> None:
    file, steps = tmp_path / "plan.py", 0
    file.write_text(RANDOM)
    for seed in seeds:
        result = retraced(record(file, str(seed), seed=seed))
        assert result.identical, (seed, result.difference)
        assert result.equal == result.steps > 20
        steps += result.steps
    record_property("records", steps)


@seeded("changes of one line, found by retrace", range(len(CHANGES)), 1)
def test_a_changed_line_is_told(plan: Path, tmp_path: Path, seeds: range) -> None:
    for seed in seeds:
        number, change = CHANGES[seed]
        changed = tmp_path / f"plan_{seed}.py"
        changed.write_text(text(number, change))
        result = retraced(plan.with_suffix(".mcap"), changed)
        assert result.difference is not None, change
        line = HEAD.count("\n") + number + 1
        said = [int(each.rpartition(":")[2]) for each in (result.difference.line, *result.difference.callers)]
        # what is left out, or leaves no record itself, shows where the plan goes on
        assert set(said) & {line, line + 1, line + 2}, (change, result.difference)
        assert result.notes == (f"{changed.name} differs from the recorded source",)


def test_a_plan_with_a_wrong_syntax_is_told_at_no_line_of_another_file(plan: Path, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text("import\n")
    difference = retraced(plan.with_suffix(".mcap"), wrong).difference
    assert difference is not None
    assert "its end with the failure SyntaxError: invalid syntax (wrong.py, line 1) where step 1 has" in difference.text
    assert not difference.line


def test_a_plan_whose_lines_moved_is_the_same(plan: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved.py"
    moved.write_text("# a comment\n\n" + text().replace("world.simulate(0.1)", "world.simulate( 0.1 )"))
    result = retraced(plan.with_suffix(".mcap"), moved)
    assert result.identical
    assert result.equal == result.steps


def test_what_a_plan_reads_of_the_world_outside_is_told_where_it_matters(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "height").write_text("1")
    file = tmp_path / "reads.py"
    file.write_text(
        "from pycram.bullet_world import BulletWorld, Object\n"
        "world = BulletWorld()\n"
        'milk = Object("milk", "milk", "milk.stl")\n'
        'milk.set_position([0, 0, float(open("height").read())])\n'
    )
    log = record(file)
    assert main(["retrace", str(log)]) == 0
    (tmp_path / "height").write_text("2")
    capsys.readouterr()
    assert main(["retrace", str(log)]) == 1
    said = capsys.readouterr().out
    assert f"at {file}:4 where step 3 has move body milk [0.000, 0.000, 1.000]" in said
    assert "move_body.position[2]: recorded 1.0, now 2.0" in said
    assert "reads.py:4 reads a file: open()" in said


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("from time import time as now; x = now()", "2 reads the clock: now()"),
        ("import datetime; x = datetime.datetime.now()", "2 reads the clock: datetime.datetime.now()"),
        ("import urllib.request as web; web.urlopen('x')", "2 reads the network: web.urlopen()"),
        ("x = Path('x').read_text()", "2 reads a file: Path('x').read_text()"),
        ("import random; x = random.SystemRandom().random()", "2 reads random numbers without a seed"),
        ("import numpy as np; x = np.random.default_rng()", "2 reads random numbers without a seed"),
        ("import numpy as np; x = np.random.default_rng(1)", ""),
        ("import random, time; x = random.random(); time.sleep(1)", ""),
        ("x = float(input())", "2 reads its input: input()"),
        ("x = sys.stdin.readline()", "2 reads its input: sys.stdin"),
        ("from sys import stdin as lines; x = [each for each in lines]", "2 reads its input: sys.stdin"),
    ],
)
def test_a_line_that_reads_the_world_outside_is_told_with_the_difference(tmp_path: Path, line: str, said: str) -> None:
    file = tmp_path / "plan.py"
    file.write_text(f"import sys\n{line}\nprint(x)\nopen('later')\n")
    reads = list(reads_before(FirstDifference(3, "it differs", f"{file}:3")))
    assert [each.startswith(f"plan.py:{said}") for each in reads] == [True] * bool(said)


def test_a_program_that_records_itself_is_run_as_a_program(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text(
        "import sys, recorder\n"
        "from pycram.bullet_world import BulletWorld, Object\n"
        'with recorder.record("program.mcap"):\n'
        "    with BulletWorld():\n"
        '        Object("milk", "milk", "milk.stl", [0, 0, float(sys.argv[1])])\n'
        "print('it goes on')\n"
    )
    subprocess.run([sys.executable, file, "0.5"], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    before = sorted(tmp_path.iterdir())
    result = retraced(tmp_path / "program.mcap")
    assert result.identical
    assert result.equal == result.steps
    assert sorted(tmp_path.iterdir()) == before  # it makes no other recording
    with replay.open(tmp_path / "program.mcap") as log:
        other = retrace(log, arguments=["0.6"])
    assert other.difference is not None
    assert other.difference.line == f"{file}:5"


def test_what_the_clock_ended_is_named_in_recordings_that_dont_guide_it() -> None:
    golden = next((Path(__file__).parents[1] / "golden" / "forks").glob("*.mcap"))
    with replay.open(golden) as recording:
        (late,) = (task for task in recording.records(Task) if task.kind == "timeout" and task.phase == Task.FINISHED)
        said = f"the clock ended timeout 0 s at step {late.seq}: no seed determines this moment"
        assert said in list(likely_reasons(recording, FirstDifference(late.seq, "")))
        assert said not in list(likely_reasons(recording, FirstDifference(late.seq + 1, "")))


_CLOCKS = """
import time
from pycram.bullet_world import BulletWorld, Object
from pycram.fluent import Fluent
from pycram.language import in_thread, par, timeout
from pycram.language.timeouts import TimedOut
with timeout(60):
    in_thread(time.sleep, 0)
world = BulletWorld()
cups = [Object(f"cup{i}", "cup", "cup.stl", [0, i, 1]) for i in range(2)]
count, never = Fluent(0, "count"), Fluent(0, "never")

def shoves(cup, seconds):
    x = 0
    try:
        with timeout(seconds):
            while True:
                x += 0.001
                cup.set_position([x, cup.get_position()[1], 1])
    except TimedOut:
        count.set_value(count.get_value() + 1)

def waits():
    for _ in range(3):
        (never > 0).wait_for(timeout=0.03)
        count.set_value(count.get_value() + 10)

def works():
    for _ in range(2):
        in_thread(time.sleep, 0.03)
        count.set_value(count.get_value() + 100)

par(lambda: shoves(cups[0], 0.2), lambda: shoves(cups[1], 0.1), waits, works)
"""


def test_what_the_clock_and_workers_decide_comes_at_the_same_moment_again(tmp_path: Path) -> None:
    file = tmp_path / "clocks.py"
    file.write_text(_CLOCKS)
    log = record(file)
    with replay.open(log) as recording:
        struck = [(strike, record.seq) for record in recording.records() for strike in record.strikes]
        values = [record.after_json for record in recording.records(Fluent)]
        last_of_all = len(recording)
    assert sum(len(strike.which) for strike, _ in struck) == 8  # 2 timeouts, 3 waits, 3 workers
    assert [strike.look for strike, _ in struck] == sorted({strike.look for strike, _ in struck})
    assert values[-1] == "232"
    result = retraced(log)
    assert result.identical, result.difference
    assert result.equal == last_of_all
    early = struck[len(struck) // 2][1]  # in the midst of them
    with replay.open(log) as recording:
        forked = fork(recording, early, tmp_path / "fork.mcap", control=True)
    assert forked.control is not None
    assert forked.control.identical, forked.control.difference
    result = retraced(tmp_path / "fork.mcap")
    assert result.identical, result.difference


def test_a_program_is_called_again_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    file, log = tmp_path / "below" / "program.py", tmp_path / "program.mcap"
    file.write_text(
        f'import sys, recorder\nwith recorder.record("{log}", output=True):\n    print(sys.argv, __name__, __file__)\n'
    )
    command = [sys.executable, "below/program.py", "1"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=600)
    with replay.open(log) as recording:
        result = retrace(recording)
        assert result.difference is None
        assert result.equal == len(recording) == 3


@pytest.mark.long
def test_of_recordings_of_one_name_each_is_retraced(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text(
        "import sys, recorder\n"
        "from pycram.bullet_world import BulletWorld, Object\n"
        "for x in sys.argv[1:]:\n"
        '    with recorder.record("program.mcap"), BulletWorld():\n'
        '        Object("milk", "milk", "milk.stl", [float(x), 0, 1])\n'
    )
    subprocess.run([sys.executable, file, "1", "2", "3"], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    logs = [tmp_path / name for name in ("program.mcap", "program.2.mcap", "program.3.mcap")]
    for log, own, others in zip(logs, ("923", "193", "129"), ("199", "929", "993"), strict=True):
        with replay.open(log) as recording:
            assert not retrace(recording, arguments=own).identical
            assert retrace(recording, arguments=others).identical


@pytest.mark.long
def test_texts_of_objects_differ_in_each_process_and_are_the_same(tmp_path: Path) -> None:
    file = tmp_path / "plan.py"
    file.write_text(
        "import sys\n"
        "from pycram.language import par\n"
        "class Thing: ...\n"
        "with par as s:\n"
        "    s(Thing)\n"
        "print(Thing(), len(sys.argv))\n"
    )
    log = record(file)
    assert retraced(log).identical
    with replay.open(log) as recording:
        assert retrace(recording, arguments=["more"]).difference is not None


@pytest.mark.costly
def test_what_a_plan_imagined_is_imagined_again(tmp_path: Path) -> None:
    file = tmp_path / "imagines.py"
    file.write_text(
        "from pycram.bullet_world import BulletWorld, Object\n"
        "from pycram.projection import project\n"
        "world = BulletWorld()\n"
        'milk = Object("milk", "milk", "milk.stl", [0, 0, 1])\n'
        "if project(milk.set_position, [1, 2, 3]):\n"
        "    milk.set_position([1, 2, 3])\n"
    )
    log = record(file)
    before = sorted(tmp_path.iterdir())
    assert tmp_path / "imagines.projection-1.mcap" in before
    assert retraced(log).identical
    assert sorted(tmp_path.iterdir()) == before
    assert main(["fork", str(log), "--at", "2", "-o", str(tmp_path / "on.mcap")]) == 0
    assert (tmp_path / "on.projection-1.mcap").exists()


def test_a_killed_run_is_retraced_to_its_last_record(tmp_path: Path) -> None:
    file = tmp_path / "killed.py"
    file.write_text(
        text().replace("sys.exit(0)", "import os, time\ntime.sleep(0.2)\nos.kill(os.getpid(), 9)\nfails(1)")
    )
    log = record(file)
    file.write_text(file.read_text().replace("os.kill(os.getpid(), 9)", ""))
    with replay.open(log) as recording:
        assert not recording.closed
        result = retrace(recording)
        assert result.identical
        assert result.equal == result.steps == len(recording) > 20


@pytest.mark.parametrize(
    ("change", "said"),
    [("move", "there is no such plan"), ("secret", "secret arguments weren't recorded")],
)
def test_what_cant_be_retraced_is_said_before_it_runs(tmp_path: Path, change: str, said: str) -> None:
    file = tmp_path / "plan.py"
    file.write_text("import sys\nfrom pathlib import Path\nPath('ran').touch()\n")
    log = record(file, "--token", "abc")
    (tmp_path / "ran").unlink()
    if change == "move":
        file.rename(tmp_path / "other.py")
    with pytest.raises(CantRetrace, match=said), replay.open(log) as recording:
        retrace(recording)
    assert not (tmp_path / "ran").exists()


def test_a_plan_that_ends_its_process_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "ends.py"
    file.write_text("import os\nfrom pycram.bullet_world import BulletWorld\nBulletWorld()\n")
    log = record(file)
    file.write_text(file.read_text().replace("BulletWorld()", "os.abort()"))
    with pytest.raises(CantRetrace, match="was killed by signal 6"):
        retraced(log)


@pytest.mark.costly
def test_of_several_recordings_the_others_are_retraced_where_one_cant_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("gone", "there"):
        (tmp_path / f"{name}.py").write_text("print('x')\n")
    gone, there = (record(tmp_path / f"{name}.py") for name in ("gone", "there"))
    (tmp_path / "gone.py").unlink()
    logs = [str(gone), str(shutil.copy(gone, tmp_path / "copy.mcap")), str(there)]
    assert main(["retrace", *logs]) == 2
    printed = capsys.readouterr()
    assert printed.out.startswith(f"identical  {logs[2]}")
    assert printed.err.count("there is no such plan") == 2
    assert main(["retrace", *logs, "--json"]) == 2
    results = json.loads(capsys.readouterr().out)
    assert [result.get("identical") for result in results] == [None, None, True]
    assert "there is no such plan" in results[0]["error"]


SHELF = """\
<robot name="shelf"><link name="board">
  <visual><geometry><box size="1 1 {0}"/></geometry><material name="m"><color rgba="{1} 1"/></material></visual>
  <collision><geometry><box size="1 1 {0}"/></geometry></collision>
</link></robot>
"""
PUT_ON_IT = """\
from pycram.bullet_world import BulletWorld, Object
with BulletWorld() as world:
    world.set_gravity([0, 0, -9.8])
    Object("board", "environment", "shelf.urdf")
    Object("milk", "milk", "milk.stl", [0, 0, 0.2])
    world.simulate(0.5)
"""


@pytest.mark.costly
def test_another_file_of_an_object_is_a_difference_only_where_it_matters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, shelf, on = tmp_path / "plan.py", tmp_path / "shelf.urdf", tmp_path / "on.mcap"
    file.write_text(PUT_ON_IT)
    shelf.write_text(SHELF.format(0.1, "1 1 1"))
    log = record(file)
    shelf.write_text(SHELF.format(0.1, "0 0 1"))
    assert main(["retrace", str(log)]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ["note       other files than recorded: shelf.urdf of board"]
    assert main(["fork", str(log), "--at", "4", "-o", str(on)]) == 0
    assert "note  other files than recorded: shelf.urdf of board" in capsys.readouterr().out
    shelf.write_text(SHELF.format(0.12, "1 1 1"))
    assert main(["retrace", str(log)]) == 1
    different, *_, note = capsys.readouterr().out.splitlines()
    assert "simulate 120 steps" in different
    assert note == "note       other files than recorded: shelf.urdf of board"
    assert main(["fork", str(log), "--at", "last", "-o", str(on)]) == 2
    assert "; other files than recorded: shelf.urdf of board" in capsys.readouterr().err


def test_what_a_person_or_the_clock_decides_is_refused_before_it_runs(tmp_path: Path) -> None:
    file = tmp_path / "plan.py"
    file.write_text(
        "from pathlib import Path\n"
        "from pycram.bullet_world import BulletWorld\n"
        "Path('ran').touch()\n"
        "with BulletWorld() as world:\n"
        "    world.set_gravity([0, 0, -1])\n"
        "    world.set_realtime(True)\n"
    )
    log = record(file)
    windowed = rewritten(log, tmp_path / "windowed.mcap", in_a_window)
    (tmp_path / "ran").unlink()
    for path, command, what in ((log, "set_realtime", "runs in real time"), (windowed, "open_world", "has a window")):
        with replay.open(path) as recording:
            first = next(each.seq for each in recording.records(Mutation) if each.HasField(command))
            with pytest.raises(CantRetrace, match=f"from step {first} on world_1 {what}.* Fork before that step"):
                retrace(recording)
            with pytest.raises(CantRetrace, match=what):
                fork(recording, first, tmp_path / "on.mcap")
    assert not (tmp_path / "ran").exists()
    with replay.open(log) as recording:
        assert fork(recording, 2, tmp_path / "on.mcap").succeeded


def in_a_window(record: Record) -> Record:
    if isinstance(record, Mutation) and record.HasField("open_world"):
        record.open_world.mode = "GUI"
    return record


def test_a_damaged_recording_guides_up_to_the_damage(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "plan.mcap"
    content = plan.with_suffix(".mcap").read_bytes()
    chunks = [(start, end) for opcode, start, end in container_records(content) if opcode == CHUNK]
    log.write_bytes(zeroed(content, *chunks[2]))
    assert main(["retrace", str(log)]) == 3
    lost = int(re.search(r"made the same first (\d+) records again", capsys.readouterr().out)[1])  # type: ignore[index]
    assert 0 < lost < 20
    for step in (lost, lost + 20):
        with (
            replay.open(log) as recording,
            pytest.raises(Damaged, match=f"step {lost} is lost; fork at an earlier step"),
        ):
            fork(recording, step, tmp_path / "on.mcap")
    with replay.open(log) as recording:
        assert fork(recording, lost - 1, tmp_path / "on.mcap").step == lost - 1


def test_a_system_without_fork_is_told(plan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "fork")
    with pytest.raises(CantRetrace, match=r"it has no os\.fork"):
        retraced(plan.with_suffix(".mcap"))
