"""A motion that is refused for a collision names the links that would meet, in message, data and record."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import Object
from pycram.designator import MotionDesignator
from pycram.failures import Blocked, CollisionPair, InCollision, PostureInCollision, Unreachable
from pycram.process_module import ProcessModule
from recorder.records import Task

if TYPE_CHECKING:
    from pycram.bullet_world import BulletWorld
    from tests.conftest import MemorySink

SURFACE = "sink_area_surface"


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def recorded_pairs(sink: MemorySink) -> list[dict[str, object]]:
    task = [r for r in sink.records if isinstance(r, Task) and r.HasField("failure")][-1]
    (pairs,) = [argument.json for argument in task.failure.data if argument.name == "pairs"]
    return json.loads(pairs)


def test_what_the_robot_holds_is_named_by_its_gripper(scene: BulletWorld, sink: MemorySink) -> None:
    milk = scene.get_object("milk")
    perform(type="pick-up", object=milk, arm="left")
    perform(type="move-tcp", target=[1.1, 0.9, 1.2], orientation=[0, 0, 0, 1], arm="left")
    with pytest.raises(Blocked, match=f"milk in the left gripper would touch {SURFACE} of kitchen") as raised:
        perform(type="move-tcp", target=[1.3, 0.9, 0.89], orientation=[0, 0, 0, 1], arm="left")
    assert isinstance(raised.value, Unreachable), "who handles what is out of reach handles this too"
    assert raised.value.distance is None
    assert "kitchen" in raised.value.bodies
    held = [pair for pair in raised.value.pairs if pair.mover == "milk"]
    assert [(pair.link, pair.body, pair.body_link, pair.gripper) for pair in held] == [("", "kitchen", SURFACE, "left")]
    assert held[0].depth > 0.01
    assert recorded_pairs(sink) == [pair.__record__() for pair in raised.value.pairs]


def test_the_robots_own_link_is_named(scene: BulletWorld, sink: MemorySink) -> None:
    with pytest.raises(InCollision, match=r"can't be at .*: \w+ would touch \w+ of kitchen, ") as moving:
        perform(type="moving", target=[1.2, 0.7, 0])
    by_body = {pair.body: pair for pair in moving.value.pairs}
    assert list(by_body) == moving.value.bodies
    assert by_body["kitchen"].body_link in scene.get_object("kitchen").links
    assert {pair.link for pair in moving.value.pairs} <= set(scene.robot.links)
    assert {(pair.mover, pair.gripper) for pair in moving.value.pairs} == {("pr2", "")}
    assert recorded_pairs(sink) == [pair.__record__() for pair in moving.value.pairs]
    with pytest.raises(PostureInCollision, match=r"left arm can't take that posture: l_\w+ would touch") as posing:
        perform(**{"type": "move-arm-joints", "left-arm": [0, 0.6, 0, -0.3, 0, -0.2, 0]})
    assert posing.value.pairs[0].link.startswith("l_")


def test_out_of_reach_is_not_in_the_way(scene: BulletWorld) -> None:
    with pytest.raises(Unreachable) as far:
        perform(type="move-tcp", target=[3, 0, 1])
    assert not isinstance(far.value, Blocked)
    milk, bowl = scene.get_object("milk"), scene.get_object("bowl")
    x, y, z = milk.get_position()
    bowl.set_position([x - 0.12, y, z - 0.02])
    with pytest.raises(Blocked, match=r"l_\w+ would touch bowl") as near:
        perform(type="pick-up", object=milk, arm="left", grasp="front")
    assert near.value.bodies == ["bowl"]
    evidence = btr.blocking(milk, scene.robot, "l_gripper_tool_frame", grasp="front").evidence
    assert evidence["obstacles"]["bowl"]["pair"] == near.value.pairs[0]


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        (
            CollisionPair("milk", "", "kitchen", "island", 0.1, "left"),
            "milk in the left gripper would touch island",
        ),
        (CollisionPair("pr2", "l_forearm_link", "cup", ""), "l_forearm_link would touch cup"),
        (CollisionPair("pr2", "l_forearm_link", "pr2", "base_link"), "its own l_forearm_link would touch base_link"),
    ],
)
def test_pairs_in_words(pair: CollisionPair, words: str) -> None:
    assert str(pair).startswith(words)


def test_a_posture_in_the_robots_own_body_is_refused(scene: BulletWorld) -> None:
    robot = scene.robot
    base = robot.get_position()
    joints = robot.get_joint_positions()
    with pytest.raises(Blocked, match=r"its own l_\w+ would touch torso_lift_link") as blocked:
        perform(type="move-tcp", target=[base[0], base[1], 0.9], arm="left")
    assert {pair.body for pair in blocked.value.pairs} == {robot.name}
    inside = [-0.31, 1.1, 2.18, -1.73, -0.03, -1.15, 0.94]
    with pytest.raises(PostureInCollision, match="its own l_") as refused:
        perform(type="move-arm-joints", left_arm=inside)
    assert refused.value.bodies == [robot.name]
    assert robot.get_joint_positions() == joints
    robot.set_joint_positions(dict(zip(robot.description.arm("left").joints, inside, strict=True)))
    perform(type="move-arm-joints", left_arm="park")  # out of there it gets


def test_what_the_other_hand_holds_is_in_the_way(scene: BulletWorld, sink: MemorySink) -> None:
    milk, robot = scene.get_object("milk"), scene.robot
    perform(type="pick-up", object=milk, arm="right")
    perform(type="move-tcp", target=[1.15, 0.65, 1.1], orientation=[0, 0, 0, 1], arm="right")
    x, y, z = milk.get_position()
    before = robot.get_joint_positions()
    with pytest.raises(Blocked, match=r"l_gripper_\w+ would touch milk") as raised:
        perform(type="move-tcp", target=[x, y, z], orientation=[0, 0, 0, 1], arm="left")
    assert "milk" in raised.value.bodies
    assert recorded_pairs(sink) == [pair.__record__() for pair in raised.value.pairs]
    assert robot.get_joint_positions() == before
    perform(type="move-tcp", target=[x, y + 0.3, z], orientation=[0, 0, 0, 1], arm="left")  # beside it there is room


def test_what_a_hand_holds_meets_the_other_hand(scene: BulletWorld) -> None:
    robot = scene.robot
    forward = [0, 0, 0, 1]
    perform(type="move-tcp", target=[1.15, 0.95, 1.1], orientation=forward, arm="left")
    perform(type="move-tcp", target=[1.1, 0.4, 1.1], orientation=forward, arm="right")
    x, y, z = robot.get_link_position("r_gripper_tool_frame")
    tray = Object("tray", "tray", "milk.stl", [x, y + 0.3, z])  # it sticks out of the hand to the left
    robot.attach(tray, "r_gripper_tool_frame")
    before = robot.get_joint_positions()
    with pytest.raises(Blocked, match=r"tray in the right gripper would touch l_gripper_\w+ of pr2") as raised:
        perform(type="move-tcp", target=[1.15, 0.65, 1.1], orientation=forward, arm="right")
    held = [pair for pair in raised.value.pairs if pair.mover == "tray"]
    assert {(pair.body, pair.gripper) for pair in held} == {(robot.name, "right")}
    assert robot.get_joint_positions() == before
    perform(type="move-arm-joints", left_arm="park")
    perform(type="move-tcp", target=[1.15, 0.65, 1.1], orientation=forward, arm="right")


def test_what_a_hand_holds_meets_the_robots_own_trunk(scene: BulletWorld, sink: MemorySink) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    inside = [-0.61, 1.04, 0.78, -0.77, 2.52, -1.57, 3.1]
    perform(type="pick-up", object=milk, arm="left")
    before = robot.get_joint_positions()
    words = r"left arm can't take that posture: milk in the left gripper would touch base_link of pr2"
    with pytest.raises(PostureInCollision, match=words) as raised:
        perform(type="move-arm-joints", left_arm=inside)
    assert [(pair.mover, pair.body, pair.body_link) for pair in raised.value.pairs] == [("milk", "pr2", "base_link")]
    assert raised.value.pairs[0].depth > 0.03
    assert recorded_pairs(sink) == [pair.__record__() for pair in raised.value.pairs]
    assert robot.get_joint_positions() == before
    perform(type="move-arm-joints", left_arm="park")
    robot.detach(milk)
    milk.set_position([1.3, 1, 3])
    perform(type="move-arm-joints", left_arm=inside)  # the empty hand may


@pytest.mark.slow
def test_a_posture_that_a_low_torso_is_in_the_way_of_says_at_which_height_it_would_do(world: BulletWorld) -> None:
    """TIAGo Pro's elbows would be in its base; drawers near the floor leave its torso down there."""
    robot = world.robot = Object("tiago_pro", "robot", "tiago_pro.urdf")
    torso = robot.description.torso
    perform(type="move-tcp", target=[0.9, 0.3, 1.0], arm="left")
    robot.set_joint_position(torso.joint, 0.0)
    with pytest.raises(
        PostureInCollision,
        match=r"would touch base_link.*; with torso_lift_joint at 0\.3 m the robot can take the posture$",
    ) as low:
        perform(type="move-arm-joints", left_arm="park", right_arm="park")
    assert low.value.torso == (torso.joint, torso.default)
    robot.set_joint_position(*low.value.torso)
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    shelf = Object("shelf", "shelf", "milk.stl", robot.get_link_position(robot.description.arm("left").tool_frame))
    perform(type="move-tcp", target=[0.9, 0.3, 1.0], arm="left")
    with pytest.raises(PostureInCollision, match=r"stays where it is$") as raised:
        perform(type="move-arm-joints", left_arm="park")
    assert raised.value.torso is None, "it is at that height"
    assert shelf.name in raised.value.bodies
