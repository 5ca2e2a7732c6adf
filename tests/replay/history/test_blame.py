"""Who did it: the record that last changed a body, up to the line of the plan."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.running import RunSpec, run
from recorder.records import Mutation
from recorder.tracing.span import span
from replay.cli.main import main
from tests.replay.commands import mutation

if TYPE_CHECKING:
    from pathlib import Path

    from replay.recording import Recording


def test_blame_distinguishes_a_move_from_being_carried(small: Recording) -> None:
    carried = small.step("task:carry@end")
    change = small.blame("milk", carried)
    assert change.how == "carried"
    assert change.record.move_body.body == "cereal"
    (held,) = change.carried
    assert held.step == mutation(small, "attach_body")
    assert [task.started.name for task in held.causes.tasks] == ["carry"]
    assert change.causes.tasks[0].call_stack[-1].text == 'with span("motion", "carry", {"object": milk}):'
    assert change.causes.call_stack[-1].text == "cereal.set_position([0.5, 0.2, 0.13])"
    assert change.causes.call_stack[-1].function == "main"
    assert change.distance == pytest.approx(0.283, abs=5e-3)
    assert small.blame("cereal", carried).how == "command"
    assert small.blame("cereal", carried).record == change.record


def test_repeated_call_stack_lines_are_printed_once(small: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    carried = small.step("task:carry@end")
    assert main(["blame", str(small.path), "milk", "--at", str(carried)]) == 0
    output = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert sum(line.startswith("called from ") and line.endswith("main()") for line in output) == 1
    tasks, calls = (line for line in output if "as above" in line)
    assert tasks.startswith("in carry(object=milk)")
    assert calls.endswith("in <module>, as above")


def test_blame_of_a_settled_body_includes_what_moved_it_before(small: Recording) -> None:
    change = small.blame("milk", mutation(small, "simulate"))
    assert change.how == "physics"
    assert change.distance < 5e-3
    assert change.earlier.how == "load"
    assert change.earlier.record.seq == mutation(small, "load_body", 1)


def test_blame_is_the_last_record_that_changed_it_at_every_step(small: Recording) -> None:
    changes = [r.seq for r in small.records(Mutation) if any(state.body == "cereal" for state in r.effect.bodies)]
    for step in range(changes[0], len(small), 7):
        assert small.blame("cereal", step).record.seq == max(seq for seq in changes if seq <= step)


def test_blame_gives_the_plan_s_line_outside_of_tasks(small: Recording, capsys: pytest.CaptureFixture[str]) -> None:
    change = small.blame("cereal").causes
    assert not change.tasks
    assert [line.text for line in change.call_stack][-2:] == [
        "main()",
        "cereal.set_position([0.5 + turn / 1000, 0.2, 0.13])",
    ]
    assert change.call_stack[-1].function == "main"
    assert main(["blame", str(small.path), "cereal"]) == 0
    output = capsys.readouterr().out
    assert "  by the plan itself\n  from " in output
    assert "in main:  cereal.set_position(" in output


IN_A_MODULE = """
from pycram.language import seq

def lift(ball):
    ball.set_position([0, 0, 1])

def shove(ball):
    with seq:
        ball.set_position([1, 0, 0])
"""


OF_A_PLAN = """
import threading
from pycram.bullet_world import BulletWorld, Object
from moves_of_robots import lift, shove

with BulletWorld():
    ball = Object("ball", "ball", "apple.stl")
    lift(ball)
    shove(ball)
    helper = threading.Thread(target=lambda: lift(ball))
    helper.start()
    helper.join()
"""


def test_call_stacks_lead_through_modules_blocks_and_threads(tmp_path: Path) -> None:
    (tmp_path / "moves_of_robots.py").write_text(IN_A_MODULE)
    (tmp_path / "plan.py").write_text(OF_A_PLAN)
    assert run(RunSpec(tmp_path / "plan.py"), tmp_path / "x.mcap") == 0
    with replay.open(tmp_path / "x.mcap") as log:
        moves = [mutation(log, "move_body", number) for number in range(3)]
        loaded, *causes = [log.blame("ball", step).causes for step in (mutation(log, "load_body"), *moves)]
    assert [line.text for line in loaded.call_stack] == ['ball = Object("ball", "ball", "apple.stl")']
    assert [[line.text for line in each.call_stack] for each in causes] == [
        ["lift(ball)", "ball.set_position([0, 0, 1])"],
        ["shove(ball)", "ball.set_position([1, 0, 0])"],
        ["helper = threading.Thread(target=lambda: lift(ball))", "ball.set_position([0, 0, 1])"],
    ]
    assert [[task.started.name for task in each.tasks] for each in causes] == [[], ["seq"], []]
    assert causes[1].tasks[0].call_stack[-1].text == "with seq:"


OF_A_BRANCH = """
from pycram.bullet_world import BulletWorld, Object
from pycram.language import par

def lift(ball):
    ball.set_position([0, 0, 1])

with BulletWorld():
    ball = Object("ball", "ball", "apple.stl")
    with par as block:
        block(lift, ball)
