"""What is taken from the recording instead of being done again: answers of queries, and the plan's source."""

from __future__ import annotations

import sys
from io import StringIO
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.records import Output, Query
from replay.cli.main import main
from replay.retrace.fork import fork
from replay.retrace.plan_process import CantRetrace
from replay.retrace.retrace import retrace
from tests.replay.documented import REPO
from tests.replay.retrace.test_retrace import record

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.slow

ASKS = """\
import random
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.reasoning.queries.query import Verdict, query
@query
def lucky(object):
    return Verdict(random.random() < 2)
world = BulletWorld()
world.set_gravity([0, 0, -9.8])
floor = Object("floor", "environment", "plane.urdf")
milk = Object("milk", "milk", "milk.stl", [0, 0, 0.1])
cup = Object("cup", "cup", "cup.stl", [0, -1, 0.1])
world.settle()
def ask():
    seen = btr.visible(milk, [0, -2, 0.5])
    print(seen, seen.evidence, btr.occluding(milk, [0, -2, 0.1]), btr.stable(milk), btr.contact(milk, floor))
ask()
milk.set_position([random.random(), 0, 0.3])
ask()
world.simulate(0.3)
ask()
print(lucky(milk))
milk.set_position([random.random(), 0, 0.3])
"""


@pytest.mark.costly
def test_recorded_answers_are_taken_and_all_else_is_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "asks.py"
    file.write_text(ASKS.replace("def lucky(object)", "def lucky(object, world=None)"))
    log = record(file)
    with replay.open(log) as recording:
        steps = len(recording)
        assert sum(each.name != "lucky" for each in recording.records(Query)) == 12
        assert not retrace(recording).taken
    assert main(["retrace", str(log), "--answers", "recorded"]) == 0
    said = capsys.readouterr().out
    assert f"made the same {steps} records again" in said
    assert "with 12 recorded answers" in said
    for before, after in (("contact(milk, floor)", "contact(cup, floor)"), ("[0, -2, 0.5]", "[0, -2, 0.6]")):
        other = tmp_path / "other.py"
        other.write_text(file.read_text().replace(before, after))
        with replay.open(log) as recording:
            difference = retrace(recording, plan=other, answers="recorded").difference
        assert difference is not None
        assert difference.line.startswith(f"{other}:1")


@pytest.mark.costly
def test_a_given_answer_is_taken_as_recorded_and_not_asked_for_elsewhere(tmp_path: Path) -> None:
    """A recorded answer that the query itself wouldn't give shows that it isn't asked."""
    file = tmp_path / "plan.py"
    file.write_text(ASKS.partition("@query")[0] + "world" + ASKS.partition("\nworld")[2].partition("print(lucky")[0])
    log, on = record(file), tmp_path / "on.mcap"
    with replay.open(log) as recording:
        step = next(each.seq for each in recording.records(Output))
        fork(recording, step, on, answers=["stable(milk)=false"])
    with replay.open(on) as forked:
        said = [each.text for each in forked.records(Output)]
        assert "False" in said[1]
        result = retrace(forked, answers="recorded")
        assert result.identical
        assert result.taken == 11


MAIN = """\
from pathlib import Path
from parts import steps
from pycram.bullet_world import BulletWorld, Object
world = BulletWorld()
milk = Object("milk", "milk", Path(__file__).parent / "model.stl")
steps.move(milk)
"""
STEPS = "import numbers_of\ndef move(body):\n    body.set_position([0, 0, numbers_of.height])\n"


@pytest.mark.costly
def test_the_recorded_source_runs_where_the_files_are_others_now(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "plans"
    (folder / "parts").mkdir(parents=True)
    file, steps = folder / "plan.py", folder / "parts" / "steps.py"
    (folder / "model.stl").write_bytes((REPO / "resources" / "milk.stl").read_bytes())
    file.write_text(MAIN)
    steps.write_text(STEPS)
    (folder / "numbers_of.py").write_text("height = 1\n")
    log = record(file)
    file.unlink()
    steps.write_text(STEPS.replace("height", "height + 1"))
    with replay.open(log) as recording:
        with pytest.raises(CantRetrace, match="use --recorded-source"):
            retrace(recording)
        result = retrace(recording, recorded_source=True)
        assert result.identical
        assert result.notes == (
            "run from the recorded source: parts/steps.py, plan.py; run from the disk: all other files",
        )
        fork(recording, 2, tmp_path / "on.mcap", recorded_source=True)
    with replay.open(tmp_path / "on.mcap") as on, replay.open(log) as recording:
        assert on[0].program == str(file)
        assert on[0].plan == recording[0].plan
        moved = next(each for each in on if getattr(each, "source_file", "") == str(steps))
        assert [caller.file for caller in moved.callers] == [str(file)]
    monkeypatch.setattr(sys, "stdin", StringIO("where\nb steps.py:3\nwatch body.name\nrs\nc\nq\n"))
    assert main(["debug", str(log), "3", "--recorded-source", "--no-checkpoints"]) == 0
    prompted = capsys.readouterr().out.split("(debug) ")
    moving = "-> body.set_position([0, 0, numbers_of.height])\n"
    frames = f"  {file}(6)<module>()\n-> steps.move(milk)\n> {steps}(3)move()\n{moving}"
    assert prompted[1].removeprefix("where\n") == frames, "the recorded lines, by the names that they had"
    assert prompted[5].startswith("c\nBreakpoint 1, steps.py:3\nstep 3 of")
    (folder / "numbers_of.py").write_text("height = 2\n")  # which isn't in a call stack, so it isn't attached
    assert main(["retrace", str(log), "--recorded-source"]) == 1
    assert f"{steps}:3" in capsys.readouterr().out


def test_the_recorded_source_of_a_plan_that_was_run_from_a_folder_below_it(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "plan.py").write_text("print(1)\n")
    with replay.open(record(tmp_path / "below" / ".." / "plan.py")) as recording:
        assert recording[0].program.endswith("/../plan.py")  # type: ignore[union-attr]
        assert retrace(recording, recorded_source=True).identical
