"""Invalid arguments raise a typed error that names the cause; world and recording stay as they were."""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import DesignatorError, MotionDesignator
from pycram.failures import AssetError, BadArgument, JointLimitError, UnknownName, UsageError
from pycram.process_module import ProcessModule
from recorder.records import Refusal, Task
from tests.conftest import furnish

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.conftest import MemorySink

NAN = float("nan")
JOINT = "sink_area_left_upper_drawer_main_joint"

CALLS: dict[str, tuple[Callable[[BulletWorld], object], type[Exception], str]] = {
    "position NaN": (lambda w: w.get_object("milk").set_position([0, NAN, 0]), BadArgument, "position"),
    "position of 2": (lambda w: w.get_object("milk").set_position([0, 1]), BadArgument, "3 finite numbers"),
    "position text": (lambda w: w.get_object("milk").set_position("abc"), BadArgument, "3 finite numbers"),
    "position None": (lambda w: w.get_object("milk").set_position(None), BadArgument, "3 finite numbers"),
    "position inf": (lambda w: w.get_object("milk").set_position([float("inf"), 0, 0]), BadArgument, "finite"),
    "position as a set": (
        lambda w: w.get_object("milk").set_position({1.0, 2.0, 3.0}),
        BadArgument,
        "3 finite numbers",
    ),
    "position without end": (lambda w: w.get_object("milk").set_position(count()), BadArgument, "3 finite numbers"),
    "orientation 0": (lambda w: w.get_object("milk").set_orientation([0, 0, 0, 0]), BadArgument, "zero"),
    "orientation of 3": (lambda w: w.get_object("milk").set_orientation([0, 0, 1]), BadArgument, "x, y, z, w"),
    "unknown joint": (lambda w: w.robot.set_joint_position("r_elbow_flexjoint", 0), UnknownName, "r_elbow_flex_joint"),
    "fixed joint": (lambda w: w.robot.get_joint_position("r_gripper_tool_joint"), UnknownName, "movable joint"),
    "joint limit": (lambda w: w.get_object("kitchen").set_joint_position(JOINT, 0.6), JointLimitError, "0 to 0.48"),
    "joint NaN": (lambda w: w.get_object("kitchen").set_joint_position(JOINT, NAN), BadArgument, "finite"),
    "one bad of two": (
        lambda w: w.robot.set_joint_positions({"torso_lift_joint": 0.1, "head_tilt_joint": 9}),
        JointLimitError,
        "head_tilt_joint",
    ),
    "joints as a list": (lambda w: w.robot.set_joint_positions([0.1]), BadArgument, "by joint name"),
    "joint of no name": (lambda w: w.robot.get_joint_position(["x"]), BadArgument, "joint"),
    "link of no name": (lambda w: w.robot.get_link_position(["x"]), BadArgument, "link"),
    "attach to a list": (lambda w: w.robot.attach(w.get_object("milk"), ["x"]), BadArgument, "link"),
    "attach no object": (lambda w: w.robot.attach("milk"), BadArgument, "an Object"),
    "detach no object": (lambda w: w.robot.detach(None), BadArgument, "an Object"),
    "unknown link": (lambda w: w.robot.attach(w.get_object("milk"), "nolink"), UnknownName, "nolink"),
    "gravity": (lambda w: w.set_gravity([0, 0]), BadArgument, "gravity"),
    "negative time": (lambda w: w.simulate(-1), BadArgument, "seconds"),
    "time NaN": (lambda w: w.simulate(NAN), BadArgument, "seconds"),
    "endless time": (lambda w: w.simulate(1e300), BadArgument, "seconds"),
    "negative steps": (lambda w: w.simulate_steps(-5), BadArgument, "steps"),
    "half a step": (lambda w: w.simulate_steps(2.5), BadArgument, "whole number"),
    "real time maybe": (lambda w: w.set_realtime("no"), BadArgument, "True or False"),
    "end that can't be called": (lambda w: w.at_exit(None), BadArgument, "a function"),
    "current world is none": (lambda w: setattr(BulletWorld, "current_bullet_world", None), BadArgument, "a world"),
    "robot is a name": (lambda w: setattr(BulletWorld, "robot", "pr2"), BadArgument, "robot"),
    "object of no name": (lambda w: w.get_object([]), BadArgument, "name"),
    "robot is no robot": (lambda w: setattr(w, "robot", w.get_object("milk")), BadArgument, "robot"),
    "colour": (lambda w: w.get_object("milk").set_color([2, 0, 0, 1]), BadArgument, "0 to 1"),
    "unknown id": (lambda w: w.get_object_by_id(4711), UnknownName, "4711"),
    "name taken": (lambda w: Object("milk", "milk", "milk.stl"), BadArgument, "name"),
    "no name": (lambda w: Object("", "milk", "milk.stl"), BadArgument, "name"),
    "name that no file can hold": (lambda w: Object("a\ud800", "x", "milk.stl"), BadArgument, "name"),
    "world's name": (lambda w: BulletWorld(name="\ud800"), BadArgument, "name"),
    "name of an open world": (lambda w: BulletWorld(name=w.name), BadArgument, "no open world"),
    "no path": (lambda w: Object("x", "x", None), BadArgument, "path"),
    "no world": (lambda w: Object("x", "x", "milk.stl", world="world_1"), BadArgument, "BulletWorld"),
    "no description": (lambda w: Object("x", "robot", "pr2.urdf", description="pr2"), BadArgument, "RobotDescription"),
    "missing file": (lambda w: Object("x", "x", "nowhere.stl"), AssetError, "no such file"),
    "a folder": (lambda w: Object("x", "x", "/"), AssetError, "not a file"),
    "spawn NaN": (lambda w: Object("x", "x", "milk.stl", [NAN, 0, 0]), BadArgument, "position"),
    "query of no object": (lambda w: btr.stable("milk"), BadArgument, "Object"),
    "query unknown link": (lambda w: btr.reachable(w.get_object("milk"), w.robot, "nolink"), UnknownName, "nolink"),
    "query NaN": (lambda w: btr.reachable_pose([NAN, 0, 0], w.robot, "l_gripper_tool_frame"), BadArgument, "pose"),
    "query camera": (lambda w: btr.visible(w.get_object("milk"), [1, 2, 3, 4, 5]), BadArgument, "camera"),
    "query of no world": (lambda w: btr.stable(w.get_object("milk"), world="x"), BadArgument, "BulletWorld"),
    "query of no robot": (
        lambda w: btr.reachable(w.get_object("milk"), w.get_object("bowl"), "bowl"),
        BadArgument,
        'type "robot"',
    ),
    "query no link": (lambda w: btr.blocking(w.get_object("milk"), w.robot, None), BadArgument, "link"),
    "query threshold": (
        lambda w: btr.reachable(w.get_object("milk"), w.robot, "l_gripper_tool_frame", threshold=-1),
        BadArgument,
        "threshold",
    ),
    "query camera's name": (lambda w: btr.visible(w.get_object("milk"), "no_frame"), UnknownName, "no_frame"),
    "query grasp": (
        lambda w: btr.blocking(w.get_object("milk"), w.robot, "l_gripper_tool_frame", grasp="below"),
        UnknownName,
        "top",
    ),
    "world type": (lambda w: BulletWorld("WINDOW"), BadArgument, "DIRECT"),
    "no designator": (lambda w: ProcessModule.perform("moving"), DesignatorError, "designator"),
    "unknown type": (lambda w: perform(type="mooving", target=[0, 0, 0]), DesignatorError, "moving"),
    "missing slot": (lambda w: perform(type="moving"), DesignatorError, "target"),
    "unknown slot": (
        lambda w: perform(type="moving", target=[0, 0, 0], orientaton=[0, 0, 0, 1]),
        DesignatorError,
        "orientation",
    ),
    "wrong slot": (lambda w: perform(type="moving", target=[0, 0]), DesignatorError, "3 finite numbers"),
    "two targets": (
        lambda w: perform(type="looking", target=[1, 0, 1], object=w.get_object("milk")),
        DesignatorError,
        "one of",
    ),
    "no such arm": (
        lambda w: perform(type="pick-up", object=w.get_object("milk"), arm="middle"),
        DesignatorError,
        "one of left, right",
    ),
    "no such posture": (
        lambda w: perform(**{"type": "move-arm-joints", "left-arm": "parc"}),
        DesignatorError,
        "one of park",
    ),
    "type twice": (
        lambda w: ProcessModule.perform(MotionDesignator([("type", "looking"), ("type", "moving")])),
        DesignatorError,
        "given twice",
    ),
    "type of no name": (lambda w: perform(type=["moving"]), DesignatorError, "unknown type"),
    "six joints": (
        lambda w: perform(**{"type": "move-arm-joints", "left-arm": [0] * 6}),
        DesignatorError,
        "7 joint values",
    ),
    "joints by name": (
        lambda w: perform(**{"type": "move-arm-joints", "left-arm": {"l_elbow_flex_joint": -1.5}}),
        DesignatorError,
        '"park", or a list with a value for each joint of the arm',
    ),
}


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator(list(slots.items())))


