"""Process modules of the PR2: exact results, and no change after a failure."""

from __future__ import annotations

import math
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from pycram import process_module
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.failures import (
    AccessFailed,
    BadArgument,
    BranchesFailed,
    GraspFailed,
    InCollision,
    LookingFailed,
    NotDrivable,
    PerceptionError,
    PlaceFailed,
    PostureInCollision,
    Unreachable,
)
from pycram.language import State, par, timeout
from pycram.motions import process_module as registry
from pycram.motions.resources import Deadlock
from pycram.process_module import NoProcessModule, ProcessModule
from recorder import geometry
from recorder.records import Task
from tests.pycram.language.gates import Meeting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.conftest import MemorySink

DRAWER = "sink_area_left_upper_drawer_main_joint"
HANDLE = "sink_area_left_upper_drawer_handle"


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def snapshot(world: BulletWorld) -> list[object]:
    return [(b.get_position_and_orientation(), b.get_joint_positions()) for b in world.objects]


def gaze_error(robot: Object, point: list[float]) -> float:
    frame = robot.get_link_position_and_orientation("wide_stereo_optical_frame")
    x, y, z = geometry.transform(geometry.invert(frame), point)
    return math.degrees(math.atan2(math.hypot(x, y), z))


def test_moving_refuses_collisions_and_changes_nothing(scene: BulletWorld) -> None:
    before = snapshot(scene)
    with pytest.raises(InCollision, match="kitchen") as raised:
        perform(type="moving", target=[1.2, 0.7, 0])
    assert "kitchen" in raised.value.bodies
    assert snapshot(scene) == before
    perform(type="moving", target=[0.2, 0.3, 0], orientation=[0, 0, 0.6, 0.8])
    assert scene.robot.get_position() == pytest.approx([0.2, 0.3, 0])


def test_attached_objects_collide_too(scene: BulletWorld) -> None:
    perform(type="pick-up", object=scene.get_object("milk"), arm="left")
    with pytest.raises(InCollision):  # the arm is stretched out over the counter
        perform(type="moving", target=[0.9, 0.7, 0])


@pytest.mark.parametrize("base", [([0.2, 0, 0], 0.3), ([-0.3, 1, 0], 3.1), ([0.5, -1.2, 0], -0.7)])
def test_looking_points_the_camera(scene: BulletWorld, base: tuple[list[float], float]) -> None:
    robot = scene.robot
    robot.set_position_and_orientation(base[0], geometry.from_rpy(0, 0, base[1]))
    for forward, unrecorded, height in ((1, 0, 0.9), (1, 0.8, 0.3), (2, -1, 1.5)):
        point = list(geometry.transform(robot.get_position_and_orientation(), (forward, unrecorded, height)))
        perform(type="looking", target=point)
        assert gaze_error(robot, point) < 1.0
    before = snapshot(scene)
    with pytest.raises(LookingFailed):
        perform(type="looking", target=[*robot.get_position()[:2], 5])
    assert snapshot(scene) == before


