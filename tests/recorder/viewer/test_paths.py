"""Motions that take time, in the viewer: they are animated on simulated time, and their paths are drawn."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from recorder.records import STEPS_PER_SECOND, Mutation
from recorder.viewer.rerun_stream import BLUE, GREY
from tests.recorder.viewer.shown import Shown, view
from tests.smooth_motions import drive, smooth, to

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.recording import Recording

MOTIONS = Path(__file__).parents[2] / "replay" / "golden" / "motions"
ARM = str(MOTIONS / "arm.urdf")
HAND, BASE = "/table/paths/arm/ur5", "/table/paths/arm/base"
JOINTS = {"shoulder_pan_joint": 0.6, "elbow_joint": 0.4}


@pytest.fixture(scope="module")
def log() -> Iterator[Recording]:
    with replay.open(MOTIONS / "0.1.0.mcap") as opened:
        yield opened


@pytest.fixture(scope="module")
def shown(log: Recording, tmp_path_factory: pytest.TempPathFactory) -> Shown:
    return view(log.path, tmp_path_factory.mktemp("shown") / "log.rrd")


def begins(log: Recording) -> dict[int, Mutation]:
    return {r.begin_trajectory.number: r for r in log.records(Mutation) if r.HasField("begin_trajectory")}


def ends(log: Recording) -> dict[int, int]:
    return {each.number: r.seq for r in log.records(Mutation) for each in r.simulate.driven if each.ended}


def line(shown: Shown, entity: str, step: int) -> list[tuple[float, ...]]:
    strips = shown.at(entity, step).get("LineStrips3D:strips", [])
    return [tuple(point) for strip in strips for point in strip]


def color(shown: Shown, entity: str, step: int) -> int:
    return shown.at(entity, step)["LineStrips3D:colors"][0]


def rgba(color: tuple[int, int, int]) -> int:
    red, green, blue = color
    return red << 24 | green << 16 | blue << 8 | 0xFF


def tool(log: Recording, step: int) -> tuple[float, float, float]:
    state = log.state_at(step)
    return state.link_pose(state.body("arm"), "gripper_tool")[0]


def to_line(point: tuple[float, ...], points: list[tuple[float, ...]]) -> float:
    return min(math.dist(point, each) for each in points)


@pytest.mark.slow
def test_a_motion_is_animated_on_simulated_time(log: Recording, shown: Shown) -> None:
    begin, end = begins(log)[2], log[ends(log)[2]]
    start, stop = (round(step * 1e9 / STEPS_PER_SECOND) for step in (begin.sim_step, end.sim_step))
    moments = [at for (_, at, _), _ in shown.rows["/table/bodies/arm/forearm_link"] if start <= at <= stop]
    assert len(moments) >= 30 * (stop - start) / 1e9
    assert moments == sorted(moments)
    assert max(b - a for a, b in pairwise(moments)) <= 1e9 / 30 + 1


def test_the_planned_path_of_a_hand_leads_to_where_it_gets(log: Recording, shown: Shown) -> None:
    begun, ended = begins(log)[2].seq, ends(log)[2]
    planned = line(shown, f"{HAND}/planned", begun)
    assert math.dist(planned[0], tool(log, begun)) < 2e-3
    assert math.dist(planned[-1], tool(log, ended)) < 2e-3
    assert color(shown, f"{HAND}/planned", begun) == rgba(BLUE)
    assert shown.at(f"{HAND}/planned", begun)["LineStrips3D:labels"] == ["ur5 2.9 s"]
    driven = line(shown, f"{HAND}/driven", ended - 1)
    assert len(driven) > 20
    assert max(to_line(point, planned) for point in driven) < 0.02  # points of the line are up to that far apart
    for entity in ("planned", "driven"):
        assert not line(shown, f"{HAND}/{entity}", begun - 1)
        assert not line(shown, f"{HAND}/{entity}", ended)


def test_fingers_have_no_path(log: Recording, shown: Shown) -> None:
    for number in (1, 4):  # the gripper opens, and closes
        assert not line(shown, f"{HAND}/planned", begins(log)[number].seq)


def test_paths_of_a_stopped_motion_stay(log: Recording, shown: Shown) -> None:
    begun, end = begins(log)[6].seq, len(log) - 1
    planned, driven = (line(shown, f"{HAND}/{entity}", end) for entity in ("planned", "driven"))
    assert planned == line(shown, f"{HAND}/planned", begun)
    assert color(shown, f"{HAND}/planned", end) == rgba(GREY)
    assert math.dist(driven[-1], tool(log, end)) < 2e-3
    assert math.dist(driven[-1], planned[-1]) > 0.1


def test_a_base_has_its_path_on_the_floor_and_what_it_does_next_clears_a_stopped_one(tmp_path: Path) -> None:
    file = tmp_path / "log.mcap"
    with recorder.record(file), BulletWorld(name="table") as world:
        robot = Object("arm", "robot", ARM, [0, 0, 1])
        drive(robot, [0, 0, 0], [0.3, 0.1, 0.2], 0.4)
        world.stop_trajectory(world.begin_trajectory(robot, to(robot, JOINTS, 0.4)))
        stopped = world.begin_trajectory(robot, to(robot, JOINTS, 0.4))
        world.simulate(0.2)
        world.stop_trajectory(stopped)
        world.simulate(0.2)
        world.reset()
    with replay.open(file) as log:
        shown, begun, ended = view(file, tmp_path / "log.rrd"), begins(log), ends(log)
        reset = next(r.seq for r in log.records(Mutation) if r.HasField("reset"))
    planned = line(shown, f"{BASE}/planned", begun[1].seq)
    assert planned[0] == pytest.approx((0, 0, 1.01))
    assert planned[-1] == pytest.approx((0.3, 0.1, 1.01))
    assert not line(shown, f"{BASE}/planned", ended[1])
    assert color(shown, f"{HAND}/planned", begun[2].seq + 1) == rgba(GREY), "stopped before it moved"
    assert color(shown, f"{HAND}/planned", begun[3].seq) == rgba(BLUE)
    assert color(shown, f"{HAND}/planned", ended[3]) == rgba(GREY)
    assert not line(shown, f"{HAND}/planned", reset)
    assert not line(shown, f"{HAND}/driven", reset)


def test_a_recording_that_begins_within_a_motion_has_its_path(tmp_path: Path) -> None:
    file = tmp_path / "log.mcap"
    with BulletWorld(name="table") as world:
        robot = Object("arm", "robot", ARM, [0, 0, 1])
        world.begin_trajectory(robot, to(robot, JOINTS, 0.9))
        world.begin_trajectory(robot, smooth((), [0, 0, 0], [0.3, 0, 0], 1.0))
        world.simulate(0.2)
        with recorder.record(file):
            world.simulate(0.25)
            robot.remove()
    shown = view(file, tmp_path / "log.rrd")
    with replay.open(file) as log:
        simulated = next(r.seq for r in log.records(Mutation) if r.HasField("simulate"))
        last = len(log) - 1
    for path in (HAND, BASE):
        assert len(line(shown, f"{path}/planned", simulated)) > 10
        assert len(line(shown, f"{path}/driven", simulated)) > 1
        assert not line(shown, f"{path}/planned", last), "the robot is gone"
