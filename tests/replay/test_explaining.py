"""diff, blame and why tell what happened, to people who were not there."""

from __future__ import annotations

import io
import json
import shlex
from typing import TYPE_CHECKING

import pytest
from PIL import Image

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram import worlds
from pycram.bullet_world import BulletWorld, Object
from pycram.cli import run
from pycram.failures import PlanFailure
from pycram.language import par
from recorder.records import Mutation, Query, Run, Task
from recorder.span import span
from replay import words
from replay.blame import blame
from replay.cli import main
from replay.diff import difference
from replay.runs import compare
from replay.why import why

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from replay.log import Log


@pytest.fixture
def small(small_log: Path) -> Iterator[Log]:
    with replay.open(small_log) as log:
        yield log


@pytest.fixture
def failed(failed_log: Path) -> Iterator[Log]:
    with replay.open(failed_log) as log:
        yield log


def mutation(log: Log, command: str, which: int = 0) -> int:
    return [r.seq for r in log.records(Mutation) if r.WhichOneof("command") == command][which]


# --- diff ------------------------------------------------------------------------------------------------------------


def test_a_step_differs_from_itself_in_nothing(small: Log) -> None:
    for step in (0, 5, 60, len(small) - 1):
        assert not difference(small.state_at(step), small.state_at(step))


def test_a_difference_names_what_came_moved_and_changed_hands(small: Log) -> None:
    loaded, attached = mutation(small, "load_body", 1), mutation(small, "attach_body")
    came = difference(small.state_at(loaded - 1), small.state_at(loaded))
    assert came.came == (("table", "milk"),)
    assert not came.changed
    held = difference(small.state_at(attached - 1), small.state_at(attached))
    (change,) = [change for change in held.changed if change.body == "milk"]
    assert change.changed_hands
    assert not change.moved
    assert change.carrier[1].carrier == "cereal"
    moved = difference(small.state_at(attached), small.state_at(attached + 2))
    assert {change.body for change in moved.notable} == {"milk", "cereal"}
    for change in moved.notable:
        assert change.distance == pytest.approx((0.2**2 + 0.2**2) ** 0.5, abs=5e-3)


