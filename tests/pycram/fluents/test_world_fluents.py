"""Fluents follow poses, joints, attachments and contacts of a world, whatever changes them."""

from __future__ import annotations

import json
import math
from operator import itemgetter
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import BadArgument, UnknownName, WorldClosed
from pycram.fluent import NotSettable, network
from pycram.fluents.world import contact, holding, joint, pose, position
from recorder.records import Fluent as FluentRecord
from tests.pycram.fluents.waiters import HANG_TIMEOUT, Running, waiting

if TYPE_CHECKING:
    from tests.conftest import MemorySink


@pytest.mark.slow
def test_fluents_follow_every_change_of_a_world(scene: BulletWorld) -> None:
    robot, milk, kitchen = scene.robot, scene.get_object("milk"), scene.get_object("kitchen")
    tool = "l_gripper_tool_frame"
    fluents = [pose(milk), position(robot), pose(robot, tool), joint(robot, "torso_lift_joint"), joint(kitchen, "iai_fridge_door_joint"),
               holding(robot), holding(robot, "left"), holding(robot, "right"), contact(milk, kitchen)]  # fmt: skip

    def said() -> list[object]:
        def at(body: Object, link: str | None = None) -> tuple[object, object]:
            place, turn = (
                body.get_position_and_orientation() if link is None else body.get_link_position_and_orientation(link)
            )
            return tuple(place), tuple(turn)

        held = milk.name if milk.carrier is robot else None
        left = held if held and robot.attachments[milk].carrier_link == tool else None
        near = kitchen.world.engine.closest_points(milk.handle, kitchen.handle, 1e-3)
        return [at(milk), at(robot)[0], at(robot, tool), robot.get_joint_position("torso_lift_joint"),
                kitchen.get_joint_position("iai_fridge_door_joint"), held, left, None, True if near else None]  # fmt: skip

    def check() -> list[object]:
        values = [fluent.get_value() for fluent in fluents]
        assert values == said()
        return values

    seen = [check()]
    for change in (
        lambda: milk.set_position([1.3, 1, 1.4]),
        lambda: scene.simulate(0.5),
        lambda: robot.attach(milk, tool),
        lambda: robot.set_joint_position("torso_lift_joint", 0.3),
        lambda: robot.set_position([0.4, 0.7, 0]),
        lambda: kitchen.set_joint_position("iai_fridge_door_joint", 0.7),
        lambda: robot.detach(milk),
        lambda: robot.attach(milk),
        scene.reset,
    ):
        change()
        seen.append(check())
    for values in zip(*[values[:7] + values[8:] for values in seen], strict=True):
        assert len(set(values)) > 1, "each of them has changed"


def test_fluents_of_bodies_that_move_together_change_together(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    robot.attach(milk, "l_gripper_tool_frame")
    apart = math.dist(robot.get_position(), milk.get_position())
    torn = network(
        lambda a, b: None if math.isclose(math.dist(a, b), apart, abs_tol=1e-6) else (a, b),
        position(robot),
        position(milk),
    )
    arrived = network(lambda at: True if at[0] > 5 else None, position(robot))
    seen: list[object] = []
    with waiting(network(lambda bad, end: seen.append(bad) or end, torn, arrived)) as running:
        for step in range(7):
            robot.set_position([step, 0, 0])
        assert running.end() is True
    assert len(seen) > 6
    assert set(seen) == {None}


@pytest.mark.slow
def test_fluents_change_during_a_simulation(scene: BulletWorld, sink: MemorySink) -> None:
    milk, kitchen = scene.get_object("milk"), scene.get_object("kitchen")
    milk.set_position([1.3, 1, 1.2])
    falling = network(itemgetter(2), position(milk))
    landed = contact(milk, kitchen)
    assert landed.get_value() is None
    begin = scene.sim_step
    with waiting((falling < 1.15).AND(falling > 1.05)) as passing, waiting(landed) as landing:
        scene.simulate(1)
        assert (passing.end(), landing.end()) == (True, True)
    records = [record for record in sink.of(FluentRecord) if record.source == "contact"]
    assert json.loads(records[0].before_json) is None
    assert json.loads(records[0].after_json) is True
    assert begin < records[0].sim_step < scene.sim_step
    falls = [record for record in sink.of(FluentRecord) if record.source == "position"]
    assert [record.sim_step for record in falls] == sorted(record.sim_step for record in falls)
    assert json.loads(falls[-1].after_json) == milk.get_position()


def test_waits_and_handlers_may_use_the_world(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    picked = holding(robot, "left") == "milk"
    found: list[object] = []
    event = scene.get_attachment_event()
    event += lambda *_: found.append(Running(lambda: picked.wait_for(HANG_TIMEOUT) and milk.get_position()).end())

    def carry_on() -> list[float]:
        assert picked.wait_for()
        milk.set_color([1, 0, 0, 1])
        return milk.get_position()

    running = Running(carry_on)
    robot.attach(milk, "l_gripper_tool_frame")
    assert found == [milk.get_position()]
    assert running.end() == milk.get_position()


def test_fluents_of_removed_objects_and_closed_worlds_raise(scene: BulletWorld) -> None:
    robot, milk, bowl = scene.robot, scene.get_object("milk"), scene.get_object("bowl")
    robot.attach(milk, "l_gripper_tool_frame")
    held, place = holding(robot, "left"), position(bowl)
    with waiting(contact(milk, bowl)) as touching, waiting(position(milk).pulsed()) as moving:
        milk.remove()
        for running in (touching, moving):
            assert isinstance(running.end(), WorldClosed)
            assert "object milk" in str(running.outcome)
    assert held.get_value() is None
    assert place.get_value() == tuple(bowl.get_position())
    Object("milk", "milk", "milk.stl", [0, 0, 3])
    assert position(scene.get_object("milk")).get_value() == (0, 0, 3)
    with waiting(held) as running:
        scene.exit()
        assert isinstance(running.end(), WorldClosed)
    with pytest.raises(WorldClosed, match="the world is gone"):
        place.get_value()
    with pytest.raises(WorldClosed):
        position(bowl)


def test_only_followed_and_affected_fluents_are_read(scene: BulletWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    milk, kitchen = scene.get_object("milk"), scene.get_object("kitchen")
    assert scene.transactions.observer is None
    followed = contact(milk, kitchen)
    asked = []
    monkeypatch.setattr("pycram.fluents.world.touches", lambda *_: asked.append(1))
    scene.robot.set_position([0.5, 0.5, 0])
    assert not asked  # it doesn't concern them
    milk.set_position([1.3, 1, 1.2])
    assert len(asked) == 1
    del followed
    milk.set_position([1.3, 1, 1.3])
    scene.simulate(0.1)
    assert len(asked) == 1


def test_invalid_names_are_refused_at_once(scene: BulletWorld) -> None:
    robot, milk = scene.robot, scene.get_object("milk")
    with pytest.raises(UnknownName, match="torso_lift_joint"):
        joint(robot, "torso_lift_jont")
    with pytest.raises(UnknownName):
        pose(robot, "left_hand")
    with pytest.raises(UnknownName):
        holding(robot, "middle")
    with pytest.raises(BadArgument, match="arms"):
        holding(milk, "left")
    with pytest.raises(BadArgument):
        position("milk")
    with pytest.raises(NotSettable, match="world"):
        position(milk).set_value((0, 0, 0))
    with BulletWorld() as second:
        stranger = Object("cup", "cup", "cup.stl", world=second)
        with pytest.raises(BadArgument, match="object of"):
            contact(milk, stranger)
