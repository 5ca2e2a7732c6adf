"""Worlds as they were: what a user gets back from a recording is what was there."""

from __future__ import annotations

import random
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.world import attachment
from pycram.world.world import open_worlds
from recorder import geometry
from recorder.records import Keyframe, Mutation, OpenWorld
from tests.measures import seeded
from tests.replay.approximately import assert_approximately
from tests.replay.copies import CHUNK, container_records, zeroed
from tests.replay.plans import RandomPlan, everything

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    yield
    for world in open_worlds():
        world.exit()


def plan() -> None:
    """A robot holds a cup on which an apple is held; a drawer with a spoon is open; the bowl falls and is painted."""
    world = BulletWorld(name="kitchen")
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    robot = Object("pr2", "robot", "pr2.urdf", [0.5, 0.6, 0])
    kitchen = Object("kitchen", "environment", "kitchen.urdf")
    Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.72])
    bowl = Object("bowl", "bowl", "bowl.stl", [1.3, 0.8, 1.4])
    cup = Object("cup", "cup", "cup.stl", [0.8, 0.2, 0.8])
    apple = Object("apple", "apple", "apple.stl", [0.8, 0.2, 0.9], color=[0, 1, 0, 1])
    BulletWorld.robot = robot
    world.simulate(0.1)
    robot.attach(cup, "l_gripper_tool_frame")
    cup.attach(apple)
    kitchen.set_joint_position("sink_area_left_upper_drawer_main_joint", 0.3)
    bowl.set_color([1, 0, 0, 1])
    robot.set_joint_position("l_shoulder_pan_joint", 0.5)
    world.simulate(0.1)  # the bowl is falling now


