"""Motions in simulated time, from their recording: states within them, worlds that go on with them, and damage."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from pycram.fluents import world as world_fluents
from pycram.language import par, pursue
from pycram.world import transaction
from pycram.world.transaction import take_snapshot
from recorder.records import Following, Keyframe, Mutation
from recorder.records.motion import time_of
from replay.errors import Damaged
from replay.recording import Recording
from replay.restore.verify import verify
from replay.restore.world import world_at
from replay.state.fold import state_at
from tests.replay import hostile
from tests.smooth_motions import drive, move

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from recorder.records import Record

PAN, ELBOW = "shoulder_pan_joint", "elbow_joint"


@pytest.fixture(scope="module")
def motions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two joints and the base of an arm that carries a cup move at the same time; one is stopped on its way."""
    file = tmp_path_factory.mktemp("motions") / "run.mcap"
    frequent = pytest.MonkeyPatch()
    frequent.setattr(transaction, "TRANSACTIONS_PER_KEYFRAME", 4)
    with recorder.record(file), BulletWorld(name="lab") as world:
        world.set_gravity([0, 0, -9.81])
        robot = Object("ur5", "robot", "ur5.urdf", [0, 0, 1])
        cup = Object("cup", "cup", "cup.stl", robot.get_link_position("tool0"))
        robot.attach(cup, "tool0")
        Object("ball", "ball", "apple.stl", [0, 2, 3])
        far = world_fluents.joint(robot, PAN) > 0.35
        par(
            lambda: pursue(far.wait_for, lambda: move(robot, {PAN: 0.5}, 0.5)),
            lambda: move(robot, {ELBOW: 0.4}, 0.6),
            lambda: drive(robot, [0, 0, 0], [0.3, 0.1, 0.2], 0.4),
        )
    frequent.undo()
    return file


@pytest.fixture
def log(motions: Path) -> Iterator[Recording]:
    with Recording(motions) as opened:
        yield opened


def step_of(log: Recording, wanted: Callable[[Mutation], bool], number: int = 0) -> int:
    return [record.seq for record in log.records(Mutation) if wanted(record)][number]


def is_simulation(record: Mutation) -> bool:
    return record.HasField("simulate")


def test_it_verifies_to_the_last_bit(log: Recording) -> None:
    result = verify(log)
    assert result.exact, result.problem
    assert result.keyframes > 3


def test_a_state_tells_what_is_followed(log: Recording) -> None:
    middle = step_of(log, is_simulation, 3)
    world = state_at(log, middle).world("lab")
    assert [(each.begin.number, each.begin.body, each.stopped) for each in world.following.values()] == [
        (1, "ur5", 0),
        (2, "ur5", 0),
        (3, "ur5", 0),
    ]
    stop = step_of(log, lambda record: record.HasField("stop_trajectory"))
    stopped = state_at(log, stop).world("lab")
    assert [each.stopped for each in stopped.following.values() if each.stopped] == [stopped.sim_step]
    assert not state_at(log, step_of(log, is_simulation, -1)).world("lab").following


def test_a_motion_slows_down_evenly_when_it_is_stopped() -> None:
    following = Following(began=24, stopped=48)
    times = [time_of(following, step) * 240 for step in range(24, 100)]
    assert times[:25] == list(range(25))
    speeds = [b - a for a, b in pairwise(times[24:])]
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[0] == pytest.approx(1, abs=0.02)
    assert speeds[36:] == [0.0] * len(speeds[36:])


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("where", [2, -4])
def test_a_world_goes_on_with_its_motions(log: Recording, where: int, exact: bool) -> None:
    step = step_of(log, is_simulation, where)
    end = step_of(log, is_simulation, -1)
    with world_at(log, step, exact=exact) as world:
        for record in log.records(Mutation, step + 1, end + 1):
            if record.HasField("simulate"):
                world.simulate_steps(record.simulate.steps)
            elif record.HasField("stop_trajectory"):
                world.stop_trajectory(record.stop_trajectory.number)
        body = world.get_object("ur5")
        now, recorded = take_snapshot(body), state_at(log, end).body("ur5")
        assert not world.trajectories.active
    if exact:
        assert now.positions == tuple(recorded.joints.values())
        assert now.pose == recorded.pose
    assert now.positions == pytest.approx(tuple(recorded.joints.values()), abs=1e-4)
    assert now.pose[0] == pytest.approx(recorded.position, abs=1e-6)


