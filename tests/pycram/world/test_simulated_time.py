"""Simulated time passes for all who wait together: branches move at the same time, and can be interrupted."""

from __future__ import annotations

import math
import signal
import threading
from functools import partial
from typing import TYPE_CHECKING

import pytest

import recorder
from pycram.bullet_world import BulletWorld, Object
from pycram.failures import DeadlockedBranches, PlanFailure, WorldClosed
from pycram.fluent import Fluent, network, whenever
from pycram.fluents import world as world_fluents
from pycram.language import in_thread, par, pursue, timeout
from pycram.language.timeouts import TimedOut
from pycram.process_module import execution_environment
from pycram.projection import project
from pycram.scheduling.schedule import LockHeld, seed_order
from pycram.world.simulation import wait
from recorder import geometry
from recorder.records import Mutation, Task
from replay.compare import differing
from replay.recording import Recording
from replay.restore.verify import verify
from tests.smooth_motions import drive, move, to

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.conftest import MemorySink

PAN, ELBOW, WRIST = "shoulder_pan_joint", "elbow_joint", "wrist_1_joint"
SOON = 0.2 * 240  # steps within which a stopped motion stands


@pytest.fixture
def ur5(world: BulletWorld) -> Object:
    return Object("ur5", "robot", "ur5.urdf", [0, 0, 1])


@pytest.fixture
def seeded() -> Iterator[Callable[[int, str], None]]:
    yield lambda seed, order="": seed_order(seed, order)
    seed_order(None)


def simulations(sink: MemorySink) -> list[Mutation]:
    return [record for record in sink.of(Mutation) if record.HasField("simulate")]


def test_branches_move_at_the_same_time(ur5: Object, sink: MemorySink) -> None:
    world = ur5.world
    ends = {}

    def moved(name: str, seconds: float) -> None:
        move(ur5, {name: 0.5}, seconds)
        ends[name] = world.sim_step

    par(lambda: moved(PAN, 0.4), lambda: moved(ELBOW, 0.2), lambda: drive(ur5, [0, 0, 0], [0.2, 0, 0], 0.3))
    assert ends == {PAN: 96, ELBOW: 48}
    assert [record.simulate.steps for record in simulations(sink)] == [48, 24, 24]
    assert world.sim_step == 96


def test_time_waits_for_a_branch_that_has_something_to_do(ur5: Object) -> None:
    """Two motions after one another take as long as one of the length of both, however the branches take turns."""
    world = ur5.world

    def two_steps() -> None:
        move(ur5, {PAN: 0.2}, 0.2)
        move(ur5, {PAN: 0.4}, 0.2)

    par(lambda: move(ur5, {ELBOW: 0.5}, 0.4), two_steps)
    assert world.sim_step == 96


@pytest.mark.slow
def test_the_seed_decides_the_order(tmp_path: Path, seeded: Callable[..., None]) -> None:
    def run(name: str, seed: int) -> list[object]:
        seeded(seed)
        with recorder.record(tmp_path / name), BulletWorld(name="w"):
            robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 1])
            elbow = world_fluents.joint(robot, ELBOW)
            stirred = Fluent(0, "stirred")
            par(
                lambda: [move(robot, {PAN: 0.3}, 0.2), stirred.set_value(1), move(robot, {PAN: 0}, 0.1)],
                lambda: move(robot, {ELBOW: 0.5}, 0.3),
                lambda: [(elbow > 0.2).wait_for(), move(robot, {WRIST: 0.2}, 0.2)],
            )
        with Recording(tmp_path / name) as log:
            return list(log.records())

    first, again, other = run("a.mcap", 3), run("b.mcap", 3), run("c.mcap", 4)
    assert len(first) == len(again)
    assert not [each for each in zip(first[1:], again[1:], strict=True) if differing(*each)]
    assert [type(record) for record in first] != [type(record) for record in other] or any(
        differing(*each) for each in zip(first[1:], other[1:], strict=True)
    )


