"""What a process module chose is on record: what was asked, the candidates, why each was rejected, the chosen one."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.designator import MotionDesignator
from pycram.failures import Blocked, ChangeRefused, GraspFailed, HandleUnreachable, PlaceFailed, Unreachable
from pycram.process_module import ProcessModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.rejections import NoRoom, OutOfReach, Rejection, Unfit
from recorder.records import Mutation, Query, Task, argument_values
from recorder.records.text import chosen_name, is_choice, rejection_lines

if TYPE_CHECKING:
    from pycram.bullet_world import BulletWorld
    from tests.conftest import MemorySink

DRAWER = {
    "drawer-joint": "sink_area_left_upper_drawer_main_joint",
    "drawer-handle": "sink_area_left_upper_drawer_handle",
}
PARK = {"left-arm": "park", "right-arm": "park"}


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def choices(sink: MemorySink) -> list[Query]:
    return [record for record in sink.of(Query) if record.HasField("chosen")]


def reasons(choice: Query) -> dict[str, dict[str, Any]]:
    """The data of the rejected by what they were rejected for."""
    return {each.reason: argument_values(each.data) for each in choice.candidates if each.reason}


@pytest.mark.slow
def test_each_process_module_says_what_it_chose(scene: BulletWorld, sink: MemorySink) -> None:
    milk, kitchen = scene.get_object("milk"), scene.get_object("kitchen")
    perform(type="move-arm-joints", **PARK)
    perform(type="moving", target=[0.65, 0.75, 0])
    perform(type="looking", object=milk)
    perform(type="detecting", object_type="milk")
    perform(type="world-state-detecting", object_type="milk")
    perform(type="pick-up", object=milk, arm="left")
    perform(type="place", object=milk, target=[1.35, 0.95, 0.98], arm="left")
    perform(type="move-tcp", target=[1.1, 0.85, 1.1], arm="left")
    perform(type="opening-gripper", gripper="left")
    perform(type="move-arm-joints", **PARK)
    perform(type="accessing", part_of=kitchen, arm="left", distance=0.1, **DRAWER)
    modules = {task.task: task.name for task in sink.of(Task) if task.kind == "process-module"}
    made = [(modules[choice.task], choice.name, bool(chosen_name(choice))) for choice in choices(sink)]
    assert made == [
        ("MoveJoints", "posture", True),
        ("Navigation", "base_pose", True),
        ("MoveHead", "gaze", True),
        ("Detecting", "best_seen", True),
        ("WorldStateDetecting", "nearest", True),
        ("PickUp", "grasp", True),
        ("Place", "placement", True),
        ("MoveTCP", "posture", True),
        ("MoveGripper", "finger_motion", True),
        ("MoveJoints", "posture", True),
        ("Accessing", "handle_path", True),
    ]
    steps = {record.seq: record for record in (*sink.of(Mutation), *sink.of(Query))}
    for choice in choices(sink):
        moved = [seq for seq, each in steps.items() if isinstance(each, Mutation) and each.task == choice.task]
        assert all(choice.seq < seq for seq in moved), "everything is chosen before anything moves"


def test_a_grasp_that_nothing_reaches_has_how_far_each_side_is_away(scene: BulletWorld, sink: MemorySink) -> None:
    milk = scene.get_object("milk")
    milk.set_position([1.75, 1, 0.95])
    with pytest.raises(Unreachable) as raised:
        perform(type="pick-up", object=milk, arm="right")
    (choice,) = choices(sink)
    assert choice.name == "grasp"
    assert choice.failure.type == "Unreachable"
    assert not choice.failure.traceback, "its task has it"
    assert chosen_name(choice) == ""
    away = reasons(choice)["OutOfReach"]["distance"]
    assert away == pytest.approx(raised.value.distance, abs=1e-6)
    (line,) = [line for line in rejection_lines(choice) if "out of reach" in line]
    assert f"by {away:.3f} m" in line


def test_a_grasp_whose_way_is_blocked_names_the_links(scene: BulletWorld, sink: MemorySink) -> None:
    milk, bowl = scene.get_object("milk"), scene.get_object("bowl")
    bowl.set_position([1.18, 1.0, 0.8835])
    with pytest.raises(Blocked) as raised:
        perform(type="pick-up", object=milk, arm="left", grasp="front")
    (choice,) = choices(sink)
    assert argument_values(choice.arguments)["side"] == "front"
    (pair, *_) = reasons(choice)["Touching"]["pairs"]
    first = raised.value.pairs[0]
    assert (pair["link"], pair["body"]) == (first.link, "bowl")
    assert pair["depth"] == pytest.approx(first.depth, abs=1e-6)


def test_a_grasp_that_lost_has_what_is_in_its_way_and_the_rest_was_not_tried(
    scene: BulletWorld, sink: MemorySink
) -> None:
    milk, bowl = scene.get_object("milk"), scene.get_object("bowl")
    bowl.set_position([1.18, 1.0, 0.8835])
    perform(type="pick-up", object=milk, arm="left")
    (choice,) = choices(sink)
    assert chosen_name(choice) == "top"
    by_reason = {each.reason: each for each in choice.candidates}
    assert list(by_reason["Touching"].names) == ["front"]
    assert by_reason["Touching"].count > 1, "the postures for it"
    assert [pair["body"] for pair in reasons(choice)["Touching"]["pairs"]] == ["bowl"]
    assert {"left", "right"} < set(by_reason["Untried"].names)


def test_what_is_too_big_for_the_fingers_has_its_width(scene: BulletWorld, sink: MemorySink) -> None:
    cereal = scene.get_object("cereal")
    with pytest.raises(GraspFailed, match="too big"):
        perform(type="pick-up", object=cereal, arm="right", grasp="left")
    (choice,) = choices(sink)
    misfit = reasons(choice)["Misfit"]
    low, high = cereal.get_AABB()
    assert misfit["width"] == pytest.approx(high[0] - low[0], abs=8e-3), "which the engine pads"
    assert misfit["width"] > misfit["most"]


def test_a_place_that_is_taken_rejects_all_orientations_for_one_reason(scene: BulletWorld, sink: MemorySink) -> None:
    milk = scene.get_object("milk")
    perform(type="pick-up", object=milk, arm="left")
    with pytest.raises(PlaceFailed) as taken:
        perform(type="place", object=milk, target=[1.3, 0.6, 0.95], arm="left")
    (pair,) = taken.value.pairs
    assert str(pair) == "milk in the left gripper would touch cereal"
    assert pair.depth > 0.01
    choice = choices(sink)[-1]
    (rejected,) = choice.candidates
    assert (rejected.count, rejected.reason, len(rejected.names)) == (12, "NoRoom", 4)
    assert "cereal is there already" in argument_values(rejected.data)["reason"]
    assert next(rejection_lines(choice)).startswith(f"{', '.join(rejected.names)} and 8 more: cereal")


def test_a_place_that_is_taken_names_the_links_that_are_there(scene: BulletWorld) -> None:
    milk = scene.get_object("milk")
    perform(type="pick-up", object=milk, arm="left")
    with pytest.raises(PlaceFailed, match="sink_area_surface of kitchen and cereal are there already") as taken:
        perform(type="place", object=milk, target=[1.3, 0.6, 0.87], arm="left")
    assert [(pair.body, pair.gripper) for pair in taken.value.pairs] == [("kitchen", "left"), ("cereal", "left")]


@pytest.mark.slow
def test_a_drawer_out_of_reach_has_each_grip_and_what_was_tried_instead(scene: BulletWorld, sink: MemorySink) -> None:
    scene.robot.set_position([0.1, 1.9, 0])
    kitchen = scene.get_object("kitchen")
    with pytest.raises(HandleUnreachable) as raised:
        perform(type="accessing", part_of=kitchen, arm="left", distance=0.3, **DRAWER)
    remedy, path = choices(sink)
    assert (remedy.name, path.name) == ("remedy", "handle_path")
    assert sum(each.count for each in path.candidates) == 6, "three places on the bar, each from the front and turned"
    assert reasons(path)["OutOfReach"]["distance"] <= raised.value.distance + 1e-6
    assert any("right arm from here" in each.names for each in remedy.candidates)


def test_what_was_chosen_from_is_not_on_record_twice(world: BulletWorld, sink: MemorySink) -> None:
    with choosing("side", world) as choice:
        choice.reject("front", OutOfReach(0.3))
        choice.reject("front", OutOfReach(0.2))
        choice.reject("left", OutOfReach(0.1), count=3)
        choice.reject("top", NoRoom("a lamp is there already"))
        choice.take("top")
    (record,) = choices(sink)
    assert [(list(each.names), each.count) for each in record.candidates] == [(["left", "front"], 4), (["top"], 0)]
    assert argument_values(record.candidates[0].data)["distance"] == 0.1, "of the one that came nearest"
    assert chosen_name(record) == "top"
    assert json.loads(record.answer_json) == "top"


def test_long_lists_say_how_many_were_left_out(world: BulletWorld, sink: MemorySink) -> None:
    with choosing("number", world) as choice:
        for number in range(30):
            choice.reject(str(number), Unfit(f"{number} is odd"))
    (record,) = choices(sink)
    assert len(record.candidates) == 9
    assert list(rejection_lines(record))[-1] == "22 more were rejected"
    assert record.chosen == -1


def test_reasons_of_a_users_own_are_recorded(world: BulletWorld, sink: MemorySink) -> None:
    class TooHot(Rejection):
        def data(self) -> dict[str, object]:
            return {"degrees": 80}

    with choosing("cup", world, fill="tea") as choice:
        choice.reject("left", TooHot())
    (record,) = choices(sink)
    assert list(rejection_lines(record)) == ["left: TooHot(degrees=80)"]


def test_nothing_changes_while_something_is_chosen(scene: BulletWorld, sink: MemorySink) -> None:
    milk = scene.get_object("milk")
    with pytest.raises(ChangeRefused, match="inside the query side"), choosing("side", scene):
        milk.set_position([0, 0, 1])
    assert not choices(sink)
    milk.set_position([1.3, 1, 1])


def test_without_a_recording_no_candidates_are_kept(world: BulletWorld) -> None:
    with choosing("side", world) as choice:
        choice.reject("front", OutOfReach(0.3))
        choice.take("top", height=1.0)
    assert not choice.wanted
    assert not choice._rejected
    assert choice.answer == "top"


LEFT = "l_gripper_tool_frame"


def test_what_a_plan_asks_has_what_was_considered_for_the_answer(scene: BulletWorld, sink: MemorySink) -> None:
    milk, bowl, robot = scene.get_object("milk"), scene.get_object("bowl"), scene.robot
    bowl.set_position([1.18, 1.0, 0.8835])
    assert btr.blocking(milk, robot, LEFT, grasp="front") == [bowl]
    free = btr.blocking(milk, robot, LEFT)
    blocked, least = sink.of(Query)
    assert chosen_name(blocked).startswith("front")
    assert chosen_name(least) == free.evidence["grasp"]
    assert any("would touch bowl" in line for line in rejection_lines(least))
    assert not is_choice(blocked), "a plan relies on it"


def test_a_pose_out_of_reach_has_by_how_much_and_one_in_reach_needs_no_reasons(
    scene: BulletWorld, sink: MemorySink
) -> None:
    robot = scene.robot
    far = btr.reachable([3, 1, 1], robot, LEFT)
    near = btr.reachable([1.3, 0.8, 1.1], robot, LEFT)
    assert (bool(far), bool(near)) == (False, True)
    no, yes = sink.of(Query)
    assert reasons(no)["OutOfReach"]["distance"] == pytest.approx(far.evidence["distance"], abs=1e-6)
    assert no.chosen == -1
    assert not yes.candidates
    assert not yes.HasField("chosen")


def test_of_postures_that_touch_something_each_says_what(scene: BulletWorld, sink: MemorySink) -> None:
    milk, bowl, robot = scene.get_object("milk"), scene.get_object("bowl"), scene.robot
    bowl.set_position([1.18, 1.0, 0.8835])
    assert not btr.reachable(milk, robot, LEFT, grasp="front", collision_free=True)
    (query,) = sink.of(Query)
    assert "bowl" in {pair["body"] for pair in reasons(query)["Touching"]["pairs"]}
    assert query.chosen == -1


def test_of_many_targets_those_out_of_reach_say_so_once(scene: BulletWorld, sink: MemorySink) -> None:
    targets = [[3, 1, 1], [1.3, 0.8, 1.1], *([3 + number, 1, 1] for number in range(1, 7))]
    btr.reachable_poses(targets, scene.robot, LEFT)
    (query,) = sink.of(Query)
    away, kept = query.candidates
    assert (away.reason, away.count, list(away.names)) == (
        "OutOfReach",
        7,
        ["target 1", *(f"target {n}" for n in (3, 4, 5))],
    )
    assert list(kept.names) == ["target 2"]
    assert query.chosen == 1