"""


def test_within_a_task_the_call_stack_is_that_of_the_change(tmp_path: Path) -> None:
    (tmp_path / "plan.py").write_text(OF_A_BRANCH)
    assert run(RunSpec(tmp_path / "plan.py"), tmp_path / "x.mcap") == 0
    with replay.open(tmp_path / "x.mcap") as log:
        causes = log.blame("ball").causes
    assert [line.text for line in causes.call_stack] == ["block(lift, ball)", "ball.set_position([0, 0, 1])"]
    assert causes.tasks[0].call_stack[-1].text == "block(lift, ball)"


@pytest.mark.slow
def test_a_motion_s_changes_have_the_call_stack_of_its_task(failed_log: Path) -> None:
    with replay.open(failed_log) as log:
        sourced = {bool(record.task): record.source_line > 0 for record in log.records(Mutation)}
    assert sourced == {False: True, True: False}


def test_blame_of_a_removed_body_is_its_removal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "x.mcap"), BulletWorld(name="lab") as world:
        ball = Object("ball", "ball", "apple.stl")
        ball.set_position([1, 0, 0])
        with span("motion", "clear"):
            ball.remove()
        world.simulate(0.1)
        Object("ball", "ball", "apple.stl", [0, 0, 3])
    with replay.open(tmp_path / "x.mcap") as log:
        removal, again = mutation(log, "remove_body"), mutation(log, "load_body", 1)
        gone = log.blame("ball", again - 1)
        assert (gone.how, gone.record.seq, gone.after) == ("removed", removal, None)
        assert gone.causes.tasks[0].started.name == "clear"
        assert (gone.earlier.how, gone.earlier.record.seq) == ("command", mutation(log, "move_body"))
        assert log.blame("ball").how == "load"
        with pytest.raises(replay.NoSuchName):
            log.blame("ball", mutation(log, "load_body") - 1)
        with pytest.raises(replay.NoSuchName, match="no world is open"):
            log.blame("ball", "last")
    assert main(["blame", str(tmp_path / "x.mcap"), "ball", "--at", str(again - 1)]) == 0
    assert capsys.readouterr().out.startswith("ball was removed from [1, 0, 0]\n")
    assert main(["blame", str(tmp_path / "x.mcap"), "ball", "--at", str(again - 1), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["earlier"]["how"] == "command"


def test_moving_the_head_does_not_move_a_held_object(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "x.mcap"), BulletWorld() as world:
        world.robot = robot = Object("pr2", "robot", "pr2.urdf", [0.123, 0.456, 0], [0, 0, 0.3, 0.9])
        milk = Object("milk", "milk", "milk.stl", [0.777, 0.333, 1.1], [0.1, 0.2, 0.3, 0.7])
        robot.attach(milk, "l_gripper_tool_frame")
        milk.set_position([0.7, 0.3, 1.1])
        robot.set_joint_position("head_pan_joint", 0.5)
    with replay.open(tmp_path / "x.mcap") as log:
        moved, turned = mutation(log, "move_body"), mutation(log, "move_joints")
        assert "milk" in [state.body for state in log[turned].effect.bodies]  # in its last digits
        assert log.blame("milk").record.seq == moved


@pytest.mark.parametrize(
    ("target", "hint"),
    [("milks", "did you mean milk"), ("milk.lid", "joint of milk 'lid'"), ("milk.", "joint of milk")],
)
def test_blame_of_an_unknown_name_suggests_known_ones(small: Recording, target: str, hint: str) -> None:
    with pytest.raises(replay.NoSuchName, match=hint):
        small.blame(target)


@pytest.mark.slow
def test_blame_in_the_kitchen(demo_log: Path) -> None:
    with replay.open(demo_log) as log:
        joint = "sink_area_left_upper_drawer_main_joint"
        opened = log.blame(f"kitchen.{joint}")
        assert opened.how == "command"
        assert [task.started.name for task in opened.causes.tasks] == ["Accessing", "accessing"]
        spoon = log.blame("spoon", opened.record.seq)
        assert spoon.how == "along"
        assert spoon.record == opened.record
        milk = log.blame("milk", "task:move-arm-joints#-1@end")
        placed = milk.earlier or milk
        assert "place" in [task.started.name for task in placed.causes.tasks]
        assert placed.carried[0].held.carrier == "pr2"


def test_blame_hints_at_a_closed_world_that_had_the_body(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file):
        with BulletWorld(name="lab"):
            Object("cup", "cup", "cup.stl").set_position([0, 0, 1])
        with BulletWorld(name="hall") as hall:
            hall.simulate(0.1)
    assert main(["blame", str(file), "cup"]) == 2
    output = capsys.readouterr().err
    assert "there is no object 'cup'; lab contained it and was closed later: use --at " in output
    assert main(["blame", str(file), "cup", "--at", output.split("--at ")[1].split(",")[0]]) == 0
    assert "cup was moved: by 1.000 m" in capsys.readouterr().out
    assert main(["blame", str(file), "cap"]) == 2
    assert "closed" not in capsys.readouterr().err


def test_blame_names_its_world_if_the_default_one_has_no_such_body(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "x.mcap"
    with BulletWorld(name="a") as a:
        Object("cup", "cup", "cup.stl")
        with recorder.record(file), BulletWorld(name="b") as b:
            gone = Object("cup", "cup", "cup.stl")
            gone.remove()
            ball = Object("ball", "ball", "apple.stl", world=a)
            ball.remove()
            b.simulate(0.1)
    assert main(["blame", str(file), "cup"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("cup in a was already at [0, 0, 0] when the recording began\n")
    assert "(b, the last opened world, has no cup; choose a world with --world)" in output
    assert main(["blame", str(file), "ball"]) == 0
    assert capsys.readouterr().out.startswith("ball in a was removed from [0, 0, 0]\n")
    assert main(["blame", str(file), "cup", "--world", "b"]) == 0
    assert capsys.readouterr().out.startswith("cup in b was removed from [0, 0, 0]\n")
    assert main(["blame", str(file), "cup", "--world", "a"]) == 0
    assert "opened last" not in capsys.readouterr().out