def test_a_plan_stops_the_arm_when_the_cup_falls(ur5: Object) -> None:
    world = ur5.world
    x, y, z = ur5.get_link_position("tool0")
    Object("table", "environment", "plane.urdf", [0, 0, z - 0.07])
    cup = Object("cup", "cup", "cup.stl", [x, y + 0.25, z - 0.02])
    world.settle()
    upright, began = cup.get_orientation(), world.sim_step
    tipped = Fluent(None, "tipped")

    def watch() -> None:
        fallen = network(lambda pose: geometry.angle(pose[1], upright) > 0.3, world_fluents.pose(cup))
        fallen.IS(other=True).wait_for()
        tipped.set_value(world.sim_step)

    pursue(watch, lambda: move(ur5, {PAN: 1.4}, 2.0))
    assert began < tipped.get_value() < began + 480
    assert world.sim_step - tipped.get_value() <= SOON
    assert 0.1 < ur5.get_joint_position(PAN) < 1.3


def test_whenever_reacts_while_an_arm_moves(ur5: Object) -> None:
    seen = []
    elbow = world_fluents.joint(ur5, ELBOW)

    def note() -> None:
        seen.append(ur5.get_joint_position(ELBOW))

    pursue(lambda: whenever(elbow.pulsed(), note), lambda: move(ur5, {ELBOW: 0.5}, 0.5))
    assert len(seen) >= 14
    assert sorted(seen) == seen


def test_a_timeout_in_simulated_time_stops_a_motion(ur5: Object) -> None:
    world = ur5.world
    with pytest.raises(TimedOut), timeout(0.5, simulated=True):
        move(ur5, {PAN: 1.0}, 1.0)
    assert 120 <= world.sim_step <= 120 + SOON
    assert not world.trajectories.active
    where = ur5.get_joint_position(PAN)
    world.simulate(0.3)
    assert ur5.get_joint_position(PAN) == pytest.approx(where, abs=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_a_failure_of_another_branch_stops_a_motion(ur5: Object, seeded: Callable[..., None], seed: int) -> None:
    world = ur5.world
    seeded(seed)
    failed = []

    def fail() -> None:
        wait(world, lambda: world.sim_step >= 60)
        failed.append(world.sim_step)
        raise PlanFailure("spilt")

    with pytest.raises(PlanFailure, match="spilt"):
        pursue(lambda: move(ur5, {PAN: 1.0}, 1.0), fail, lambda: move(ur5, {ELBOW: 0.5}, 2.0))
    assert failed == [64]
    assert world.sim_step - 64 <= SOON
    assert not world.trajectories.active
    assert 0 < ur5.get_joint_position(PAN) < 0.9


def press_ctrl_c(world: BulletWorld, at: int) -> Callable[[], None]:
    def press() -> None:
        if world.sim_step == at:
            signal.raise_signal(signal.SIGINT)

    return press


@pytest.mark.parametrize("within", ["a branch", "the plan itself"])
def test_ctrl_c_stops_a_motion(tmp_path: Path, within: str) -> None:
    with recorder.record(tmp_path / "run.mcap"), BulletWorld(name="w") as world:
        robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 1])
        world.time_listeners[press_ctrl_c(world, 80)] = None
        swing, lift = partial(move, robot, {PAN: 1.0}, 1.0), partial(move, robot, {ELBOW: 0.5}, 1.0)
        with pytest.raises(KeyboardInterrupt):
            par(swing, lift) if within == "a branch" else swing()
        assert 80 < world.sim_step <= 80 + SOON
        assert not world.trajectories.active
    with Recording(tmp_path / "run.mcap") as log:
        assert verify(log).exact


def test_time_passes_while_a_worker_thread_works(ur5: Object) -> None:
    moved = threading.Event()
    par(
        lambda: [move(ur5, {PAN: 0.5}, 0.2), moved.set()],
        lambda: in_thread(moved.wait, 60),
    )
    assert moved.is_set()


