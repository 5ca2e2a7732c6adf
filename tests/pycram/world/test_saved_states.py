"""Saved states: a world gets everything back that it had, in one record, and says so where that can't be."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import BadArgument, ChangeRefused, ObjectsChanged, WorldClosed
from pycram.world.transaction import take_snapshot
from recorder.records import Mutation
from replay.history.blame import blame
from replay.restore.verify import verify

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink


def facts(world: BulletWorld) -> dict[str, object]:
    """Everything that belongs to a state but orientations, to the last bit."""
    held = sorted(str(attachment.record()) for body in world.objects for attachment in body.carried)
    motors = {body.name: dict(body.handle.targets) for body in world.objects}
    states = {body.name: take_snapshot(body) for body in world.objects}
    at = {name: world.engine.center_pose(world.get_object(name).handle)[0] for name in states}
    moving = {name: (state.velocity, state.positions, state.velocities) for name, state in states.items()}
    return {"at": at, "moving": moving, "motors": motors, "held": held, "gravity": world.gravity, "robot": world.robot}


def turns(world: BulletWorld) -> list[float]:
    return [number for body in world.objects for number in body.get_orientation()]


def disturb(world: BulletWorld, dice: random.Random) -> None:
    """Change whatever a state has."""
    robot, kitchen = world.get_object("pr2"), world.get_object("kitchen")
    things = [body for body in world.objects if not body.fixed]
    for body in (*things, robot):
        body.detach_all()
    robot.attach(dice.choice(things), dice.choice(("l_gripper_tool_frame", "r_gripper_tool_frame")))
    robot.set_position([dice.uniform(-1, 1), 0.5, 0])
    robot.set_joint_position("head_pan_joint", dice.uniform(-1, 1))
    kitchen.set_joint_position("iai_fridge_door_joint", dice.uniform(0, 1))
    dice.choice(things).set_position([dice.uniform(0, 1), 2, dice.uniform(0, 2)])
    world.set_gravity([0, 0, dice.uniform(-10, 0)])
    world.set_robot(dice.choice((robot, None)))
    world.simulate(dice.uniform(0, 0.2))


@pytest.mark.slow
def test_a_restored_state_is_the_saved_one_to_the_last_bit(scene: BulletWorld, sink: MemorySink) -> None:
    dice = random.Random(4)
    states = []
    for _ in range(4):
        disturb(scene, dice)  # while things fall and swing
        states.append((scene.save(), facts(scene), turns(scene)))
    time = scene.sim_step
    for saved, wanted, turned in dice.choices(states, k=8):
        records, before = len(sink.of(Mutation)), scene.save()
        changed = facts(scene)
        scene.restore(saved)
        assert facts(scene) == wanted
        assert turns(scene) == pytest.approx(turned, rel=0, abs=3e-16)
        assert len(sink.of(Mutation)) == records + 1
        scene.restore(before)  # undoes it
        assert facts(scene) == changed
        scene.restore(saved)
        assert scene.sim_step == time  # time doesn't go back


def test_what_has_not_changed_is_not_touched(scene: BulletWorld, sink: MemorySink) -> None:
    saved = scene.save()
    scene.get_object("milk").set_position([1.3, 1, 1.2])
    scene.restore(saved)
    (record,) = [record for record in sink.of(Mutation) if record.HasField("restore")]
    assert [state.body for state in record.effect.bodies] == ["milk"]


def test_events_tell_what_is_taken_and_let_go(scene: BulletWorld) -> None:
    robot, milk, kitchen = scene.get_object("pr2"), scene.get_object("milk"), scene.get_object("kitchen")
    heard: list[tuple[str, object]] = []
    empty = scene.save()
    robot.attach(milk, "l_gripper_tool_frame")
    kitchen.set_joint_position("iai_fridge_door_joint", 0.3)
    full = scene.save()
    taken, let_go, moved = scene.get_attachment_event(), scene.get_detachment_event(), scene.get_manipulation_event()
    taken += lambda *bodies: heard.append(("attachment", bodies))
    let_go += lambda *bodies: heard.append(("detachment", bodies))
    moved += lambda *bodies: heard.append(("manipulation", bodies))
    scene.restore(empty)
    assert heard == [("detachment", (robot, milk)), ("manipulation", (kitchen,))]
    del heard[:]
    scene.restore(full)
    assert heard == [("manipulation", (kitchen,)), ("attachment", (robot, milk))]


def test_objects_that_came_or_went_are_named_before_anything_changes(world: BulletWorld) -> None:
    cup, bowl = Object("cup", "cup", "cup.stl"), Object("bowl", "bowl", "bowl.stl", [1, 0, 0])
    saved = world.save()
    cup.set_position([3, 3, 3])
    bowl.remove()
    Object("spoon", "spoon", "spoon.stl", [2, 0, 0])
    with pytest.raises(
        ObjectsChanged, match="spoon was loaded and bowl was removed after the state was saved"
    ) as raised:
        world.restore(saved)
    assert (raised.value.added, raised.value.removed) == (("spoon",), ("bowl",))
    assert cup.get_position() == pytest.approx([3, 3, 3])
    world.get_object("spoon").remove()
    Object("bowl", "bowl", "bowl.stl", [1, 0, 0])
    with pytest.raises(ObjectsChanged, match="bowl was loaded and bowl was removed"):  # another one of that name
        world.restore(saved)


def test_a_state_goes_into_its_own_open_world_outside_of_queries(world: BulletWorld) -> None:
    saved = world.save()
    with BulletWorld(name="other") as other, pytest.raises(BadArgument, match=r"other\.save\(\) has returned"):
        other.restore(saved)
    with pytest.raises(BadArgument):
        world.restore("yesterday")  # type: ignore[arg-type]
    world.transactions.query = "stable"
    with pytest.raises(ChangeRefused, match="restore was tried"):
        world.restore(saved)
    world.exit()
    with pytest.raises(WorldClosed):
        world.restore(saved)
    with pytest.raises(WorldClosed, match="save its state"):
        world.save()


def test_a_recording_with_restored_states_is_made_again_to_the_last_bit(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "plan.mcap"), BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        cup, bowl = Object("cup", "cup", "cup.stl", [0, 0, 0.2]), Object("bowl", "bowl", "bowl.stl", [1, 0, 0.3])
        cup.attach(bowl)
        world.simulate(0.1)
        saved, before = world.save(), cup.get_position()
        cup.detach(bowl)
        world.set_gravity([0, 0, 0])
        cup.set_position([5, 5, 5])
        world.restore(saved)
        world.simulate(0.5)
    with replay.open(tmp_path / "plan.mcap") as log:
        assert verify(log).exact
        (step,) = [record.seq for record in log.records(Mutation) if record.HasField("restore")]
        state = log.state_at(step).worlds[world.name]
        assert (list(state.body("cup").position), state.gravity) == (before, (0, 0, -9.8))
        assert [*state.attachments] == [("cup", "bowl")]
        change = blame(log, "cup", step)
        assert (change.record.seq, change.how) == (step, "restored")
