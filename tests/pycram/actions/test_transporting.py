"""A robot brings things where they are wanted: it chooses arm, place to stand and place to put them, and carries on."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr, tasks
from pycram.actions import ActionFailed, perform, projecting, replaced
from pycram.actions.hands import placing as put_down
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import ActionDesignator, DesignatorError, LocationDesignator, MotionDesignator
from pycram.failures import MissingPart, NoPlace, NotDrivable, PlaceFailed, PlanFailure, ReasoningError, UnknownName
from pycram.knowledge import learn
from pycram.process_module import execution_environment

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.slow


def know(world: BulletWorld) -> None:
    """Teaches the robot where everything is."""
    learn({body: body.get_position_and_orientation() for body in world.objects if not body.fixed})


def stands_on(body: Object, furniture: Object, name: str) -> bool:
    """Whether an object stands on a surface by itself, safely."""
    (x, y, z), _ = furniture.surface_pose(name)
    width, depth = furniture.surface(name).size
    px, py, pz = body.get_position()
    on = abs(px - x) < width / 2 + 0.02 and abs(py - y) < depth / 2 + 0.02 and 0 < pz - z < 0.3
    return on and body.carrier is None and bool(btr.stable(body))


def transport(thing: str, target: object, **slots: object) -> object:
    return perform(ActionDesignator(type="transporting", object=thing, target=target, **slots))


def test_the_pr2_brings_the_milk_to_the_island_past_what_stands_before_it(shared_scene: BulletWorld) -> None:
    milk, bowl, kitchen = (shared_scene.get_object(name) for name in ("milk", "bowl", "kitchen"))
    know(shared_scene)
    milk.set_position([1.45, 0.8, 0.948])
    bowl.set_position([1.3, 0.78, 0.884])
    assert transport("milk", "island") is milk
    assert stands_on(milk, kitchen, "island")
    kinds = [node.name for node in tasks.tree().find(kind="action")]
    assert kinds.count("fetching") >= 1 <= kinds.count("delivering")


@pytest.mark.parametrize("by_name", [False, True])
def test_the_pr2_puts_the_cup_on_the_plate(by_name: bool) -> None:
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        Object("kitchen", "environment", "kitchen.urdf")
        plate = Object("plate", "plate", "plate.stl", [-0.8, 1.2, 0.87])
        cup = Object("cup", "cup", "cup.stl", [-0.8, 1.6, 0.9])
        world.robot = Object("pr2", "robot", "pr2.urdf", [0, 1, 0])
        world.settle()
        transport("cup", "plate" if by_name else LocationDesignator(on=plate))
        assert cup.carrier is None
        assert btr.supporting(plate, cup)
        assert btr.stable(cup)


def test_what_lies_in_a_closed_drawer_is_fetched_by_opening_it(shared_scene: BulletWorld) -> None:
    know(shared_scene)
    spoon, kitchen = shared_scene.get_object("spoon"), shared_scene.get_object("kitchen")
    perform(ActionDesignator(type="fetching", object="spoon"))
    assert spoon.carrier is shared_scene.robot
    assert kitchen.get_joint_position("sink_area_left_upper_drawer_main_joint") > 0.1


def test_what_was_opened_for_a_thing_is_closed_when_it_is_brought_unless_that_is_not_wanted(
    shared_scene: BulletWorld,
) -> None:
    know(shared_scene)
    spoon, kitchen = shared_scene.get_object("spoon"), shared_scene.get_object("kitchen")
    joint = "sink_area_left_upper_drawer_main_joint"
    saved = shared_scene.save()
    transport("spoon", "island")
    assert stands_on(spoon, kitchen, "island")
    assert kitchen.get_joint_position(joint) < 0.02
    shared_scene.restore(saved)
    transport("spoon", "island", close=False)
    assert kitchen.get_joint_position(joint) > 0.1


def test_what_falls_when_it_is_put_down_is_taken_again(shared_scene: BulletWorld) -> None:
    know(shared_scene)
    milk, kitchen = shared_scene.get_object("milk"), shared_scene.get_object("kitchen")
    was = milk.get_position_and_orientation()
    dropped: list[object] = []

    def clumsy(object: Object, target: object, orientation: object = None) -> object:  # noqa: A002
        if not dropped:
            dropped.append(target)
            shared_scene.robot.detach(object)
            object.set_position_and_orientation(*was)
            raise PlaceFailed(object.name, object.get_position(), "it leans")
        return put_down(object, target, orientation)

    with replaced("placing", clumsy):
        transport("milk", LocationDesignator(on="island"))
    assert stands_on(milk, kitchen, "island")
    taken = tasks.tree().find(kind="action", name="fetching")[-2:]
    assert len(dropped) == 1
    assert all(each.status is tasks.State.SUCCEEDED for each in taken)


def test_an_imagined_transport_comes_true_and_is_the_same_again(shared_scene: BulletWorld) -> None:
    know(shared_scene)
    saved = shared_scene.save()
    ends = []
    for _ in range(2):
        with projecting(budget=2):
            transport("cereal", LocationDesignator(on="island", side="left"))
        assert stands_on(shared_scene.get_object("cereal"), shared_scene.get_object("kitchen"), "island")
        ends.append(shared_scene.get_object("cereal").get_position_and_orientation())
        shared_scene.restore(saved)
    (position, _), (again, _) = ends
    assert position == pytest.approx(again, abs=1e-3)  # the contacts of what stands aren't restored


def test_what_is_told_wrong_moves_nothing(shared_scene: BulletWorld) -> None:
    know(shared_scene)
    before = shared_scene.save().command
    with pytest.raises(UnknownName, match="no surface 'iland'; did you mean island"):
        transport("milk", "iland")
    with pytest.raises(DesignatorError, match="slots on and in exclude each other"):
        transport("milk", LocationDesignator(on="island", in_="sink left upper drawer"))
    with pytest.raises(DesignatorError, match="missing slot position or on or in"):
        transport("milk", LocationDesignator(side="left"))
    with pytest.raises(DesignatorError, match="one of front, back, left, right"):
        transport("milk", LocationDesignator(on="island", side="above"))
    with pytest.raises(DesignatorError, match="a place for an object: a position"):
        transport("milk", LocationDesignator(near="cereal"))
    with pytest.raises(DesignatorError, match="an object that a gripper can take"):
        transport("environment", "island")
    with pytest.raises(DesignatorError, match="a place where the robot can stand"):
        perform(ActionDesignator(type="navigating", target="island"))
    assert shared_scene.save().command == before


def test_what_has_no_place_at_the_target_is_not_taken(shared_scene: BulletWorld) -> None:
    know(shared_scene)
    before = shared_scene.save().command
    with pytest.raises(NoPlace) as raised:
        transport("milk", LocationDesignator(in_="sink left upper drawer"))  # closed, and lower than the milk
    assert raised.value.last == "clearance"
    with pytest.raises(NoPlace) as raised:
        transport("milk", LocationDesignator(on="island", near=[5, 5]))
    assert raised.value.last == "near"
    with pytest.raises(NoPlace, match="fridge, which is closed: open it first"):
        transport("milk", LocationDesignator(in_="fridge"))
    with pytest.raises(NoPlace, match="sink left upper drawer, which is closed: open it first"):
        transport("spoon", LocationDesignator(in_="sink left upper drawer"))
    with pytest.raises(NoPlace, match="sink left upper drawer, which is closed: open it first"):
        transport("spoon", list(shared_scene.get_object("spoon").get_position()))  # where it is
    with pytest.raises(PlaceFailed, match="there is no support within"):
        transport("milk", [-0.7, 1.0, 1.4])
    assert shared_scene.save().command == before


def test_the_robot_drives_near_what_it_is_to_be_near(shared_scene: BulletWorld) -> None:
    robot = shared_scene.robot
    assert robot is not None
    robot.set_position([0, 0, 0])
    perform(ActionDesignator(type="navigating", target=LocationDesignator(near=[0.3, -2.5])))
    assert math.dist(robot.get_position()[:2], (0.3, -2.5)) < 2.2
    there = robot.get_position()
    perform(ActionDesignator(type="navigating", target=LocationDesignator(near=[0.3, -2.5], away_from=there)))
    assert math.dist(robot.get_position()[:2], there[:2]) >= 0.4


def test_the_camera_is_turned_to_a_surface_by_its_name(shared_scene: BulletWorld) -> None:
    robot, kitchen = shared_scene.robot, shared_scene.get_object("kitchen")
    assert robot is not None
    perform(ActionDesignator(type="looking", target="counter"))
    named = robot.get_joint_positions()
    perform(ActionDesignator(type="looking", target="hob"))
    assert robot.get_joint_positions() != named
    perform(ActionDesignator(type="looking", target=list(kitchen.surface_pose("counter")[0])))
    assert robot.get_joint_positions() == pytest.approx(named, abs=0.01)


def test_a_motion_drives_to_places_that_a_designator_stands_for(shared_scene: BulletWorld) -> None:
    milk, robot = shared_scene.get_object("milk"), shared_scene.robot
    assert robot is not None
    moving = MotionDesignator(type="moving", target=LocationDesignator(reachable_for=milk, arm="right"))
    first, second = moving.reference(), moving.next_solution()
    assert second is not None
    assert math.dist(first["target"], second.reference()["target"]) > 0.01
    perform(second)
    assert list(robot.get_position()) == pytest.approx(second.reference()["target"])
    perform(ActionDesignator(type="picking-up", object=milk, arm="right"))
    assert milk.carrier is robot


def test_a_surface_with_places_only_right_beside_a_point_has_none_away_from_it(shared_scene: BulletWorld) -> None:
    (x, y, _), _ = shared_scene.get_object("kitchen").surface_pose("top of the fridge")
    milk = shared_scene.get_object("milk")
    with pytest.raises(NoPlace, match=r"no place for milk on top of the fridge: .* by away-from"):
        LocationDesignator(on="top of the fridge", away_from=[x, y], for_=milk).reference()


def test_what_can_t_be_reached_is_told_with_all_that_was_tried(shared_scene: BulletWorld) -> None:
    milk = shared_scene.get_object("milk")
    assert shared_scene.robot is not None
    shared_scene.robot.set_position([-0.2, -0.3, 0])
    with pytest.raises(ActionFailed) as raised:
        perform(ActionDesignator(type="picking-up", object=milk))
    assert [each.choice["arm"] for each in raised.value.tried] == ["left", "right"]
    with pytest.raises(PlanFailure, match="doesn't hold it"):
        perform(ActionDesignator(type="placing", object=milk, target="island"))


@pytest.fixture
def table() -> Iterator[BulletWorld]:
    """A Panda that is bolted to a table, with milk and bowl."""
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        Object("table", "environment", "table.urdf")
        world.robot = robot = Object("panda", "robot", "panda.urdf", [0, 0, 0.72])
        assert robot.description is not None
        robot.set_joint_positions(next(iter(robot.description.arms.values())).posture("park"))
        Object("milk", "milk", "milk.stl", [0.62, -0.25, 0.83])
        Object("bowl", "bowl", "bowl.stl", [0.46, -0.25, 0.76])
        world.simulate(0.5)
        yield world


@pytest.mark.parametrize("environment", ["simulated", "continuous"])
def test_a_bolted_arm_brings_things_to_the_other_side_of_its_table(table: BulletWorld, environment: str) -> None:
    milk, furniture = table.get_object("milk"), table.get_object("table")
    with execution_environment(environment):
        transport("milk", LocationDesignator(on=furniture, side="left"))
    assert stands_on(milk, furniture, next(iter(furniture.surfaces)))
    assert milk.get_position()[1] > 0.0  # the robot looks along x


def test_a_bolted_arm_doesn_t_drive_and_has_no_second_hand(table: BulletWorld) -> None:
    with pytest.raises(NotDrivable, match=r"\[1.000, 0.000, 0.000\]: the robot's base is fixed"):
        perform(ActionDesignator(type="navigating", target=[1, 0, 0]))
    know(table)
    perform(ActionDesignator(type="picking-up", object="milk"))
    with pytest.raises(MissingPart):
        perform(ActionDesignator(type="handing-over", object="milk"))
    with pytest.raises(ReasoningError, match="no arm is free"):
        perform(ActionDesignator(type="picking-up", object="bowl"))


@pytest.mark.costly
def test_tiago_pro_brings_the_milk_to_the_island() -> None:
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        kitchen = Object("kitchen", "environment", "kitchen.urdf")
        milk = Object("milk", "milk", "milk.stl", [1.3, 1, 0.947])
        world.robot = Object("tiago_pro", "robot", "tiago_pro.urdf")
        world.simulate(0.2)
        know(world)
        transport("milk", "island")
        assert stands_on(milk, kitchen, "island")
