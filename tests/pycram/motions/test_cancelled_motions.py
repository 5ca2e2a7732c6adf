"""Motions of the four robots that are cancelled at any moment, in any way: they stand soon, and all goes on from there."""

from __future__ import annotations

import math
import random
import signal
from functools import partial
from typing import TYPE_CHECKING

import pytest

import recorder
from pycram.failures import PlanFailure
from pycram.language import pursue, timeout
from pycram.language.timeouts import TimedOut
from pycram.process_module import execution_environment
from pycram.projection import project
from pycram.world.simulation import wait
from recorder import geometry
from recorder.records import STEPS_PER_SECOND, Task
from replay.recording import Recording
from replay.restore.verify import verify
from tests.measures import seeded
from tests.pycram.motions import household
from tests.pycram.motions.household import HOUSEHOLD, KITCHEN, PLACES, perform

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pycram.bullet_world import BulletWorld, Object

    Motion = Callable[[], object]

SOON = 0.2 * STEPS_PER_SECOND  # steps within which a motion stands
EVERY = 8  # steps at which somebody who waits is asked
DRAWER = "sink_area_left_upper_drawer_main_joint"
HANDLE = "sink_area_left_upper_drawer_handle"
SIZE = 4


@seeded("random cancellations of motions", range(100), SIZE)
def test_a_motion_that_is_cancelled_anywhere_stands_soon_and_can_go_on(
    tmp_path: Path, seeds: range, record_property: pytest.RecordProperty
) -> None:
    robot = list(PLACES)[seeds[0] // SIZE % len(PLACES)]
    with recorder.record(tmp_path / "run.mcap"):
        for world in household.build(robot):
            steps = [cancel(world, random.Random(seed)) for seed in seeds]
    record_property("cancelled", len(steps))
    record_property("s until they stood", [each / STEPS_PER_SECOND for each in steps])
    with Recording(tmp_path / "run.mcap") as log:
        assert verify(log).exact
        ends = {Task.CANCELLED, Task.FAILED}  # Ctrl-C is a failure
        ended = [each for each in log.records(Task) if each.kind == "motion" and each.status in ends]
    assert len(ended) >= len(seeds)


def cancel(world: BulletWorld, dice: random.Random) -> int:
    """Cancels a motion in its midst; returns how many steps it took to stand."""
    robot, place = world.robot, PLACES[world.robot.name]
    while True:
        robot.set_position_and_orientation(*robot.original_pose)
        for kitchen in world.get_objects_by_name("kitchen"):
            kitchen.set_joint_position(DRAWER, 0.0)
        thing = household.put(world, place, dice.choice(("milk", "bowl", "cup", "breakfast_cereal")), 0)
        try:
            motion = any_motion(world, thing, dice)
            expected = project(motion)
            if expected.succeeded and expected.duration > 0.1:
                break
        except PlanFailure:  # of what comes first, as picking it up
            pass
        thing.remove()
    moment = world.sim_step + round(dice.uniform(0.05, 0.95) * expected.duration * STEPS_PER_SECOND)
    way = dice.choice((by_a_branch, by_a_limit, by_a_failure, by_ctrl_c))
    way(world, motion, moment)
    took = world.sim_step - EVERY * math.ceil(moment / EVERY)
    assert 0 <= took <= SOON
    assert not world.trajectories.active
    stands, held = robot.get_joint_positions(), in_hand(robot)
    pose = robot.get_position_and_orientation()
    world.simulate(0.25)
    assert robot.get_joint_positions() == pytest.approx(stands, abs=5e-3)
    assert robot.get_position() == pytest.approx(pose[0], abs=1e-6)
    for before, now in zip(held, in_hand(robot), strict=True):
        assert math.dist(before, now) < 1e-3
    with execution_environment("continuous"):
        household.park(world)
    robot.detach_all()
    thing.remove()
    return took


def any_motion(world: BulletWorld, thing: Object, dice: random.Random) -> Motion:
    """Returns a motion that takes time, when all is done that has to come before it."""
    robot, place = world.robot, PLACES[world.robot.name]
    arm = robot.description.arm(place.arm)
    kinds = ["move-arm-joints", "move-tcp", "closing-gripper", "pick-up", "place"]
    kinds += ["looking"] * bool(robot.description.head)
    kinds += ["moving"] * bool(robot.description.drives)
    kinds += ["accessing"] * (place.top == KITCHEN)
    kind = dice.choice(kinds)
    x, y = place.start
    goal = [*place.goal, place.top + HOUSEHOLD[thing.type]]
    slots: dict[str, object] = {
        "move-arm-joints": {f"{place.arm}_arm": [at + dice.uniform(-0.4, 0.4) for at in arm.posture("park").values()]},
        "move-tcp": {
            "arm": place.arm,
            "target": [x - dice.uniform(0.05, 0.2), y - dice.uniform(0.2, 0.4), place.top + dice.uniform(0.2, 0.4)],
        },
        "closing-gripper": {"gripper": place.arm},
        "pick-up": {"object": thing, "arm": place.arm},
        "place": {"object": thing, "target": goal, "arm": place.arm},
        "looking": {"target": [x, y + dice.uniform(-2, 2), place.top]},
        "moving": {"target": [dice.uniform(-0.3, 0.6), dice.uniform(0.3, 1.2), 0]},
        "accessing": {
            "drawer_joint": DRAWER,
            "drawer_handle": HANDLE,
            "part_of": world.get_object("kitchen") if place.top == KITCHEN else None,
            "arm": place.arm,
            "distance": dice.uniform(0.1, 0.3),
        },
    }[kind]
    if kind == "place":
        perform(type="pick-up", object=thing, arm=place.arm)
        household.park(world)
    if kind == "closing-gripper":
        perform(type="opening-gripper", gripper=place.arm)

    def motion() -> object:
        with execution_environment("continuous"):
            return perform(type=kind, **slots)

    return motion


def in_hand(robot: Object) -> list[list[float]]:
    """Returns where each thing is in the robot's hand, m."""
    return [
        geometry.multiply(
            geometry.invert(robot.get_link_position_and_orientation(held.carrier_link)),
            held.body.get_position_and_orientation(),
        )[0]
        for held in robot.carried
    ]


def by_a_branch(world: BulletWorld, motion: Motion, moment: int) -> None:
    pursue(partial(wait, world, lambda: world.sim_step >= moment), motion)


def by_a_limit(world: BulletWorld, motion: Motion, moment: int) -> None:
    with pytest.raises(TimedOut), timeout((moment - world.sim_step) / STEPS_PER_SECOND, simulated=True):
        motion()


def by_a_failure(world: BulletWorld, motion: Motion, moment: int) -> None:
    def fail() -> None:
        wait(world, lambda: world.sim_step >= moment)
        raise PlanFailure("spilt")

    with pytest.raises(PlanFailure, match="spilt"):
        pursue(motion, fail)


def by_ctrl_c(world: BulletWorld, motion: Motion, moment: int) -> None:
    def press() -> None:
        if world.sim_step >= moment:
            del world.time_listeners[press]
            signal.raise_signal(signal.SIGINT)

    world.time_listeners[press] = None
    with pytest.raises(KeyboardInterrupt):
        motion()