def test_who_simulates_drives_the_others_on(ur5: Object, sink: MemorySink) -> None:
    world = ur5.world
    par(lambda: move(ur5, {PAN: 0.5}, 0.5), lambda: world.simulate(0.3))
    assert ur5.get_joint_position(PAN) == pytest.approx(0.5, abs=1e-3)
    assert world.sim_step == 120
    assert [record.simulate.steps for record in simulations(sink)] == [72, 48]


def test_in_real_time_the_clock_drives(ur5: Object) -> None:
    world = ur5.world
    world.set_realtime(True)
    move(ur5, {PAN: 0.3}, 0.2)
    with pytest.raises(PlanFailure, match="enough"):
        pursue(
            lambda: move(ur5, {PAN: 0.5}, 60), lambda: [wait(world, lambda: world.sim_step > 80), fail_with("enough")]
        )
    world.set_realtime(False)
    assert not world.trajectories.active


def fail_with(text: str) -> None:
    raise PlanFailure(text)


def test_when_real_time_ends_the_plan_drives_on(ur5: Object) -> None:
    world = ur5.world
    world.set_realtime(True)
    par(
        lambda: move(ur5, {PAN: 0.3}, 1.0),
        lambda: [wait(world, lambda: world.sim_step >= 16), world.set_realtime(False)],
    )
    assert ur5.get_joint_position(PAN) == pytest.approx(0.3, abs=1e-3)


