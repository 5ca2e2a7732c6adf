"""Recordings that are sound as files, but make no sense: every verb that rebuilds worlds says so, and none breaks."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest
from google.protobuf.descriptor import FieldDescriptor

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.world.world import open_worlds
from recorder.mcap_sink import McapSink
from recorder.records import TOPICS, Keyframe, Mutation, Query, Task
from recorder.records.values import AssetFile
from replay.cli.main import main
from tests.measures import seeded

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from google.protobuf.message import Message

WRONG = {
    FieldDescriptor.CPPTYPE_DOUBLE: (float("nan"), float("inf"), 1e300, -1.5, 0.0),
    FieldDescriptor.CPPTYPE_STRING: ("zzz", "", "../../x", "{"),
    FieldDescriptor.CPPTYPE_INT64: (-1, 0, 3, 10**9),
    FieldDescriptor.CPPTYPE_INT32: (-1, 5),
    FieldDescriptor.CPPTYPE_BOOL: (True, False),
    FieldDescriptor.CPPTYPE_ENUM: (0, 1, 2),
}


def parts(message: Message) -> Iterator[Message]:
    yield message
    for field, value in message.ListFields():
        if field.message_type:
            for part in value if hasattr(value, "append") else [value]:
                yield from parts(part)


def spoil(message: Message, dice: random.Random) -> None:
    """Makes one thing in a message wrong: another value, or nothing."""
    part = dice.choice([part for part in parts(message) if part.ListFields()])
    field, value = dice.choice(part.ListFields())
    repeated = hasattr(value, "append")
    if field.message_type or dice.random() < 0.3:
        if repeated:
            del value[dice.randrange(len(value))]
        else:
            part.ClearField(field.name)
    elif repeated:
        value[dice.randrange(len(value))] = dice.choice(WRONG[field.cpp_type])
    elif field.name == "steps":
        part.steps = dice.choice((-1, 0, 3))  # type: ignore[attr-defined]
    else:
        setattr(part, field.name, dice.choice(WRONG[field.cpp_type]))


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("nonsense") / "run.mcap"
    with recorder.record(file), BulletWorld(name="w") as world:
        world.set_gravity([0, 0, -9.8])
        floor = Object("floor", "environment", "plane.urdf")
        cup = Object("cup", "cup", "cup.stl", [1.3, 0.8, 0.1])
        apple = Object("apple", "apple", "apple.stl", [1.3, 0.8, 0.3], color=[1, 0, 0, 1])
        world.simulate(0.05)
        cup.attach(apple)
        btr.contact(cup, floor)
        for turn in range(100):
            apple.set_position([0, 0, 1 + 0.01 * turn])
        cup.set_position([1.2, 0.8, 0.1])
        world.simulate(0.05)
        cup.detach(apple)
        apple.remove()
    return file


def spoilt(sound: Path, target: Path, seed: int) -> Path:
    dice = random.Random(seed)
    with replay.open(sound) as log:
        sink = McapSink(target, log.metadata)
        sink._frames.transforms = lambda record: iter(())  # type: ignore[method-assign]  it would refuse
        for name, content in log.assets.items():
            sink.attach(AssetFile(name.partition("/")[2], content))
        for record in log.records():
            step = record.seq
            if isinstance(record, Mutation | Keyframe | Task | Query) and dice.random() < 0.1:
                spoil(record, dice)
                record.seq, record.wall_time_ns = step, max(record.wall_time_ns, 0)
            sink.write(TOPICS[type(record)], record, record.SerializeToString())
        sink.close()
    return target


def check(sound: Path, target: Path, seed: int) -> None:
    file = str(spoilt(sound, target, seed))
    query = "9"
    assert main(["verify", file]) in (1, 2, 3), f"seed {seed}"
    for asked in (
        ["ask", file, "-20", "supporting(floor, cup)"],
        ["ask", file, query],
        ["restore", file, "-20", "--json"],
        ["restore", file, "-20", "--json", "--exact"],
        ["render", file, "-20", "-o", str(target.with_suffix(".png")), "--size", "8x8"],
    ):
        assert main(asked) in (0, 1, 2, 3), f"seed {seed}: {asked}"
        assert not open_worlds(), f"seed {seed}: {asked}"


@pytest.mark.slow
def test_inconsistent_records_are_reported(sound: Path, tmp_path: Path) -> None:
    for seed in range(2):
        check(sound, tmp_path / f"{seed}.mcap", seed)


@seeded("inconsistent records", range(2, 150), 8)
def test_many_inconsistent_records_are_reported(sound: Path, tmp_path: Path, seeds: range) -> None:
    for seed in seeds:
        check(sound, tmp_path / f"{seed}.mcap", seed)
