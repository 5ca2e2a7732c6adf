"""``world.settle`` simulates until everything is at rest, and says whether it is."""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING

import numpy as np
import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import BadArgument
from pycram.world.simulation import SLOW_TURN, Restless
from recorder import geometry
from recorder.records import Mutation
from replay.restore.verify import verify

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import MemorySink


def turn_within(world: BulletWorld, body: Object, seconds: float) -> tuple[float, float]:
    before = body.get_position_and_orientation()
    world.simulate(seconds)
    after = body.get_position_and_orientation()
    dot = abs(sum(a * b for a, b in zip(before[1], after[1], strict=True)))
    return math.dist(before[0], after[0]), 2 * math.acos(min(1.0, dot))


def test_what_falls_is_at_rest_when_it_returns(world: BulletWorld, sink: MemorySink) -> None:
    Object("floor", "environment", "plane.urdf")
    milk = Object("milk", "milk", "milk.stl", [0, 0, 0.5])
    bowl = Object("bowl", "bowl", "bowl.stl", [0.5, 0, 0.3], [0.3, 0, 0, 1])
    assert world.settle()
    assert 0.3 < world.sim_step / 240 < 5
    for body in (milk, bowl):
        moved, turned = turn_within(world, body, 1.0)
        assert moved < 1e-3
        assert turned < 0.01
    (settled, _) = [r for r in sink.records if isinstance(r, Mutation) and r.WhichOneof("command") == "simulate"][:2]
    assert settled.simulate.settled is True
    assert settled.simulate.steps == settled.sim_step


def test_what_rolls_on_is_not_at_rest(world: BulletWorld, sink: MemorySink) -> None:
    Object("floor", "environment", "plane.urdf")
    bottle = Object("bottle", "bottle", "bottle.stl", [0, 0, 0.039], [0, math.sqrt(0.5), 0, math.sqrt(0.5)])
    world.set_gravity([0, 0.3, -9.8])  # a slight slope
    Object("milk", "milk", "milk.stl", [1, 0, 0.11])
    with pytest.warns(Restless, match=r"not at rest after 1\.5 s of simulation: bottle \(\d.* rad/s\)$") as warned:
        assert not world.settle(1.5)
    assert warned[0].filename == __file__
    (speed,) = warned[0].message.speeds.values()  # type: ignore[union-attr]
    assert world.sim_step == 360
    assert turn_within(world, bottle, 0.1)[1] == pytest.approx(0.1 * speed.ratio * SLOW_TURN, rel=0.2)
    simulated = [r for r in sink.records if isinstance(r, Mutation) and r.WhichOneof("command") == "simulate"]
    assert simulated[0].simulate.HasField("settled")
    assert not simulated[0].simulate.settled
    assert not simulated[1].simulate.HasField("settled")


def test_many_things_come_to_rest_although_one_or_another_trembles_at_any_moment(world: BulletWorld) -> None:
    Object("floor", "environment", "plane.urdf")
    drawn = random.Random(1)
    for number in range(60):
        kind = ("plate", "pot")[number % 2]
        position = [number % 8 * 0.3 - 3, number // 8 * 0.3 - 3, 0.1 + drawn.random() * 0.01]
        Object(f"{kind} {number}", kind, f"{kind}.stl", position, [0, 0, drawn.uniform(-1, 1), 1])
    assert world.settle(1.0)
    before = [body.get_position() for body in world.objects]
    world.simulate(1.0)
    after = [body.get_position() for body in world.objects]
    assert max(map(math.dist, before, after)) < 1e-3


def test_what_begins_to_tip_is_not_at_rest(world: BulletWorld) -> None:
    Object("floor", "environment", "plane.urdf")
    lean = math.atan(0.035 / 0.1) - 0.001  # on its edge, but for a hair
    height = 0.1 * math.cos(lean) + 0.035 * math.sin(lean)
    milk = Object("milk", "milk", "milk.stl", [0, 0, height + 0.001], [0, math.sin(lean / 2), 0, math.cos(lean / 2)])
    assert world.settle()
    moved, turned = turn_within(world, milk, 1.0)
    assert moved < 1e-3
    assert turned < 0.01


def test_the_robot_and_what_it_holds_need_no_rest(scene: BulletWorld) -> None:
    assert scene.settle(1.0)
    scene.robot.attach(scene.get_object("milk"), "l_gripper_tool_frame")
    assert scene.settle(1.0)


def test_a_recording_of_it_verifies(tmp_path: Path) -> None:
    file = tmp_path / "settled.mcap"
    with recorder.record(file), BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        Object("cup", "cup", "cup.stl", [0, 0, 0.3], [0.4, 0.2, 0, 1])
        world.simulate(0.01)  # off the grid of samples
        assert world.settle()
    with replay.open(file) as log:
        verification = verify(log)
    assert verification.problem is None
    assert verification.largest is None


@pytest.mark.parametrize("timeout", [-1, math.nan, "long", None])
def test_impossible_times_are_refused(world: BulletWorld, timeout: object) -> None:
    with pytest.raises(BadArgument, match="timeout"):
        world.settle(timeout)
    assert world.sim_step == 0


@pytest.mark.slow
@pytest.mark.parametrize(("vessel", "kind", "seed"), [("cup", "knife", 9), ("glass", "knife", 16)])
def test_a_thin_thing_that_trembles_in_a_vessel_is_at_rest(
    world: BulletWorld, vessel: str, kind: str, seed: int
) -> None:
    """The solver turns the thing to and fro, by less than a degree, without end."""
    rng = np.random.default_rng(seed)
    Object("floor", "environment", "plane.urdf")
    around = Object("vessel", vessel, f"{vessel}.stl", [0, 0, 0.1])
    assert world.settle()
    x, y = rng.uniform(-0.03, 0.03, 2)
    turn = geometry.from_rpy(0, float(rng.uniform(0, 1.5)), float(rng.uniform(-3, 3)))
    thing = Object("thing", kind, f"{kind}.stl", [x, y, around.get_AABB()[1][2] + 0.13], turn)
    assert world.settle()
    at, turned = thing.get_position_and_orientation()
    world.simulate(2)
    assert math.dist(thing.get_position(), at) < 2e-3
    assert geometry.angle(thing.get_orientation(), turned) < 0.04