@pytest.fixture(scope="module")
def plan_log(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    """The plan's recording, and what its world was like at the end."""
    path = tmp_path_factory.mktemp("world") / "plan.mcap"
    with recorder.record(path):
        plan()
        world = BulletWorld.current_bullet_world
        assert world is not None
        facts = everything(world)
        world.exit()
    return path, facts


@pytest.fixture
def planned(plan_log: tuple[Path, dict[str, object]]) -> Path:
    return plan_log[0]


def end_of(log: replay.Recording) -> int:
    """The last step at which the world is open."""
    return max(record.seq for record in log.records(Mutation) if not record.HasField("close_world"))


@pytest.mark.slow
@pytest.mark.parametrize("exact", [False, True])
def test_a_restored_world_equals_the_live_one(plan_log: tuple[Path, dict[str, object]], exact: bool) -> None:
    file, wanted = plan_log
    with replay.open(file) as log:
        step = end_of(log)
        world = log.world_at(step, exact=exact)
    assert world.name == f"kitchen@{step}"
    assert BulletWorld.current_bullet_world is world
    assert BulletWorld.robot is world.get_object("pr2")
    assert_approximately(everything(world), wanted)
    if exact:
        assert everything(world) == wanted
    apple, cup, robot = (world.get_object(name) for name in ("apple", "cup", "pr2"))
    robot.set_position([0.4, 0.6, 0])  # the chain follows, each with its recorded relative pose
    (in_hand,), (on_cup,) = robot.carried, cup.carried
    hand = robot.get_link_position_and_orientation("l_gripper_tool_frame")
    place = geometry.multiply(geometry.multiply(hand, in_hand.pose), on_cup.pose)
    assert apple.get_position() == pytest.approx(place[0], abs=1e-9)
    world.reset()
    assert robot.get_position() == [0.5, 0.6, 0.0]


@pytest.mark.slow
def test_restoring_needs_only_the_file(planned: Path) -> None:
    """In another process, with all resources and the robot's package out of reach."""
    script = """
import sys
from pycram.models import files, load
def gone(*_):
    raise AssertionError("looked for a model outside of the recording")
files.find = load.find = files.resources = gone
import replay
with replay.open(sys.argv[1]) as log:
    world = log.world_at(-3)
assert world.get_object("apple").carrier.name == "cup"
world.simulate(0.1)
"""
    subprocess.run([sys.executable, "-c", script, str(planned)], check=True)


@pytest.mark.slow
def test_restoring_does_not_affect_a_running_plan(planned: Path, file: Path) -> None:
    """Only a world that is handed out is on record, from a keyframe on; pictures and questions leave nothing."""
    with BulletWorld(name="now") as now, recorder.record(file):
        with replay.open(planned) as log:
            step = end_of(log)
            log.ask(step, "stable(bowl)")
            assert BulletWorld.current_bullet_world is now
            assert open_worlds() == (now,)
            past = log.world_at(step)
        past.simulate(0.1)
        past.exit()
        assert BulletWorld.current_bullet_world is now
    with replay.open(file) as second:
        changes = [(type(r), r.world) for r in second.records((Mutation, Keyframe))]
        assert changes == [
            (Keyframe, "now"),
            (Keyframe, f"kitchen@{step}"),
            (Mutation, f"kitchen@{step}"),
            (Mutation, f"kitchen@{step}"),
        ]
        again = second.world_at(end_of(second), world=f"kitchen@{step}")
        assert again.get_object("apple").carrier is again.get_object("cup")


@pytest.mark.slow
def test_two_restored_worlds_have_different_names(planned: Path) -> None:
    with replay.open(planned) as log:
        worlds_made = [log.world_at(20) for _ in range(3)]
    assert [world.name for world in worlds_made] == ["kitchen@20", "kitchen@20 (2)", "kitchen@20 (3)"]
    worlds_made[0].get_object("bowl").set_position([0, 0, 5])
    assert worlds_made[1].get_object("bowl").get_position() != [0, 0, 5]


def test_a_step_without_an_open_world_is_refused(planned: Path) -> None:
    with replay.open(planned) as log:
        with pytest.raises(replay.NotRestored, match="no world is open yet; take a later step"):
            log.world_at(0)
        with pytest.raises(replay.NotRestored, match=r"no world is open any more .*kitchen"):
            log.world_at("last")
        with pytest.raises(replay.NotRestored, match="kitchen has ended"):
            log.world_at("last", "kitchen")
        with pytest.raises(replay.NoSuchName, match="kitchen"):
            log.world_at(20, "kitchn")
    assert not open_worlds()


def test_a_world_from_before_the_recording_cannot_be_restored_exactly(file: Path) -> None:
    with BulletWorld(name="early") as world:
        Object("bowl", "bowl", "bowl.stl", [0, 0, 1])
        with recorder.record(file):
            world.set_gravity([0, 0, -1])
    with replay.open(file) as log:
        assert log.world_at(2).gravity == (0, 0, -1)
        with pytest.raises(replay.NotRestored, match="began before the recording"):
            log.world_at(2, exact=True)


def test_a_world_is_not_called_exact_where_a_change_is_lost(file: Path) -> None:
    """Also if nobody has read the damaged part yet: its state comes from a keyframe behind it."""
    with recorder.record(file) as recording, BulletWorld(name="lab"):
        cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
        for number in range(120):
            cup.set_position([0, 0, number])
        step = recording.length - 1
    content = file.read_bytes()
    chunks = [extent for opcode, *extent in container_records(content) if opcode == CHUNK]
    file.write_bytes(zeroed(content, *chunks[len(chunks) // 2]))
    with replay.open(file) as log:
        assert log.world_at(step).get_object("cup").get_position() == [0, 0, 119]
    with (
        replay.open(file) as log,
        pytest.raises(replay.Damaged, match=r"the part before step .* is lost; restore the world without exact=True"),
    ):
        log.world_at(step, exact=True)
    assert len(open_worlds()) == 1, "the one that could be had"


@seeded("futures of exact worlds", range(20), 1)
def test_the_future_of_an_exact_world_is_the_originals(file: Path, seeds: range) -> None:
    """After random steps of random plans, two seconds more are as if the original run had gone on, bit for bit."""
    dice = random.Random(seeds[0])
    for seed in dice.sample(range(1000), len(seeds)):
        with recorder.record(file, overwrite=True):
            RandomPlan(seed).run()
        with recorder.record(
            file.with_name("beginning.mcap"), overwrite=True
        ) as beginning:  # the same plan, until somewhere
            *others, world = RandomPlan(seed, changes=dice.randrange(5, 20)).go()
            step = beginning.length - 1
            world.simulate_steps(480)
            wanted = everything(world)
            for one in (*others, world):
                one.exit()
        with replay.open(file) as log, log.world_at(step, world.name, exact=True) as restored:
            restored.simulate_steps(480)
            assert everything(restored) == wanted, f"plan {seed}, step {step}"


@pytest.mark.costly
@seeded("futures of the demo", range(10), 1)
def test_the_future_of_the_demo_is_the_originals(demo_log: Path, seeds: range) -> None:
    """The same for the demo, whose original run is gone: it is made again with the public methods only."""
    with replay.open(demo_log) as log:
        for seed in seeds:
            step = random.Random(seed).randrange(20, end_of(log))
            with log.world_at(step, exact=True) as world:
                world.simulate_steps(480)
                assert everything(world) == made_by_hand(log, step), f"step {step}"


def made_by_hand(log: replay.Recording, step: int) -> dict[str, object]:
    with BulletWorld() as world:
        for change in log.records(Mutation, stop=step + 1):
            make(world, change)
        world.simulate_steps(480)
        return everything(world)


def make(world: BulletWorld, change: Mutation) -> None:
    command = change.WhichOneof("command")
    details = getattr(change, command)
    if isinstance(details, OpenWorld):
        return
    if command == "load_body":
        Object(
            details.body,
            details.type,
            details.path,
            details.position,
            details.orientation,
            world,
            list(details.color) or None,
        )
    elif command == "set_gravity":
        world.set_gravity(details.gravity)
    elif command == "set_robot":
        world.robot = world.get_object(details.body)
    elif command == "simulate":
        world.simulate(details.steps / 240)
    elif command == "move_body":
        world.get_object(details.body).set_position(details.position, details.orientation)
    elif command == "move_joints":
        world.get_object(details.body).set_joint_positions(dict(zip(details.joints, details.positions, strict=True)))
    elif command == "attach_body":
        attachment.attach(
            world.get_object(details.carrier), world.get_object(details.body), details.carrier_link, details.body_link
        )
    elif command == "detach_body":
        world.get_object(details.body).detach(world.get_object(details.carrier))
    else:
        raise AssertionError(command)