@pytest.mark.slow
def test_threads_of_a_plan_move_at_the_same_time(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "run.mcap"), BulletWorld(name="w") as world:
        robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 1])
        together = threading.Event()

        def gather() -> None:
            """Holds the first up in the middle of its motion until all move: a busy machine may start the others late."""
            for _ in range(6000):
                if len(world.trajectories.active) == 3:
                    together.set()
                if together.wait(0.01):
                    break

        world.time_listeners[gather] = None
        threads = [threading.Thread(target=move, args=(robot, {name: 0.5}, 0.5)) for name in (PAN, ELBOW, WRIST)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert [robot.get_joint_position(name) for name in (PAN, ELBOW, WRIST)] == pytest.approx([0.5] * 3, abs=1e-3)
        assert world.sim_step < 3 * 120  # they didn't wait for each other
    with Recording(tmp_path / "run.mcap") as log:
        assert verify(log).exact


@pytest.mark.parametrize("environment", ["simulated", "continuous"])
def test_a_limit_of_simulated_time_strikes_where_nothing_else_can_end_the_wait(
    world: BulletWorld, sink: MemorySink, environment: str
) -> None:
    answer = Fluent(name="answer")
    with execution_environment(environment):
        with pytest.raises(TimedOut, match="within 20 s of simulated time"), timeout(20, simulated=True):
            answer.wait_for()
        assert world.sim_step == 20 * 240
        assert len(simulations(sink)) == 2, "not one for each sample"
        with pytest.raises(TimedOut), timeout(1, simulated=True):
            par(answer.wait_for, lambda: Fluent().wait_for(timeout=0.01))  # the wall clock comes first
        assert world.sim_step == 21 * 240


def test_time_passes_for_a_fluent_that_follows_a_world_if_motions_take_time(world: BulletWorld) -> None:
    world.set_gravity([0, 0, -9.81])
    floor = Object("floor", "environment", "plane.urdf")
    cup = Object("cup", "cup", "cup.stl", [0, 0, 1])
    with execution_environment("continuous"):
        assert world_fluents.contact(cup, floor).wait_for()
        assert 0.4 < world.sim_step / 240 < 0.6
        with pytest.raises(DeadlockedBranches):
            Fluent().wait_for()


def test_a_predicate_is_called_once_each_thirtieth_of_a_second(world: BulletWorld) -> None:
    moments: list[int] = []

    def ready() -> bool:
        moments.append(world.sim_step)
        return len(moments) == 6

    par(lambda: wait(world, ready), lambda: [world.simulate_steps(3), world.simulate_steps(10)])
    assert moments == [0, 8, 16, 24, 32, 40]


def test_what_a_predicate_raises_comes_where_somebody_waits(ur5: Object) -> None:
    world = ur5.world

    def ready() -> bool:
        return bool(1 / (world.sim_step - 16)) if world.sim_step else False

    def waits() -> None:
        with pytest.raises(ZeroDivisionError):
            wait(world, lambda: world.sim_step > 8 and ready())

    par(waits, lambda: move(ur5, {PAN: 0.2}, 0.2))
    assert world.sim_step == 48


def test_a_wait_ends_with_its_world(ur5: Object) -> None:
    world = ur5.world

    def waits() -> None:
        with pytest.raises(WorldClosed):
            move(ur5, {PAN: 1.0}, 1.0)

    par(waits, lambda: [wait(world, lambda: world.sim_step > 20), world.exit()])


def test_who_holds_a_lock_cant_wait(world: BulletWorld) -> None:
    with pytest.raises(LockHeld), world.lock:
        wait(world, lambda: False)


@pytest.mark.parametrize("order", ["added", "pct:1:3:40"])
def test_orders_that_are_asked_for(ur5: Object, seeded: Callable[..., None], order: str) -> None:
    """Who waits for time isn't in a deadlock."""
    seeded(1, order)
    done = Fluent(0, "done")
    par(lambda: [move(ur5, {PAN: 0.3}, 0.2), done.set_value(1)], (done == 1).wait_for)
    assert ur5.world.sim_step == 48


@pytest.mark.slow
def test_a_projection_sees_what_goes_on_meanwhile(ur5: Object) -> None:
    """In the child the other branch's arm moves on, though that branch isn't there."""
    world = ur5.world

    def look_ahead() -> None:
        wait(world, lambda: world.sim_step >= 40)
        found = project(lambda: [move(ur5, {ELBOW: 0.4}, 0.5), ur5.get_joint_position(PAN)][1])
        assert found.result == pytest.approx(0.5, abs=1e-3)
        assert ur5.get_joint_position(PAN) < 0.4
        assert world.sim_step == 40

    par(lambda: move(ur5, {PAN: 0.5}, 0.5), look_ahead)
    assert world.sim_step == 120


@pytest.mark.slow
def test_a_projection_that_ends_in_the_middle_of_a_motion_has_no_state_to_restore(ur5: Object) -> None:
    number = ur5.world.begin_trajectory(ur5, to(ur5, {PAN: 0.5}, 1.0))
    found = project(lambda: [ur5.world.simulate(0.5), ur5.get_joint_position(PAN)][1])
    assert found.result == pytest.approx(0.25, abs=1e-3)
    assert found.state is None
    ur5.world.stop_trajectory(number)
    assert project(ur5.world.simulate, 0.1).state is not None


@pytest.mark.slow
def test_motions_that_are_cancelled_anywhere_stand_soon(tmp_path: Path) -> None:
    with recorder.record(tmp_path / "run.mcap"), BulletWorld(name="w") as world:
        robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 1])
        for number in range(12):
            began, goal = world.sim_step, 0.5 * (-1) ** number
            until = began + 5 * number

            def later(until: int = until) -> None:
                wait(world, lambda: world.sim_step >= until)

            pursue(later, lambda goal=goal: move(robot, {PAN: goal, ELBOW: goal / 2}, 0.4))
            assert not world.trajectories.active
            assert world.sim_step - 8 * math.ceil(until / 8) <= SOON
    with Recording(tmp_path / "run.mcap") as log:
        assert verify(log).exact
        stopped = [record for record in log.records(Task) if record.status == Task.CANCELLED]
    assert len(stopped) > 5