def test_two_runs_of_the_same_plan_are_the_same(small_log: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    again.write_bytes(small_log.read_bytes())
    with replay.open(small_log) as first, replay.open(again) as second:
        compared = compare(first, second)
        assert compared.parting is None
        assert compared.alike == len(first)
        assert not compared.world


def drop(file: Path, heights: list[float], *, extra: bool = False) -> None:
    with recorder.record(file, name=file.stem), BulletWorld(name="lab") as world:
        ball = Object("ball", "ball", "apple.stl")
        for height in heights:
            with span("motion", "drop", {"height": height}):
                ball.set_position([0, 0, height])
        if extra:
            with span("motion", "look"):
                ball.set_position([0, 0, 9])
        world.simulate(0.1)


def test_runs_part_at_the_first_record_that_differs(tmp_path: Path) -> None:
    drop(tmp_path / "a.mcap", [1, 2, 3])
    drop(tmp_path / "b.mcap", [1, 2.5, 3])
    with replay.open(tmp_path / "a.mcap") as first, replay.open(tmp_path / "b.mcap") as second:
        parting = compare(first, second).parting
        assert parting.task == "drop"
        assert parting.first.seq == parting.second.seq == first.step("task:drop#2@start")
        assert parting.fields == {"parameters.height": (2, 2.5)}
        assert compare(first, second, tolerance=1.0).parting is None


def test_what_only_one_run_did_is_found(tmp_path: Path) -> None:
    drop(tmp_path / "a.mcap", [1, 2])
    drop(tmp_path / "b.mcap", [1, 2], extra=True)
    with replay.open(tmp_path / "a.mcap") as first, replay.open(tmp_path / "b.mcap") as second:
        for one, other, side in ((first, second, "second"), (second, first, "first")):
            parting = compare(one, other).parting
            alone = getattr(parting, side)
            assert isinstance(alone, Task)
            assert alone.name == "look"
            assert alone.phase == Task.STARTED
        compared = compare(first, second)
        (change,) = compared.world.changed
        assert change.body == "ball"
        assert change.after[0][2] > 8


def test_what_only_one_run_did_comes_before_what_it_led_to(tmp_path: Path) -> None:
    """Records are numbered differently from there on, and still compared with their like."""

    def run(file: Path, *, looks: bool, height: float) -> None:
        with recorder.record(file), BulletWorld(name="lab"):
            ball = Object("ball", "ball", "apple.stl")
            if looks:
                with span("motion", "look"):
                    pass
            for place in (1.0, height, 3.0):
                with span("motion", "drop", {"height": place}):
                    ball.set_position([0, 0, place])

    run(tmp_path / "a.mcap", looks=False, height=2.0)
    run(tmp_path / "b.mcap", looks=True, height=2.5)
    run(tmp_path / "c.mcap", looks=True, height=2.0)
    with (
        replay.open(tmp_path / "a.mcap") as first,
        replay.open(tmp_path / "b.mcap") as second,
        replay.open(tmp_path / "c.mcap") as third,
    ):
        assert compare(first, second).parting.second.name == "look"
        assert compare(first, third).parting.second.name == "look"
        assert compare(second, third).parting.fields == {"parameters.height": (2.5, 2.0)}


def test_diff_of_runs_that_part_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drop(tmp_path / "a.mcap", [1])
    drop(tmp_path / "b.mcap", [2])
    assert main(["diff", str(tmp_path / "a.mcap"), str(tmp_path / "a.mcap")]) == 0
    assert main(["diff", str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap")]) == 1
    assert "part in drop" in capsys.readouterr().out


# --- blame -----------------------------------------------------------------------------------------------------------


def test_blame_tells_a_body_s_own_move_from_being_carried(small: Log) -> None:
    carried = small.step("task:carry@end")
    found = blame(small, "milk", carried)
    assert found.how == "carried"
    assert found.record.move_body.body == "cereal"
    (held,) = found.carried
    assert held.step == mutation(small, "attach_body")
    assert [task.name for task in held.causes.tasks] == ["carry"]
    assert found.causes.line.text == 'with span("motion", "carry", {"object": milk}):'
    assert found.causes.line.function == "main"
    assert found.distance == pytest.approx(0.283, abs=5e-3)
    assert blame(small, "cereal", carried).how == "command"
    assert blame(small, "cereal", carried).record == found.record


def test_blame_of_what_came_to_rest_goes_on_to_what_brought_it_there(small: Log) -> None:
    found = blame(small, "milk", mutation(small, "simulate"))
    assert found.how == "physics"
    assert found.distance < 5e-3
    assert found.earlier.how == "load"
    assert found.earlier.record.seq == mutation(small, "load_body", 1)


def test_blame_is_the_last_record_that_changed_it_at_every_step(small: Log) -> None:
    changes = [r.seq for r in small.records(Mutation) if any(state.body == "cereal" for state in r.effect.bodies)]
    for step in range(changes[0], len(small), 7):
        assert blame(small, "cereal", step).record.seq == max(seq for seq in changes if seq <= step)


def test_blame_tells_the_line_of_what_no_task_did(small: Log, capsys: pytest.CaptureFixture[str]) -> None:
    found = blame(small, "cereal").causes
    assert not found.tasks
    assert [line.text for line in found.way][-2:] == ["main()", "cereal.set_position([0.5 + turn / 1000, 0.2, 0.13])"]
    assert found.line.function == "main"
    assert main(["blame", str(small.path), "cereal"]) == 0
    said = capsys.readouterr().out
    assert "  by the plan itself\n  from " in said
    assert "in main:  cereal.set_position(" in said


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


def test_lines_lead_through_modules_blocks_and_threads(tmp_path: Path) -> None:
    (tmp_path / "moves_of_robots.py").write_text(IN_A_MODULE)
    (tmp_path / "plan.py").write_text(OF_A_PLAN)
    assert run(tmp_path / "plan.py", tmp_path / "x.mcap") == 0
    with replay.open(tmp_path / "x.mcap") as log:
        moves = [mutation(log, "move_body", number) for number in range(3)]
        loaded, *told = [blame(log, "ball", step).causes for step in (mutation(log, "load_body"), *moves)]
    assert [line.text for line in loaded.way] == ['ball = Object("ball", "ball", "apple.stl")']
    assert [[line.text for line in each.way] for each in told] == [
        ["lift(ball)", "ball.set_position([0, 0, 1])"],
        ["shove(ball)", "ball.set_position([1, 0, 0])"],
        ["helper = threading.Thread(target=lambda: lift(ball))", "ball.set_position([0, 0, 1])"],
    ]
    assert [[task.name for task in each.tasks] for each in told] == [[], ["seq"], []]
    assert told[1].tasks[0].line.text == "with seq:"


@pytest.mark.slow
def test_a_motion_s_changes_are_told_by_its_tasks_only(failed_log: Path) -> None:
    with replay.open(failed_log) as log:
        told = {bool(record.task): record.source_line > 0 for record in log.records(Mutation)}
    assert told == {False: True, True: False}


def test_blame_of_what_was_removed_tells_who_removed_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "x.mcap"), BulletWorld(name="lab") as world:
        ball = Object("ball", "ball", "apple.stl")
        ball.set_position([1, 0, 0])
        with span("motion", "clear"):
            ball.remove()
        world.simulate(0.1)
        Object("ball", "ball", "apple.stl", [0, 0, 3])
    with replay.open(tmp_path / "x.mcap") as log:
        removal, again = mutation(log, "remove_body"), mutation(log, "load_body", 1)
        gone = blame(log, "ball", again - 1)
        assert (gone.how, gone.record.seq, gone.after) == ("removed", removal, None)
        assert gone.causes.tasks[0].name == "clear"
        assert (gone.earlier.how, gone.earlier.record.seq) == ("command", mutation(log, "move_body"))
        assert blame(log, "ball").how == "load"
        with pytest.raises(replay.NoSuchName):
            blame(log, "ball", mutation(log, "load_body") - 1)
        with pytest.raises(replay.NoSuchName, match="no world is open"):
            blame(log, "ball", "last")
    assert main(["blame", str(tmp_path / "x.mcap"), "ball", "--at", str(again - 1)]) == 0
    assert capsys.readouterr().out.startswith("ball was removed from [1, 0, 0]\n")
    assert main(["blame", str(tmp_path / "x.mcap"), "ball", "--at", str(again - 1), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["earlier"]["how"] == "command"


def test_what_a_hand_holds_that_rests_was_not_moved_by_the_head(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "x.mcap"), BulletWorld() as world:
        world.robot = robot = Object("pr2", "robot", "pr2.urdf", [0.123, 0.456, 0], [0, 0, 0.3, 0.9])
        milk = Object("milk", "milk", "milk.stl", [0.777, 0.333, 1.1], [0.1, 0.2, 0.3, 0.7])
        robot.attach(milk, "l_gripper_tool_frame")
        milk.set_position([0.7, 0.3, 1.1])
        robot.set_joint_position("head_pan_joint", 0.5)
    with replay.open(tmp_path / "x.mcap") as log:
        moved, turned = mutation(log, "move_body"), mutation(log, "move_joints")
        assert "milk" in [state.body for state in log[turned].effect.bodies]  # in its last digits
        assert blame(log, "milk").record.seq == moved


@pytest.mark.parametrize(("target", "hint"), [("milks", "did you mean milk"), ("milk.lid", "joint of milk 'lid'")])
def test_blame_of_what_isn_t_there_says_what_is(small: Log, target: str, hint: str) -> None:
    with pytest.raises(replay.NoSuchName, match=hint):
        blame(small, target)


@pytest.mark.slow
def test_blame_in_the_kitchen(demo_log: Path) -> None:
    with replay.open(demo_log) as log:
        joint = "sink_area_left_upper_drawer_main_joint"
        opened = blame(log, f"kitchen.{joint}")
        assert opened.how == "command"
        assert [task.name for task in opened.causes.tasks] == ["Accessing", "accessing"]
        spoon = blame(log, "spoon", opened.record.seq)
        assert spoon.how == "along"
        assert spoon.record == opened.record
        milk = blame(log, "milk", "task:move-arm-joints#-1@end")
        placed = milk.earlier or milk
        assert "place" in [task.name for task in placed.causes.tasks]
        assert placed.carried[0].held.carrier == "pr2"


# --- why -------------------------------------------------------------------------------------------------------------


def test_why_follows_the_causes_to_the_task_and_the_plan_s_lines(small: Log) -> None:
    found = why(small)
    assert found.failure.message == "the milk can't be put anywhere"
    assert [(error.type, error.message) for error in found.raised] == [
        ("ReasoningError", "milk would fall from 0.5 m"),
        ("ReasoningError", "the milk can't be put anywhere"),
    ]
    assert [line.text for line in found.raised[0].lines] == [
        "put(milk, height)",
        'raise btr.ReasoningError(f"{body.name} would fall from {height} m")',
    ]
    assert found.raised[-1].lines[-1].text == 'raise btr.ReasoningError("the milk can\'t be put anywhere") from last'
    assert found.task.parameters["height"] == 0.5
    assert [each.task.parameters["height"] for each in found.tries] == [1.0, 0.5]
    assert found.step == small.step("task:put#2@end")


def test_why_tells_what_the_robot_was_told(small: Log) -> None:
    found = why(small)
    (asked,) = found.asked
    assert asked.query.name == "stable"
    assert asked.query.task == found.task.started.task
    assert not asked.moved
    assert found.warning == asked.query


def test_why_tells_what_changed_since_something_went_well(small: Log) -> None:
    found = why(small)
    assert found.same is None
    assert found.last.task.started.name == "carry"
    assert {change.body for change in found.last.difference.notable} == {"milk", "cereal"}


def test_why_of_another_failure(small: Log) -> None:
    first = small.step("task:put@end")
    for step in (first, first - 1, "failure", "task:put#2@start"):
        found = why(small, step)
        assert found.task.parameters["height"] == (0.5 if step in ("failure", "task:put#2@start") else 1.0)
    with pytest.raises(replay.NoSuchStep, match="no task failed"):
        why(small, 5)


def drop_in_branch(ball: Object) -> None:
    with span("motion", "drop", {"object": ball}):
        raise PlanFailure("it is stuck")


def drop_in_block(file: Path) -> None:
    with recorder.record(file, source=__file__), BulletWorld(name="lab"):
        ball = Object("ball", "ball", "apple.stl")
        with par as block:
            block(drop_in_branch, ball)


def test_where_a_branch_failed_is_told_down_to_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(PlanFailure):
        drop_in_block(tmp_path / "x.mcap")
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    where = capsys.readouterr().out.partition("Where in the plan\n")[2].partition("\n\n")[0]
    told = [line.strip() for line in where.splitlines()]
    assert told.index("block(drop_in_branch, ball)") < told.index('with span("motion", "drop", {"object": ball}):')
    assert "which became BranchesFailed:" in told
    assert "with par as block:" in told


def test_another_failure_isn_t_told_to_be_the_plan_s(small: Log, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(small.path), "task:put@end"]) == 0
    first, second = capsys.readouterr().out.splitlines()[:2]
    assert "the milk can't be put anywhere" in first
    assert second.startswith("Before that, put(object=milk, height=1) failed")


def test_after_the_end_of_all_worlds_it_is_said_that_they_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with recorder.record(tmp_path / "x.mcap"), BulletWorld(name="lab"):
        Object("ball", "ball", "apple.stl")
    for verb in ("state", "render", "ask"):
        more = {"state": "ball", "ask": "stable(ball)"}.get(verb)
        assert main([verb, str(tmp_path / "x.mcap"), "last", *([more] if more else [])]) == 2
        said = capsys.readouterr().err
        assert "no world is open" in said
        assert "lab" in said


def take_what_is_gone(file: Path) -> None:
    with recorder.record(file), BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        ball = Object("ball", "ball", "apple.stl", [0, 0, 1])
        btr.stable(ball)
        ball.set_position([1, 0, 1])
        with span("motion", "take", {"object": ball}):
            raise PlanFailure("it isn't there")


def test_an_answer_that_is_out_of_date_says_so(tmp_path: Path) -> None:
    with pytest.raises(PlanFailure):
        take_what_is_gone(tmp_path / "x.mcap")
    with replay.open(tmp_path / "x.mcap") as log:
        found = why(log)
        (asked,) = found.asked
        assert asked.query.answer_json == "false"
        assert asked.moved == ("ball",)
        assert found.warning is None
        assert main(["why", str(log.path)]) == 0


def take_after(file: Path, change: str) -> None:
    """A ball is asked about; then something becomes of it, or of its world; then it can't be taken."""
    with recorder.record(file):
        lab = BulletWorld(name="lab")
        Object("floor", "environment", "plane.urdf")
        ball = Object("ball", "ball", "apple.stl", [0, 0, 1])
        lab.set_gravity([0, 0, -9.8])
        btr.stable(ball)
        if change == "removed":
            ball.remove()
        elif change == "another lab":
            lab.exit()
            BulletWorld(name="lab")
            ball = Object("ball", "ball", "apple.stl", [0, 0, 1])
        elif change == "another world":
            BulletWorld(name="hall")
            Object("ball", "ball", "apple.stl", [7, 7, 7])
        with span("motion", "take", {"object": ball}):
            raise PlanFailure("it can't be taken")


@pytest.fixture
def taken(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Log]:
    with pytest.raises(PlanFailure):
        take_after(tmp_path / "x.mcap", request.param)
    while worlds.opened():
        worlds.opened()[-1].exit()
    with replay.open(tmp_path / "x.mcap") as log:
        yield log


@pytest.mark.parametrize("taken", ["nothing"], indirect=True)
def test_an_answer_that_holds_is_a_warning(taken: Log) -> None:
    found = why(taken)
    assert found.warning is not None
    assert found.warning.name == "stable"


@pytest.mark.parametrize("taken", ["removed"], indirect=True)
def test_what_was_removed_is_not_told_to_have_moved(taken: Log, capsys: pytest.CaptureFixture[str]) -> None:
    found = why(taken)
    assert (found.asked[0].gone, found.asked[0].moved, found.absent) == (("ball",), (), ("ball",))
    assert found.warning is None
    assert main(["why", str(taken.path)]) == 0
    said = capsys.readouterr().out
    assert "since then ball was removed" in said
    assert "ball isn't there any more" in said


@pytest.mark.parametrize("taken", ["another lab"], indirect=True)
def test_nobody_was_warned_of_what_is_in_a_later_world_of_that_name(
    taken: Log, capsys: pytest.CaptureFixture[str]
) -> None:
    found = why(taken)
    assert [asked.world for asked in found.asked] == ["lab"]
    assert found.world.title == "lab (2nd of that name)"
    assert found.warning is None
    assert main(["why", str(taken.path)]) == 0
    assert "asked in another world: lab" in capsys.readouterr().out


@pytest.mark.parametrize("taken", ["another world"], indirect=True)
@pytest.mark.slow
def test_commands_to_go_on_with_name_the_world_where_another_would_be_meant(
    taken: Log, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["why", str(taken.path)]) == 0
    said = capsys.readouterr().out.partition("Look closer\n")[2]
    commands = [shlex.split(line)[1:] for line in said.splitlines()]
    assert {command[0] for command in commands} == {"show", "state", "blame", "ask", "render", "restore"}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO("print(world.name, objects['ball'].get_position())"))
    for command in commands:
        assert command[0] == "show" or command[-2:] == ["--world", "lab"]
        assert main(command) == 0
    said = capsys.readouterr().out
    assert "[7" not in said
    assert "stable(ball): no" in said
    assert "lab@" in said


@pytest.mark.parametrize("taken", ["another world"], indirect=True)
def test_blame_is_of_the_world_that_was_opened_last_and_tells_of_others(
    taken: Log, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (blame(taken, "ball").world, blame(taken, "ball").others) == ("hall", ("lab",))
    assert blame(taken, "ball", world="lab").world == "lab"
    assert blame(taken, "floor").world == "lab"
    assert taken.state_at("failure").body("ball").position == (7, 7, 7)
    assert main(["blame", str(taken.path), "ball"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("ball in hall has been at [7, 7, 7]")
    assert "ball is in lab too" in said


def test_blame_names_the_world_where_the_one_opened_last_has_no_such_body(
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
    said = capsys.readouterr().out
    assert said.startswith("cup in a was at [0, 0, 0] already when the recording began\n")
    assert "(b, the world opened last, has no cup: --world tells which one is meant)" in said
    assert main(["blame", str(file), "ball"]) == 0
    assert capsys.readouterr().out.startswith("ball in a was removed from [0, 0, 0]\n")
    assert main(["blame", str(file), "cup", "--world", "b"]) == 0
    assert capsys.readouterr().out.startswith("cup in b was removed from [0, 0, 0]\n")
    assert main(["blame", str(file), "cup", "--world", "a"]) == 0
    assert "opened last" not in capsys.readouterr().out


def test_a_small_change_can_be_seen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "x.mcap"
    with recorder.record(file), BulletWorld(name="lab"):
        ball = Object("ball", "ball", "apple.stl", [0, 0, 1])
        ball.set_position([0, 0, 1 + 2e-8])
    assert main(["blame", str(file), "ball"]) == 0
    assert "ball was moved: by 2e-05 mm to" in capsys.readouterr().out
    with replay.open(file) as log:
        step = mutation(log, "move_body")
    assert main(["diff", str(file), str(step - 1), str(step), "--all"]) == 0
    assert "[0, 0, 1] -> [0, 0, 1.00000002]" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (0.25, 0.25, ("0.25", "0.25")),
        (0.25, 0.5, ("0.25", "0.5")),
        (0.25, 0.24999993, ("0.25", "0.2499999")),
        (0.0, -4.8e-9, ("0", "-4.8e-09")),
        (1.0, 1.0 + 2**-52, ("1.0", "1.0000000000000002")),
    ],
)
def test_numbers_are_told_with_the_digits_that_tell_them_apart(
    before: float, after: float, told: tuple[str, str]
) -> None:
    assert words.apart(before, after) == told


def test_a_mistake_in_the_plan_s_own_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError), recorder.record(tmp_path / "x.mcap", source=__file__), BulletWorld():
        {}["spoon"]
    with replay.open(tmp_path / "x.mcap") as log:
        found = why(log)
        assert found.task is None
        assert found.is_of_python
        assert '{}["spoon"]' in found.raised[0].lines[-1].text
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    assert "KeyError: 'spoon'" in capsys.readouterr().out.splitlines()[0]


def gives_up(error: BaseException) -> None:
    with pytest.raises(PlanFailure) as failed, span("motion", "fetch"):
        raise PlanFailure("it is out of reach")
    raise error from failed.value


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (KeyError("left"), "KeyError: 'left'"),
        (SystemExit(3), "SystemExit: 3"),
        (KeyboardInterrupt(), "KeyboardInterrupt"),
        (PlanFailure("milk"), "PlanFailure: milk"),
        (PlanFailure("no milk is left"), "no milk is left"),
    ],
)
def test_the_first_line_says_what_went_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], error: BaseException, told: str
) -> None:
    with pytest.raises(type(error)), recorder.record(tmp_path / "x.mcap", name="plan", source=__file__):
        gives_up(error)
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].partition(" s: ")[2] == told
    assert said[1].startswith("It began when fetch failed")