def test_detecting_respects_view_and_occlusion(scene: BulletWorld) -> None:
    milk, cereal = scene.get_object("milk"), scene.get_object("cereal")
    perform(type="looking", object=milk)
    assert perform(type="detecting", object="milk") is milk
    perform(type="looking", target=[0.7, 3.0, 1.0])
    with pytest.raises(PerceptionError, match="out of view"):
        perform(type="detecting", object_type="milk")
    assert perform(type="world-state-detecting", object_type="milk") is milk
    x, y, _ = milk.get_position()
    cereal.set_position_and_orientation([x - 0.1, y - 0.02, 0.99], [0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    perform(type="looking", object=milk)
    with pytest.raises(PerceptionError, match="behind cereal"):
        perform(type="detecting", object_type="milk")
    with pytest.raises(PerceptionError, match="the world has none"):
        perform(type="world-state-detecting", object_type="toaster")


@pytest.mark.parametrize(("name", "arm"), [("milk", "left"), ("cereal", "right"), ("bowl", "right")])
def test_pick_up_brings_the_tool_to_the_object_within_limits(scene: BulletWorld, name: str, arm: str) -> None:
    robot, body = scene.robot, scene.get_object(name)
    other = {"left": "right", "right": "left"}[arm]
    still = {j: robot.get_joint_position(j) for j in robot.description.arm(other).joints}
    stood = body.get_position_and_orientation()
    perform(type="pick-up", object=body, arm=arm)
    assert body.get_position_and_orientation() == stood
    assert robot.attachments[body].carrier_link == robot.description.arm(arm).tool_frame
    low, high = body.get_AABB()
    tool = robot.get_link_position(robot.description.arm(arm).tool_frame)
    assert all(a - 0.05 < x < b + 0.05 for a, x, b in zip(low, tool, high, strict=True))
    for joint, value in robot.get_joint_positions().items():
        lower, upper = robot.joint_limits(joint)
        assert lower - 1e-6 <= value <= upper + 1e-6, joint
    assert {j: robot.get_joint_position(j) for j in still} == still
    with pytest.raises(
        GraspFailed, match=rf"the {arm} arm already holds .*; to hand it over, place it .* the {other} arm"
    ) as held:
        perform(type="pick-up", object=body, arm=other)
    assert f"{robot.name}.attach({body.name}, '{robot.description.arm(other).tool_frame}')" in str(held.value)
    perform(type="move-arm-joints", **{f"{arm}-arm": "park"})
    assert body.carrier is robot


def test_unreachable_targets_change_nothing(scene: BulletWorld) -> None:
    milk = scene.get_object("milk")
    milk.set_position([1.75, 1, 0.95])
    before = snapshot(scene)
    with pytest.raises(Unreachable) as raised:
        perform(type="pick-up", object=milk, arm="right")
    assert 0.05 < raised.value.distance < 1
    with pytest.raises(Unreachable):
        perform(type="move-tcp", target=[3, 0, 1])
    with pytest.raises(PlaceFailed, match="doesn't hold"):
        perform(type="place", object=milk, target=[1.3, 1, 0.95], arm="left")
    assert snapshot(scene) == before


def test_move_tcp_reaches_position_and_orientation(scene: BulletWorld) -> None:
    robot = scene.robot
    target, turn = [1.1, 0.85, 1.1], [0, 0.7071068, 0, 0.7071068]
    perform(type="move-tcp", target=target, orientation=turn, arm="left")
    position, orientation = robot.get_link_position_and_orientation("l_gripper_tool_frame")
    assert math.dist(position, target) < 0.01
    assert math.degrees(geometry.angle(orientation, turn)) < 2


@pytest.mark.slow
def test_place_sets_down_upright_at_the_target(scene: BulletWorld) -> None:
    milk = scene.get_object("milk")
    perform(type="pick-up", object=milk, arm="left")
    perform(type="place", object=milk, target=[1.35, 0.95, 0.98], arm="left")
    assert math.dist(milk.get_position(), [1.35, 0.95, 0.947]) < 0.005
    assert geometry.rotate(milk.get_orientation(), (0, 0, 1))[2] > 0.999
    assert milk.carrier is None
    perform(type="move-arm-joints", left_arm="park")
    perform(type="pick-up", object=milk, arm="left")
    before = snapshot(scene)
    with pytest.raises(PlaceFailed, match="there is no support within"):
        perform(type="place", object=milk, target=[0.9, 1.1, 1.0], arm="left")
    assert snapshot(scene) == before
    assert milk.carrier is scene.robot


@pytest.mark.slow
def test_accessing_moves_the_gripper_with_the_handle_and_the_spoon_with_the_drawer(scene: BulletWorld) -> None:
    kitchen, spoon, robot = scene.get_object("kitchen"), scene.get_object("spoon"), scene.robot
    before = snapshot(scene)
    slots = {"type": "accessing", "drawer-joint": DRAWER, "drawer-handle": HANDLE, "part-of": kitchen, "arm": "left"}
    with pytest.raises(AccessFailed, match=r"its upper limit is 0\.48"):
        perform(**slots, distance=0.6)
    assert snapshot(scene) == before
    lay = spoon.get_position()
    perform(**slots, distance=0.3)
    assert kitchen.get_joint_position(DRAWER) == pytest.approx(0.3)
    assert spoon.get_position()[0] == pytest.approx(lay[0] - 0.3, abs=1e-3)
    at, bar = robot.get_link_position("l_gripper_tool_frame"), kitchen.get_link_position(HANDLE)
    assert math.dist(at[::2], bar[::2]) < 0.03
    assert abs(at[1] - bar[1]) < 0.3, "somewhere on the bar, which is 0.7 m long"


def test_grippers_open_and_close(scene: BulletWorld) -> None:
    joints = scene.robot.description.arm("left").gripper.joints
    perform(type="opening-gripper", gripper="left")
    assert {scene.robot.get_joint_position(j) for j in joints} == {0.548}
    perform(type="closing-gripper", gripper="left")
    assert {scene.robot.get_joint_position(j) for j in joints} == {0.0}


def fail_twice() -> None:
    with par:
        perform(type="moving", target=[1.2, 0.7, 0])
        perform(type="looking", target=[0.65, 0.7, 9])


def test_a_block_fails_with_all_its_failures_and_leaves_no_thread(scene: BulletWorld, sink: MemorySink) -> None:
    threads = threading.active_count()
    with pytest.raises(BranchesFailed) as raised:
        fail_twice()
    assert [type(failure) for failure in raised.value.failures] == [InCollision, LookingFailed]
    failures: list[BaseException] = []
    with par(failures) as s:
        perform(type="moving", target=[1.2, 0.7, 0])
    assert s.state is State.FAILED
    assert [type(failure) for failure in failures] == [InCollision]
    with pytest.raises(ZeroDivisionError), par as s:
        s(lambda: 1 / 0)
    assert par(lambda: 1, lambda: 2) == [1, 2]
    assert threading.active_count() == threads
    tasks = [record for record in sink.records if isinstance(record, Task)]
    started = {task.task for task in tasks if task.phase == Task.STARTED}
    assert started == {task.task for task in tasks if task.phase == Task.FINISHED}
    perform(type="moving", target=[0.3, 0.7, 0])  # the modules are free again


@contextmanager
def fresh_registrations() -> Iterator[None]:
    """Forget registrations that are made in the block."""
    registered = dict(registry._registered)
    try:
        yield
    finally:
        registry._registered.clear()
        registry._registered.update(registered)


def test_a_command_without_process_module_is_refused(scene: BulletWorld) -> None:
    def resolver(designator: MotionDesignator) -> list[dict[str, object]]:
        return [{"cmd": "dance"}] if designator.type == "dancing" else []

    class Dancing(ProcessModule):
        def _execute(self, designator: MotionDesignator) -> str:
            return "danced"

    with MotionDesignator.resolvers.added(resolver):
        with pytest.raises(NoProcessModule, match="dance"):
            perform(type="dancing")
        dancing = Dancing()
        with ProcessModule.resolvers.added(lambda designator: dancing if designator.type == "dancing" else None):
            assert perform(type="dancing") == "danced"
        process_module.register("pr2", "ballroom", {"dance": dancing})
        with process_module.execution_environment("ballroom"):
            assert perform(type="dancing") == "danced"
            with pytest.raises(NoProcessModule, match="ballroom"):
                perform(type="opening-gripper", gripper="left")


def test_registered_modules_are_added_to_the_robot_s_own_unless_they_replace_them(scene: BulletWorld) -> None:
    def resolver(designator: MotionDesignator) -> list[dict[str, object]]:
        return [{"cmd": "wipe"}] if designator.type == "wiping" else []

    class Wiping(ProcessModule):
        def _execute(self, designator: MotionDesignator) -> str:
            return "wiped"

    with MotionDesignator.resolvers.added(resolver), fresh_registrations():
        process_module.register("pr2", "simulated", {"wipe": Wiping()})
        process_module.register("pr2", "simulated", {"looking": Looking("seen")})
        assert perform(type="wiping") == "wiped"
        assert perform(type="looking", target=[1, 0, 1]) == "seen", "it takes the place of PyCRAM's own"
        perform(type="opening-gripper", gripper="left")
        process_module.register("pr2", "simulated", {"wipe": Wiping()}, replace=True)
        with pytest.raises(NoProcessModule, match="modules exist for wipe;"):
            perform(type="opening-gripper", gripper="left")


class Looking(ProcessModule):
    """Has a beginning of its own, which doesn't call that of process modules."""

    def __init__(self, result: str) -> None:
        self.result = result

    def _execute(self, designator: MotionDesignator) -> str:
        return self.result


def test_a_process_module_needs_no_beginning_of_its_base(scene: BulletWorld) -> None:
    process_module.register("pr2", "attic", {"looking": Looking("seen")})
    with process_module.execution_environment("attic"):
        assert perform(type="looking", target=[1, 0, 1]) == "seen"


@pytest.mark.parametrize("modules", [{"looking": Looking}, {1: Looking("seen")}, {"looking": print}, [], None])
def test_what_is_no_process_module_is_not_registered(modules: object) -> None:
    with pytest.raises(BadArgument, match="process modules by cmd"):
        process_module.register("pr2", "cellar", modules)


def test_a_motion_may_look_ahead_in_another_world(scene: BulletWorld) -> None:
    class LookingAhead(ProcessModule):
        def _execute(self, designator: MotionDesignator) -> list[float]:
            with process_module.execution_environment("simulated"), BulletWorld() as ahead:
                ahead.robot = Object("pr2", "robot", "pr2.urdf")
                perform(type="moving", target=[0.3, 0, 0])
                return ahead.robot.get_position()

    before = scene.robot.get_position()
    process_module.register("pr2", "loft", {"move-joints": LookingAhead()})
    with process_module.execution_environment("loft"):
        assert perform(type="move-arm-joints", left_arm="park") == pytest.approx([0.3, 0, 0])
    assert scene.robot.get_position() == before


def test_motions_that_would_wait_for_each_other_in_two_worlds_are_refused() -> None:
    class Elsewhere(ProcessModule):
        def __init__(self, world: BulletWorld) -> None:
            self.world = world

        def _execute(self, designator: MotionDesignator) -> None:
            BulletWorld.current_bullet_world = self.world
            begun.wait()
            with process_module.execution_environment("simulated"):
                perform(type="moving", target=[0.3, 0, 0])

    def look_ahead(here: BulletWorld, there: BulletWorld) -> None:
        BulletWorld.current_bullet_world = here
        process_module.register("pr2", f"from {here.name}", {"move-joints": Elsewhere(there)})
        with process_module.execution_environment(f"from {here.name}"):
            perform(type="move-arm-joints", left_arm="park")

    with BulletWorld(name="a") as a, BulletWorld(name="b") as b:
        for world in (a, b):
            world.robot = Object("pr2", "robot", "pr2.urdf", world=world)
        begun = Meeting(2)
        with pytest.raises(Deadlock, match="moving can't wait for move-arm-joints"), timeout(60):
            par(lambda: look_ahead(a, b), lambda: look_ahead(b, a))
        begun = Meeting(1)
        look_ahead(a, b)  # both queues are free again
        look_ahead(b, a)
        assert [world.robot.get_position() for world in (a, b)] == [[0.3, 0, 0]] * 2


def test_the_name_of_an_execution_environment_is_checked() -> None:
    for name in (3, "", None):
        with pytest.raises(BadArgument, match="name"), process_module.execution_environment(name):
            pytest.fail("it was entered")


@pytest.mark.slow
def test_accessing_refuses_obstacles_and_a_full_gripper(scene: BulletWorld) -> None:
    kitchen, milk, robot = scene.get_object("kitchen"), scene.get_object("milk"), scene.robot
    slots = {"type": "accessing", "drawer-joint": DRAWER, "drawer-handle": HANDLE, "part-of": kitchen, "arm": "left"}
    x, y, z = kitchen.get_link_position(HANDLE)
    pot = Object("pot", "pot", "pot.stl", [x - 0.1, y, z])
    before = snapshot(scene)
    with pytest.raises(AccessFailed, match="pot would be in the way"):
        perform(**slots, distance=0.3)
    assert snapshot(scene) == before
    pot.remove()
    robot.attach(milk, "l_gripper_tool_frame")
    before = snapshot(scene)
    with pytest.raises(AccessFailed, match="holds milk"):
        perform(**slots, distance=0.3)
    assert snapshot(scene) == before


@pytest.mark.slow
def test_the_palm_does_not_penetrate_the_handle(scene: BulletWorld) -> None:
    kitchen, robot = scene.get_object("kitchen"), scene.robot
    slots = {"type": "accessing", "drawer-joint": DRAWER, "drawer-handle": HANDLE, "part-of": kitchen, "arm": "left"}
    deepest: list[float] = []

    def look(_: Object) -> None:
        touches = scene.engine.link_closest_points(robot.handle, "l_gripper_palm_link", kitchen.handle, 0.05)
        deepest.extend(touch.distance for touch in touches if touch.link_b == HANDLE)

    manipulated = scene.get_manipulation_event()
    manipulated += look
    perform(**slots, distance=0.3)
    assert deepest
    assert min(deepest) > -1e-3


def test_a_door_does_not_move_bodies_that_it_does_not_support(scene: BulletWorld) -> None:
    kitchen = scene.get_object("kitchen")
    door = "sink_area_dish_washer_door_joint"
    kitchen.set_joint_position(door, 0.75)
    low, high = kitchen.get_AABB("sink_area_dish_washer_door")
    cup = Object("cup", "cup", "cup.stl", [low[0] + 0.03, (low[1] + high[1]) / 2, low[2] + 0.05])
    assert all(a < x < b for a, x, b in zip(low, cup.get_position(), high, strict=True))
    lay = cup.get_position()
    kitchen.set_joint_position(door, 0.0)
    assert cup.get_position() == lay


def test_arm_motions_refuse_collisions(scene: BulletWorld) -> None:
    before = snapshot(scene)
    with pytest.raises(Unreachable, match="kitchen"):
        perform(type="move-tcp", target=[1.3, 0.9, 0.7], arm="left")
    with pytest.raises(PostureInCollision, match=r"left arm can't take that posture: .* would touch .* of kitchen"):
        perform(**{"type": "move-arm-joints", "left-arm": [0, 0.6, 0, -0.3, 0, -0.2, 0]})
    assert snapshot(scene) == before


@pytest.mark.parametrize(
    ("target", "orientation", "message"),
    [([0, 0, 3], [0, 0, 0, 1], "3.00 m above the ground"), ([-0.3, -3, 0], [0.7, 0, 0, 0.7], "lean over by 90")],
)
def test_a_base_moves_only_on_its_ground_and_upright(
    scene: BulletWorld, target: list[float], orientation: list[float], message: str
) -> None:
    before = snapshot(scene)
    with pytest.raises(NotDrivable, match=message):
        perform(type="moving", target=target, orientation=orientation)
    assert snapshot(scene) == before