def test_within_a_stretch(tmp_path: Path) -> None:
    """A motion alone is one record; a moment in it has a state, and a world that goes on from there."""
    file = tmp_path / "one.mcap"
    with recorder.record(file), BulletWorld(name="lab"):
        move(Object("ur5", "robot", "ur5.urdf", [0, 0, 1]), {PAN: 0.5}, 0.5)
    with Recording(file) as log:
        begun = step_of(log, is_simulation) - 1
        state = state_at(log, begun, 0.25)
        assert state.body("ur5").joints[PAN] == pytest.approx(0.25, abs=0.05)
        assert len(state.world("lab").following) == 1
        for exact in (True, False):
            with world_at(log, begun, exact=exact, moment=0.25) as world:
                assert world.get_object("ur5").get_joint_position(PAN) == pytest.approx(0.25, abs=0.05)
                world.simulate(0.5)
                assert world.get_object("ur5").get_joint_position(PAN) == pytest.approx(0.5, abs=1e-3)
                assert not world.trajectories.active


def test_blame_tells_that_a_joint_followed_a_trajectory(log: Recording) -> None:
    end = step_of(log, is_simulation, -1)
    with replay.open(log.path) as opened:
        assert opened.blame(f"ur5.{ELBOW}", end).how == "driven"
        assert opened.blame("ball", end).how == "physics"


DAMAGES: dict[str, Callable[[Mutation], object]] = {
    "NaN": lambda r: r.begin_trajectory.trajectory.positions.__setitem__(-1, float("nan")),
    "infinite": lambda r: r.begin_trajectory.trajectory.times.__setitem__(-1, float("inf")),
    "too few numbers": lambda r: r.begin_trajectory.trajectory.positions.pop(),
    "no times": lambda r: r.begin_trajectory.trajectory.ClearField("times"),
    "an unknown joint": lambda r: r.begin_trajectory.trajectory.joints.__setitem__(0, "knee"),
    "a speed that is none": lambda r: r.begin_trajectory.trajectory.velocities.__setitem__(-1, 1e300),
    "an unknown body": lambda r: setattr(r.begin_trajectory, "body", "nobody"),
    "years": lambda r: r.begin_trajectory.trajectory.times.__setitem__(-1, 1e9),
    "a number that was": lambda r: setattr(r.begin_trajectory, "number", 0),
    "no joints": lambda r: r.begin_trajectory.trajectory.ClearField("joints"),
}


@pytest.mark.parametrize("what", DAMAGES)
def test_a_trajectory_that_makes_no_sense_is_damage(motions: Path, tmp_path: Path, what: str) -> None:
    step = 0

    def change(records: list[Record], _: object) -> None:
        nonlocal step
        begun = next(each for each in records if isinstance(each, Mutation) and each.HasField("begin_trajectory"))
        step = begun.seq
        DAMAGES[what](begun)
        records[:] = [each for each in records if not isinstance(each, Keyframe)]
        for number, each in enumerate(records):
            each.seq = number
        step = begun.seq

    with Recording(hostile.rewritten(motions, tmp_path / "x.mcap", change)) as log:
        result = verify(log)
        assert result.problem is not None
        assert result.problem.step == step
        for exact in (True, False):
            if exact or what != "a number that was":
                with pytest.raises(Damaged):
                    world_at(log, step, exact=exact)
