"""Public attributes of worlds and objects can't be assigned: only methods change them, and the error names which."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.failures import ReadOnly
from recorder.records import Keyframe, Mutation, Refusal

if TYPE_CHECKING:
    from pycram.world.transaction import ReadOnlyAttributes
    from tests.conftest import MemorySink

SETTERS = {"robot"}  # that make a transaction


def things() -> tuple[ReadOnlyAttributes, ...]:
    world = BulletWorld.current_bullet_world
    return world, Object("pr2", "robot", "ur5.urdf"), Object("milk", "milk", "milk.stl", [1, 1, 1])


def public(thing: object) -> list[str]:
    return [name for name in dir(thing) if not name.startswith("_") and name not in SETTERS]


def test_every_public_attribute_refuses_assignment(world: BulletWorld, sink: MemorySink) -> None:
    for thing in things():
        world.set_robot(thing if isinstance(thing, Object) and thing.is_robot else None)
        names = public(thing)
        assert len(names) > 30
        before = {name: getattr(thing, name) for name in names}
        keyframe = world.transactions.keyframe()
        sink.records.clear()
        for name in names:
            for change in (partial(setattr, thing, name, 3), partial(delattr, thing, name)):
                with pytest.raises(ReadOnly) as raised:
                    change()
                assert (raised.value.attribute, raised.value.owner) == (name, repr(thing))
                assert raised.value.instead in str(raised.value)
        assert {name: getattr(thing, name) for name in names} == before
        assert world.transactions.keyframe() == keyframe
        assert len(sink.of(Refusal)) == len(sink.records) == 2 * len(names)


@pytest.mark.parametrize(
    ("name", "method"),
    [("gravity", "set_gravity"), ("sim_step", "simulate"), ("realtime", "set_realtime"), ("closed", "exit"),
     ("objects", "Object(...)")],
)  # fmt: skip
def test_the_error_names_the_method_of_a_world(world: BulletWorld, name: str, method: str) -> None:
    with pytest.raises(ReadOnly, match=name) as raised:
        setattr(world, name, [0, 0, 0])
    assert method in raised.value.instead
    assert isinstance(raised.value, AttributeError)


@pytest.mark.parametrize(
    ("name", "method"),
    [("color", "set_color"), ("original_pose", "set_position_and_orientation"), ("attachments", "attach"),
     ("original_joints", "set_joint_positions"), ("alive", "remove")],
)  # fmt: skip
def test_the_error_names_the_method_of_an_object(world: BulletWorld, name: str, method: str) -> None:
    milk = Object("milk", "milk", "milk.stl", world=world)
    with pytest.raises(ReadOnly, match=name) as raised:
        setattr(milk, name, [1, 0, 0, 1])
    assert method in raised.value.instead


def test_what_an_attribute_holds_cant_be_changed_either(world: BulletWorld) -> None:
    _, robot, _ = things()
    for table in (robot.original_joints, robot.attachments):
        with pytest.raises(TypeError):
            table["x"] = 1
    world.objects.clear()
    assert len(world.objects) == 2


def test_a_keyframe_has_what_the_mutations_say(world: BulletWorld, sink: MemorySink) -> None:
    milk = Object("milk", "milk", "milk.stl", [1, 1, 1])
    milk.set_color([1, 0, 0, 1])
    world.set_gravity([0, 0, -1])
    world.simulate_steps(3)
    for _ in range(100):
        milk.set_position([1, 1, 2])
    frame = sink.of(Keyframe)[-1]
    commands = sink.of(Mutation)
    assert frame.gravity == next(each.set_gravity.gravity for each in commands if each.HasField("set_gravity"))
    assert frame.sim_step == 3
    assert frame.loaded[0].color == next(each.set_color.color for each in commands if each.HasField("set_color"))


def test_attributes_of_the_plans_own_can_be_assigned(world: BulletWorld) -> None:
    class Cup(Object):
        full = False

        def __init__(self, world: BulletWorld) -> None:
            super().__init__("cup", "cup", "cup.stl", world=world)
            self.owner = "nobody"

    cup = Cup(world)
    cup.full, cup.owner, cup.note, world.weather = True, "me", 1, "fine"
    cup.note, cup.owner, world.weather = 2, "you", "rain"
    assert (cup.full, cup.owner, cup.note, world.weather) == (True, "you", 2, "rain")
    del cup.note
    with pytest.raises(ReadOnly):
        cup.name = "mug"


def test_a_keyframe_follows_after_as_many_changed_objects_as_there_are(world: BulletWorld, sink: MemorySink) -> None:
    first, *_ = [Object(f"milk_{x}", "milk", "milk.stl", [x, 0, 1]) for x in range(120)]
    counts = []
    for number in range(99 + 120):  # 20 objects were loaded after the first keyframe
        first.set_position([0, 0, 1 + number / 1000])
        counts.append(len(sink.of(Keyframe)))
    assert [counts[98], counts[99], counts[218]] == [2, 3, 3]
    for _ in range(101):
        world.simulate_steps(1)  # changes all objects
        counts.append(len(sink.of(Keyframe)))
    assert [counts[219], counts[318], counts[319]] == [4, 4, 5]