def test_a_plan_that_succeeded_has_nothing_to_explain(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "x.mcap", name="walk"):
        pass
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    assert capsys.readouterr().out == "walk succeeded.\n"


def test_pictures_of_no_failure_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "x.mcap", name="walk"):
        pass
    assert main(["why", str(tmp_path / "x.mcap"), "--pictures", str(tmp_path / "pictures")]) == 0
    assert "nothing failed" in capsys.readouterr().err
    assert not (tmp_path / "pictures").exists()


def test_failures_that_the_plan_handled_are_told_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorder.record(tmp_path / "x.mcap", name="walk"), span("plan", "walk"):
        for number in range(12):
            with pytest.raises(PlanFailure), span("motion", "step", {"foot": number}):
                raise PlanFailure(f"stumbled {number}")
        with span("motion", "step", {"foot": 99}):
            pass
    assert main(["why", str(tmp_path / "x.mcap")]) == 0
    said = capsys.readouterr().out
    assert "walk succeeded" in said
    assert "step was tried 12 times" in said
    assert "... 5 more ..." in said
    assert "stumbled 11" in said


def test_why_of_a_plan_that_was_cut_off(small_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with replay.open(small_log) as log:
        last = log.step("task:put#2@start")
        places = [log._index.chunks[number] for number in range(len(log._index.chunks))]
        end = next(place.offset for place in places[log.chunk_of(last) + 1 :])
    cut = tmp_path / "x.mcap"
    cut.write_bytes(small_log.read_bytes()[: end - 9])
    code = main(["why", str(cut)])
    said = capsys.readouterr()
    assert code == 3
    assert "was cut off at step" in said.out
    assert "height=1" in said.out


@pytest.mark.slow
def test_a_person_with_a_failed_plan_understands(failed_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(failed_log)]) == 0
    said = capsys.readouterr().out
    first, second, third, fourth = said.splitlines()[:4]
    assert first.startswith("fails_to_reach failed after")
    assert "right arm can't reach" in first
    assert "pick-up was tried 4 times" in second
    assert "right arm can't reach" in third
    assert "reachable_object(milk, pr2, r_gripper_tool_frame) said no" in fourth
    for told in (
        " in try_to_take",
        'ProcessModule.perform(MotionDesignator([("type", "pick-up")',
        "failure-handling(retries=3)",
        "milk at [1.72, 0.85,",
        "arm=left, pr2 at [0.65, 0.9]",
        "arm=right, pr2 at [0.65, 0.6]",
        "all of it is seen",
        "No pick-up succeeded before.",
        "detecting(object-type=milk) succeeded",
        "pycram-replay blame",
    ):
        assert told in said


