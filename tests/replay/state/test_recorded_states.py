"""The recording tells the truth: what it says after every record is what the live world had then."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.process_module import ProcessModule
from recorder.records import Keyframe, Mutation, Query
from tests.replay.approximately import assert_approximately

if TYPE_CHECKING:
    from pathlib import Path

    from recorder.records import Record


class Witness:
    """Writes down what the live world has at the very moment of each record."""

    def __init__(self) -> None:
        self.worlds: list[BulletWorld] = []
        self.seen: dict[int, dict[str, object]] = {}

    def write(self, topic: str, record: Record, payload: bytes) -> None:
        if isinstance(record, Mutation | Keyframe):
            self.seen[record.seq] = {world.name: snapshot(world) for world in self.worlds if not world.closed}

    def attach(self, asset: object) -> None:
        pass

    def flush(self) -> None: ...

    def close(self) -> None:
        pass


def snapshot(world: BulletWorld) -> dict[str, object]:
    return {
        body.name: {
            "position": body.get_position(),
            "orientation": body.get_orientation(),
            "joints": body.get_joint_positions(),
            "holds": sorted(held.body.name for held in body.carried),
        }
        for body in world.objects
    }


READER = """
import json, sys
import replay
log = replay.open(sys.argv[1])
states = {}
for step in json.load(sys.stdin):
    states[step] = {
        world.name: {
            body.name: {
                "position": body.position, "orientation": body.orientation, "joints": body.joints,
                "holds": sorted(held.body for held in world.attachments.values() if held.carrier == body.name),
            }
            for body in world.bodies.values()
        }
        for world in log.state_at(step).worlds.values()
    }
assert "pybullet" not in sys.modules and "pycram" not in sys.modules
json.dump(states, sys.stdout)
"""


def perform(**slots: object) -> object:
    return ProcessModule.perform(MotionDesignator([(key.replace("_", "-"), value) for key, value in slots.items()]))


def run_plan(witness: Witness) -> None:
    world = BulletWorld(name="kitchen")
    witness.worlds.append(world)
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    robot = Object("pr2", "robot", "pr2.urdf")
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    milk = Object("milk", "milk", "milk.stl", [1.3, 1, 1])
    spoon = Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.72])
    cup = Object("cup", "cup", "cup.stl", [1.5, 0.3, 0.95])
    BulletWorld.robot = robot
    other = BulletWorld(name="other")
    witness.worlds.append(other)
    ball = Object("apple", "apple", "apple.stl", [0, 0, 3])
    other.set_gravity([0, 0, -1.6])
    other.simulate(0.3)
    BulletWorld.current_bullet_world = world
    world.simulate(0.3)
    perform(type="move-arm-joints", left_arm="park", right_arm="park")
    perform(type="moving", target=[0.65, 0.7, 0], orientation=[0, 0, 0, 1])
    kitchen.set_joint_position("sink_area_left_upper_drawer_main_joint", 0.25)
    perform(type="pick-up", object=milk, arm="left")
    milk.attach(cup)
    perform(type="move-arm-joints", left_arm="park")
    perform(type="moving", target=[0.3, 0.9, 0], orientation=[0, 0, 0, 1])
    milk.set_position([0.3, 1.4, 1.1])
    world.simulate(0.2)
    spoon.remove()
    Object("spoon", "spoon", "spoon.stl", [1.4, 0.5, 0.9], color=[1, 0, 0, 1])
    for turn in range(110):  # past a keyframe
        ball.set_position([0.01 * turn, 0, 2])
    robot.detach(milk)
    world.reset()
    other.exit()
    world.simulate(0.1)
    world.exit()


@pytest.mark.parametrize("late", [False, True], ids=["from the start", "worlds before the recording"])
@pytest.mark.slow
def test_state_after_every_record_equals_the_live_world(tmp_path: Path, late: bool) -> None:
    file = tmp_path / "run.mcap"
    witness = Witness()
    if late:
        witness.worlds.append(BulletWorld(name="before"))
        Object("floor", "environment", "plane.urdf")
        Object("bowl", "bowl", "bowl.stl", [0, 0, 1])
    with recorder.record(file) as recording:
        recording.journal.add_sink(witness)
        if late:
            witness.worlds[0].simulate(0.2)
        run_plan(witness)
    for world in witness.worlds:
        world.exit()
    assert len(witness.seen) > 140
    reading = subprocess.run(
        [sys.executable, "-c", READER, str(file)],
        input=json.dumps(list(witness.seen)),
        capture_output=True,
        text=True,
        check=True,
    )
    data = json.loads(reading.stdout)
    for step, live in witness.seen.items():
        # while it is being opened, a world is on record before the plan (and the witness) has it
        worlds = {name: bodies for name, bodies in data[str(step)].items() if bodies or name in live}
        assert_approximately(worlds, json.loads(json.dumps(live)), f"step {step}")


def test_every_public_call_is_one_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An independent observer, who counts calls of the public methods, counts what the recording has."""
    counted: dict[str, int] = {}

    def count(owner: object, name: str, kind: str) -> None:
        original = getattr(owner, name)

        def counting(*args: object, **kwargs: object) -> object:
            counted[kind] = counted.get(kind, 0) + 1
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, counting)

    for query in (
        "stable",
        "contact",
        "visible",
        "occluding",
        "reachable_object",
        "reachable_pose",
        "blocking",
        "supporting",
    ):
        count(btr, query, "query")
    with recorder.record(tmp_path / "run.mcap"):
        world = BulletWorld()
        world.set_gravity([0, 0, -9.8])
        floor = Object("floor", "environment", "plane.urdf")
        bowl = Object("bowl", "bowl", "bowl.stl", [0, 0, 0.034])
        world.simulate(0.2)
        btr.stable(bowl)
        btr.contact(floor, bowl)
        btr.supporting(floor, bowl)
        btr.visible(bowl, [1, 0, 1])
        btr.occluding(bowl, [1, 0, 1])
        bowl.set_position([0, 0, 1])
        world.exit()
    with replay.open(tmp_path / "run.mcap") as log:
        assert log.complete
        assert sum(1 for _ in log.records(Query)) == counted["query"] == 5
        commands = [record.WhichOneof("command") for record in log.records(Mutation)]
    assert commands == ["open_world", "set_gravity", "load_body", "load_body", "simulate", "move_body", "close_world"]


def test_a_change_between_two_recordings_is_in_the_second_one_s_keyframe(tmp_path: Path) -> None:
    with BulletWorld() as world:
        with recorder.record(tmp_path / "first.mcap"):
            robot = Object("pr2", "robot", "pr2.urdf")
        robot.remove()
        with recorder.record(tmp_path / "second.mcap"):
            robot = Object("pr2", "robot", "pr2.urdf")
            live = snapshot(world)["pr2"]
    with replay.open(tmp_path / "second.mcap") as log:
        body = log.state_at(2).world().body("pr2")
        assert list(body.position) == live["position"]
        assert dict(body.joints) == live["joints"]
