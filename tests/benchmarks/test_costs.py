"""What things cost, as ratios within one run: ``make bench`` prints the table.

Times of one run are compared with the engine's own step in the same run, since machines are noisy; nothing is asserted
about seconds.
"""

from __future__ import annotations

import itertools
import statistics
import sys
import threading
from contextlib import nullcontext, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
from pycram.bullet_world import BulletWorld
from pycram.fluent import Fluent
from recorder import geometry
from recorder.records import BodyState, Effect, MoveBody, Mutation, Query
from recorder.tracing import journal
from tests.benchmarks.timing import amount, goal, ratio, seconds, settlings, warm_up
from tests.smooth_motions import move, smooth, to

if TYPE_CHECKING:
    from collections.abc import Sequence

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demos"))

import set_the_table

pytestmark = pytest.mark.slow

RECORDING = 1.05  # of the plan without


def demo_seconds(file: Path | None) -> tuple[float, float]:
    """Time of the demo's plan, without loading, and of one step of its scene."""
    with recorder.record(file) if file else nullcontext(), redirect_stdout(StringIO()):
        kitchen = set_the_table.build_scene()
        world = BulletWorld.current_bullet_world
        plan = seconds(lambda: set_the_table.set_table(kitchen))
        step = seconds(lambda: world.engine.step(100)) / 100
        world.exit()
    return plan, step


def test_demo_costs_less_than_1000_steps_and_recording_little(tmp_path: Path) -> None:
    warm_up(lambda: demo_seconds(None))
    plans: list[float] = []
    steps: list[float] = []

    def recorded() -> float:
        plan, step = demo_seconds(tmp_path / f"{len(plans)}.mcap")
        plans.append(plan)
        steps.append(step)
        return plan

    cost = ratio(recorded, lambda: demo_seconds(None)[0], most=RECORDING)
    print(f"\ndemo's plan, recorded: {min(plans):.3f} s, {cost:.3f} times that without, in {len(plans)} rounds")
    print(f"one full-scene step: {min(steps) * 1e3:.2f} ms; the plan costs {min(plans) / min(steps):.0f} steps")
    goal("the plan, in steps", min(plans) / min(steps), 1000)
    goal("the plan recorded, of that without", cost, RECORDING)


def test_what_settling_costs_after_placing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Apart from the plan's other costs: `place` waits until all is at rest, which takes as many steps as it takes."""
    warm_up(lambda: demo_seconds(None))
    settled = settlings(monkeypatch)
    plan, step = demo_seconds(None)
    assert len(settled) >= 4, "each of the four objects was placed"
    took, steps = (sum(column) for column in zip(*settled, strict=True))
    print(f"\nplace's settling: {took:.3f} s of the plan's {plan:.3f}, {steps} steps in {len(settled)} places")
    goal("settling, in the steps that it simulates", took / (steps * step), 2)


def test_recorder_throughput(tmp_path: Path) -> None:
    count = amount(20_000, 4_000)

    def write() -> None:
        for number in range(count):
            journal.emit(
                Mutation(
                    move_body=MoveBody(body="milk", position=(1.3, 1, number), orientation=(0, 0, 0, 1)),
                    effect=Effect(bodies=[BodyState(body="milk", position=(1.3, 1, 0.9), orientation=(0, 0, 0, 1))]),
                ),
                world="world_1",
            )

    def build() -> None:
        for number in range(count):
            Mutation(
                move_body=MoveBody(body="milk", position=(1.3, 1, number), orientation=(0, 0, 0, 1)),
                effect=Effect(bodies=[BodyState(body="milk", position=(1.3, 1, 0.9), orientation=(0, 0, 0, 1))]),
            ).SerializeToString()

    with recorder.record(tmp_path / "x.mcap"):
        recording = seconds(write)
    building = seconds(build)
    small = recording_of_small_records(tmp_path / "y.mcap", count)
    print(f"\nmutations with a moved body, frames and a line: {count / recording:.0f} a second")
    print(f"small records (events): {count / small:.0f} a second")
    print(f"building and serializing alone: {count / building:.0f} a second")
    goal("recording, of building and serializing alone", recording / building, 10)


def recording_of_small_records(file: Path, count: int) -> float:
    def write() -> None:
        for _ in range(count):
            journal.emit(Query(name="contact", answer_json="true"), world="world_1")

    with recorder.record(file):
        return seconds(write)