@pytest.mark.slow
def test_why_gives_machines_the_same(failed: Log, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(failed.path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["failure"]["type"] == "Unreachable"
    assert [each["parameters"]["arm"] for each in told["tries"]] == ["left", "right", "left", "right"]
    assert [asked["name"] for asked in told["asked"]] == ["visible", "reachable_object", "blocking"]
    queries = [query.seq for query in failed.records(Query)]
    assert [asked["step"] for asked in told["asked"]] == queries[-3:]
    assert isinstance(failed[-1], Run)


@pytest.mark.slow
def test_why_shows_pictures(failed_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", str(failed_log), "--pictures", str(tmp_path / "pictures"), "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["pictures"]
    assert len(files) == 2
    for file in files:
        with Image.open(file) as picture:
            assert picture.size == (640, 480)
            assert len(picture.getcolors(1 << 20)) > 50


def try_another_way(file: Path) -> None:
    with recorder.record(file):
        try:
            with span("motion", "take", {"arm": "left"}):
                raise PlanFailure("too far")  # noqa: TRY301  as plans do
        except PlanFailure:
            with span("motion", "take", {"arm": "right"}):
                raise PlanFailure("too high")  # noqa: B904  as plans do


def test_what_was_dealt_with_is_no_cause(tmp_path: Path) -> None:
    with pytest.raises(PlanFailure):
        try_another_way(tmp_path / "x.mcap")
    with replay.open(tmp_path / "x.mcap") as log:
        found = why(log)
        assert found.task.parameters == {"arm": "right"}
        assert [error.message for error in found.raised] == ["too high"]
        assert len(found.tries) == 2


@pytest.mark.slow
def test_why_makes_the_best_of_a_damaged_recording(failed_log: Path, tmp_path: Path) -> None:
    content = failed_log.read_bytes()
    copy = tmp_path / "damaged.mcap"
    for number in range(30):
        damaged = bytearray(content)
        for place in range(number, len(damaged), len(damaged) // (2 + number % 7)):
            damaged[place] ^= 0xFF
        copy.write_bytes(damaged)
        assert main(["why", str(copy)]) in (1, 2, 3), number