@pytest.fixture(scope="module")
def scene() -> Iterator[BulletWorld]:
    """One scene for all calls, since none of them changes it."""
    with BulletWorld() as made:
        made.set_gravity([0, 0, -9.8])
        furnish(made)
        yield made


@pytest.mark.parametrize("name", CALLS)
def test_invalid_arguments_change_nothing(scene: BulletWorld, sink: MemorySink, name: str) -> None:
    call, kind, message = CALLS[name]
    before = [(b.get_position_and_orientation(), b.get_joint_positions(), b.get_AABB()) for b in scene.objects]
    with pytest.raises(kind, match=message) as raised:
        call(scene)
    assert isinstance(raised.value, UsageError)
    assert raised.value.data
    after = [(b.get_position_and_orientation(), b.get_joint_positions(), b.get_AABB()) for b in scene.objects]
    assert after == before
    assert not [record for record in sink.records if type(record).__name__ in ("Mutation", "Query")]
    (refusal,) = sink.of(Refusal)
    assert (refusal.failure.type, refusal.failure.message) == (kind.__qualname__, str(raised.value))
    assert refusal.world == scene.name
    source = (refusal.source_file, refusal.source_line) if refusal.source_file else _line_of_task(sink, refusal.task)
    assert source == (call.__code__.co_filename, call.__code__.co_firstlineno) or source[0] == __file__


def _line_of_task(sink: MemorySink, number: int) -> tuple[str, int]:
    return next((task.source_file, task.source_line) for task in sink.of(Task) if task.task == number)
