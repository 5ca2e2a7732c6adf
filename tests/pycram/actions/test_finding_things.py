"""Searching, perceiving, opening and closing, on a chest with a drawer; handing over, from one hand to the other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from pycram.actions import ObjectNotFound, perform, replaced
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import ActionDesignator, DesignatorError, MotionDesignator
from pycram.failures import (
    AccessFailed,
    BadArgument,
    GraspFailed,
    MissingPart,
    PerceptionError,
    ReasoningError,
    UnknownName,
)
from pycram.knowledge import believed, learn
from pycram.motions.process_module import execution_environment
from pycram.reasoning.grasping import fingers
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

BOX = '<{kind}><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></{kind}>'
DRAWER = {"0 0 0.72": "0.4 0.5 0.02", "-0.24 0 0.79": "0.02 0.54 0.16", "0.2 0 0.77": "0.02 0.5 0.1"} | {
    f"0 {side} 0.77": "0.4 0.02 0.1" for side in (-0.25, 0.25)
}
CHEST = """<robot name="chest"><link name="top">{top}</link><link name="drawer">{drawer}</link><link name="handle">{bar}</link>
<joint name="slide" type="prismatic"><parent link="top"/><child link="drawer"/><axis xyz="-1 0 0"/>
<limit lower="0" upper="0.35" effort="10" velocity="1"/></joint>
<joint name="hold" type="fixed"><parent link="drawer"/><child link="handle"/><origin xyz="-0.3 0 0.79"/></joint></robot>"""


def shapes(boxes: dict[str, str]) -> str:
    return "".join(
        BOX.format(kind=kind, xyz=xyz, size=size) for xyz, size in boxes.items() for kind in ("visual", "collision")
    )


class Room:
    """A PR2 before a chest; a cup stands on it, a spoon lies in its drawer."""

    def __init__(self, folder: Path) -> None:
        path = folder / "chest.urdf"
        top, bar = shapes({"0 0 0.9": "0.5 0.6 0.02"}), shapes({"0 0 0": "0.015 0.14 0.015"})
        path.write_text(CHEST.format(top=top, drawer=shapes(DRAWER), bar=bar))
        self.world = BulletWorld()
        self.world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        self.chest = Object("chest", "environment", str(path), [1.2, 0, 0])
        self.robot = self.world.robot = Object("pr2", "robot", "pr2.urdf", [0.1, 0, 0])
        self.cup = Object("cup", "cup", "cup.stl", [1.15, 0.1, 0.97])
        self.spoon = Object("spoon", "spoon", "spoon.stl", [1.15, 0, 0.75])
        perform(MotionDesignator(type="move-arm-joints", left_arm="park", right_arm="park"))
        self.world.settle()
        (self.container,) = self.chest.containers
        self.saved = self.world.save()


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Room]:
    room = Room(tmp_path_factory.mktemp("room"))
    yield room
    room.world.exit()


@pytest.fixture
def room(built: Room) -> Room:
    BulletWorld.current_bullet_world = built.world
    built.world.restore(built.saved)
    return built


def do(kind: str, **slots: object) -> object:
    return perform(ActionDesignator(type=kind, **slots))


@pytest.mark.slow
def test_what_stands_openly_is_found_from_where_the_robot_stands(room: Room) -> None:
    stood = room.robot.get_position()
    assert do("searching", object="cup") is room.cup
    assert believed("cup").source == "seen"
    assert room.robot.get_position() == stood
    assert room.chest.get_joint_position("slide") == pytest.approx(0, abs=0.001)


@pytest.mark.slow
def test_what_lies_in_a_drawer_is_found_by_opening_it(room: Room) -> None:
    assert do("searching", object="spoon") is room.spoon
    assert room.chest.get_joint_position("slide") > 0.1
    assert believed("spoon").position == pytest.approx(room.spoon.get_position())


@pytest.mark.slow
def test_what_is_nowhere_fails_with_where_it_was_looked_for(room: Room) -> None:
    learn({room.cup: room.cup.get_position_and_orientation()})
    room.cup.set_position([20, 20, 0.1])
    with pytest.raises(ObjectNotFound, match="no cup found: the robot looked where cup was seen, ") as failed:
        do("searching", object=room.cup)
    where = [place for place, _ in failed.value.looked]
    assert where[0] == "where cup was seen"
    assert f"in {room.container}" in where
    assert any(place.startswith("on ") for place in where)
    assert room.chest.get_joint_position("slide") == pytest.approx(0, abs=0.02)


@pytest.mark.slow
def test_what_was_moved_is_not_perceived_where_it_was(room: Room) -> None:
    do("searching", object="cup")
    room.cup.set_position([1.15, -0.1, 0.97])
    assert do("perceiving", object="cup") is room.cup
    assert believed("cup").position == pytest.approx(room.cup.get_position())
    room.cup.set_position([-3, 0, 0.1])
    with pytest.raises(PerceptionError, match="cup is behind the camera"):
        do("perceiving", object="cup")


@pytest.mark.slow
def test_a_drawer_is_opened_by_its_name_and_closed_by_its_handle(room: Room) -> None:
    do("opening", container=room.container)
    assert room.chest.get_joint_position("slide") > 0.1
    do("closing", container=room.chest, handle="handle")
    assert room.chest.get_joint_position("slide") == pytest.approx(0, abs=0.02)


def test_wrong_containers_say_what_there_is(room: Room) -> None:
    with pytest.raises((DesignatorError, UnknownName), match=room.container):
        do("opening", container=room.container[:-1])
    with pytest.raises(DesignatorError, match="a container, its name, or an Object"):
        do("closing", container=3)
    with pytest.raises(BadArgument, match=r"a container of .* \(none\), or also the slots 'joint' and 'handle'"):
        do("opening", container=room.cup)


def test_without_a_free_hand_nothing_is_opened(room: Room) -> None:
    for name, body in (("left", room.cup), ("right", room.spoon)):
        room.robot.attach(body, room.robot.description.arm(name).tool_frame)
    with pytest.raises(AccessFailed, match="the left gripper holds cup, the right gripper holds spoon"):
        do("opening", container=room.container)


@pytest.mark.slow
@pytest.mark.parametrize("environment", ["simulated", "continuous"])
def test_what_a_hand_holds_the_other_one_takes(room: Room, environment: str) -> None:
    perform(MotionDesignator(type="moving", target=[0.45, -0.1, 0]))
    perform(MotionDesignator(type="pick-up", object=room.cup, arm="left"))
    perform(MotionDesignator(type="moving", target=[-0.5, 0, 0]))
    with execution_environment(environment):
        assert do("handing-over", object="cup") is room.cup
    left, right = (room.robot.description.arm(name) for name in ("left", "right"))
    assert [held.carrier_link for held in room.robot.carried] == [right.tool_frame]
    assert fingers.sides_held(room.robot, right, room.cup) == 2
    assert fingers.sides_held(room.robot, left, room.cup) < 2
    assert believed("cup").source == "held"


def test_what_is_not_held_is_not_handed_over(room: Room) -> None:
    before = room.robot.get_joint_positions()
    with pytest.raises(ReasoningError, match="no hand of pr2 holds it"):
        do("handing-over", object=room.cup)
    with pytest.raises(GraspFailed, match="the left gripper doesn't hold it, so it can't be taken from there"):
        perform(MotionDesignator([("type", "pick-up"), ("object", room.cup), ("arm", "right"), ("from", "left")]))
    assert room.robot.get_joint_positions() == before


@pytest.mark.slow
def test_one_arm_has_none_to_hand_over_to(world: BulletWorld) -> None:
    world.robot = Object("panda", "robot", "panda.urdf")
    cup = Object("cup", "cup", "cup.stl", [0.5, 0, 0.5])
    (arm,) = world.robot.description.arms.values()
    world.robot.attach(cup, arm.tool_frame)
    with pytest.raises(MissingPart, match="no other arm with a gripper"):
        do("handing-over", object=cup)


@pytest.mark.slow
def test_where_something_is_in_the_way_of_handing_over_the_robot_turns_first(room: Room, tmp_path: Path) -> None:
    perform(MotionDesignator(type="moving", target=[0.45, -0.1, 0]))
    perform(MotionDesignator(type="pick-up", object=room.cup, arm="left"))
    perform(MotionDesignator(type="moving", target=[-1.5, 0, 0]))
    perform(MotionDesignator(type="move-arm-joints", left_arm="park", right_arm="park"))
    path = tmp_path / "board.urdf"
    path.write_text(f'<robot name="board"><link name="board">{shapes({"0 0 0.8": "0.5 1.5 0.3"})}</link></robot>')
    board = Object("board", "environment", str(path), [-0.83, 0, 0])
    try:
        assert do("handing-over", object="cup") is room.cup
        (held,) = room.robot.carried
        assert held.carrier_link == room.robot.description.arm("right").tool_frame
        forward = geometry.rotate(room.robot.get_orientation(), (1.0, 0.0, 0.0))
        assert forward[0] < 0.1, "it has turned away from the board"
    finally:
        board.remove()


@pytest.mark.slow
def test_what_a_door_hides_from_where_it_was_opened_is_looked_for_from_before_it(world: BulletWorld) -> None:
    world.set_gravity([0, 0, -9.8])
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    milk = Object("milk", "milk", "milk.stl", [1.42, -1.05, 0.87])
    world.robot = robot = Object("tiago_pro", "robot", "tiago_pro.urdf", [0.3, -1.2, 0])
    perform(MotionDesignator(type="move-arm-joints", left_arm="park", right_arm="park"))
    world.settle()

    def from_behind_the_door(
        container: str,
        joint: Any = None,
        handle: Any = None,
        arm: Any = None,
        distance: Any = None,
        place: Any = None,
        orientation: Any = None,
    ) -> str:
        if container != "fridge":
            raise AccessFailed(container, "it is locked")
        kitchen.set_joint_position(kitchen.containers["fridge"].joint, 1.2)
        robot.set_position_and_orientation([0.31, -1.26, 0], geometry.from_rpy(0, 0, 0.41))
        return "right"

    with replaced("opening", from_behind_the_door):
        assert do("searching", object="milk") is milk


@pytest.mark.slow
def test_a_drawer_is_opened_and_closed_from_the_place_that_is_given(room: Room) -> None:
    place = {"place": [0.27, -0.2, 0], "orientation": [0, 0, 0, 1]}
    for kind, value in (("opening", 0.35), ("closing", 0.0)):
        do(kind, container=room.container, **place)
        assert room.robot.get_position() == pytest.approx(place["place"])
        assert room.chest.get_joint_position("slide") == pytest.approx(value, abs=0.2)