def set_all(fluent: Fluent, count: int, dependants: Sequence[Fluent] = ()) -> float:
    """Seconds to set a fluent to all numbers, and to read its dependants each time."""

    def update() -> None:
        for number in range(count):
            fluent.set_value(number)
            for dependant in dependants:
                dependant.get_value()

    return seconds(update)


def set_all_awaited(fluent: Fluent, count: int, dependants: Sequence[Fluent]) -> float:
    """The same, while a thread each waits for its dependants, and for the last number."""
    fluent.set_value(None)
    waiting = [threading.Thread(target=(one.OR(True).AND(fluent == count - 1)).wait_for) for one in dependants]
    for thread in waiting:
        thread.start()
    took = set_all(fluent, count)
    return took + seconds(lambda: [thread.join() for thread in waiting])


def test_fluent_updates(tmp_path: Path) -> None:
    count, assigned, cell, lock = amount(10_000, 1_000), 10_000, [0], threading.RLock()
    fluent = Fluent(0, "counter")
    dependants = [*(fluent > limit for limit in range(8)), fluent.pulsed(), (fluent * 2 == 4).pulsed()]

    def assign() -> None:
        for number in range(assigned):
            with lock:
                cell[0] = number

    assigning = seconds(assign) * count / assigned
    took = {
        "10 dependants": set_all(fluent, count),
        "10 dependants, each read every time": set_all(fluent, count, dependants),
        "10 dependants, a thread waits for each": set_all_awaited(fluent, count, dependants),
    }
    with recorder.record(tmp_path / "x.mcap"):
        took["10 dependants, recorded"] = set_all(fluent, count)
    print(f"\n{count} assignments under a lock: {assigning * 1e3:.1f} ms")
    for what, time_ in took.items():
        goal(f"{count} updates of a fluent, {what}: {time_:.3f} s, times that", time_ / assigning, 500)


def test_attaching_and_leaving(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "x.mcap"), redirect_stdout(StringIO()):
        set_the_table.build_scene()
        world = BulletWorld.current_bullet_world
        robot, milk = world.robot, world.get_object("milk")
        step = seconds(lambda: world.engine.step(100)) / 100

        def hold() -> None:
            robot.attach(milk, "l_gripper_tool_frame")
            robot.detach(milk)

        holding = statistics.median(seconds(hold) for _ in range(50))
        ending = seconds(world.exit)
    print(f"\nattach + detach, recorded: {holding * 1e3:.2f} ms ({holding / step:.2f} steps)")
    print(f"exit of the full scene: {ending * 1e3:.1f} ms ({ending / step:.1f} steps)")
    goal("attach + detach, in steps", holding / step, 1)
    goal("exit, in steps", ending / step, 10)


@pytest.mark.costly
def test_following_trajectories_costs_little_beside_the_physics(scene: BulletWorld) -> None:
    """A second of an arm with seven joints and of a base that move, beside one in which nothing does."""
    robot = scene.robot
    assert robot is not None
    assert robot.description is not None
    joints = robot.description.arm("left").joints
    home = [robot.get_joint_position(name) for name in joints]
    away = [at + 0.05 * (-1 if at > 0 else 1) for at in home]
    goals = itertools.cycle([away, home])

    def still() -> float:
        return seconds(lambda: scene.simulate(1))

    def arm() -> float:
        scene.begin_trajectory(robot, to(robot, dict(zip(joints, next(goals), strict=True)), 1.0))
        return seconds(lambda: scene.simulate(1))

    def base() -> float:
        x, y, _ = robot.get_position()
        heading = geometry.to_rpy(robot.get_orientation())[2]
        scene.begin_trajectory(robot, smooth((), [x, y, heading], [x, y, heading + 0.01], 1.0))
        return seconds(lambda: scene.simulate(1))

    goal("simulation with an arm that follows, plain simulation", ratio(arm, still, most=1.5), 1.5)
    goal("simulation with a base that follows, plain simulation", ratio(base, still, most=1.5), 1.5)


def test_waiting_for_a_motion_costs_no_more_than_simulating_it(scene: BulletWorld) -> None:
    robot = scene.robot
    assert robot is not None
    joint = "head_pan_joint"
    sides = itertools.cycle([0.3, -0.3])
    following = lambda: seconds(lambda: move(robot, {joint: next(sides)}, 1.0))  # noqa: E731

    def driven() -> float:
        scene.begin_trajectory(robot, to(robot, {joint: next(sides)}, 1.0))
        return seconds(lambda: scene.simulate(1))

    goal("waiting for a motion, simulating it", ratio(following, driven, most=1.1), 1.1)
