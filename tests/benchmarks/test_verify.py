"""What verifying a recording costs, as a share of the run itself: ``make bench`` prints the table."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import recorder
import replay
from pycram.bullet_world import BulletWorld, Object
from replay.restore.verify import verify
from tests.benchmarks.timing import amount, goal, ratio, seconds, warm_up

if TYPE_CHECKING:
    from collections.abc import Callable

sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demos"))

import set_the_table

pytestmark = pytest.mark.slow

MOST = 1.2  # of the run's own time


def demo() -> None:
    with redirect_stdout(StringIO()):
        set_the_table.main()


def physics() -> None:
    with BulletWorld() as world:
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        Object("pr2", "robot", "pr2.urdf")
        Object("kitchen", "environment", "kitchen.urdf")
        for number in range(5):
            Object(f"bowl{number}", "bowl", "bowl.stl", [1.3, 0.5 + 0.1 * number, 1])
        for _ in range(30):
            world.simulate(0.05)


def moves() -> None:
    with BulletWorld():
        bowl = Object("bowl", "bowl", "bowl.stl", [0, 0, 1])
        for number in range(amount(5000, 1000)):
            bowl.set_position([number * 1e-3, 0, 1])


def joints() -> None:
    with BulletWorld():
        robot = Object("pr2", "robot", "pr2.urdf")
        for number in range(2000):
            robot.set_joint_positions({"torso_lift_joint": number * 1e-4, "l_shoulder_pan_joint": number * 1e-4})


@pytest.mark.parametrize(
    "plan", [moves, *(pytest.param(plan, marks=pytest.mark.long) for plan in (demo, physics, joints))]
)
def test_verifying_costs_hardly_more_than_the_run(plan: Callable[[], None], tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"

    def record() -> None:
        with recorder.record(file):
            plan()

    def check() -> None:
        with replay.open(file) as log:
            assert verify(log).exact

    warm_up(plan)
    cost = ratio(lambda: seconds(check), lambda: seconds(record), rounds=3, most=MOST)
    print()
    goal(f"{plan.__name__}: verified, of the run's time", cost, MOST)
