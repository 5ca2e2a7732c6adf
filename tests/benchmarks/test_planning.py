"""What planning a path costs, against its collision checks made one by one: ``make bench`` prints the table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from pycram.planning import joint_motion
from pycram.reasoning.collision.checker import CollisionChecker
from tests.benchmarks.timing import goal, ratio, seconds
from tests.pycram.planning.conftest import LEFT, RIGHT, arm, pillar

if TYPE_CHECKING:
    from pycram.bullet_world import Object

__all__ = ["arm", "pillar"]  # fixtures

pytestmark = pytest.mark.slow

ALONE = 100  # configurations that are checked one by one


def check(robot: Object) -> None:
    """Check configurations between two postures, each alone."""
    start, end = np.array(list(RIGHT.values())), np.array(list(LEFT.values()))
    with robot.world.lock, CollisionChecker(robot, RIGHT) as checker:
        for share in np.linspace(0.0, 1.0, ALONE):
            (candidate,) = checker.predict([dict(zip(RIGHT, (start + share * (end - start)).tolist(), strict=True))])
            checker.touched(candidate)
            checker.self_collisions(candidate)


@pytest.mark.costly
def test_a_search_costs_less_than_its_checks_one_by_one(arm: Object, pillar: Object) -> None:
    planned = joint_motion(arm, LEFT)
    assert pillar.name == "pillar"
    assert planned.search.planner == "RRT-Connect"
    cost = ratio(lambda: seconds(lambda: joint_motion(arm, LEFT)), lambda: seconds(lambda: check(arm)))
    goal("path around a pillar, in its checks one by one", cost * ALONE / planned.search.checks, 1.0)


def test_a_straight_line_costs_little_beside_a_search(arm: Object, pillar: Object) -> None:
    searched = ratio(lambda: seconds(lambda: joint_motion(arm, LEFT)), lambda: seconds(lambda: check(arm)))
    pillar.remove()
    assert joint_motion(arm, LEFT).search.planner == "straight line"
    straight = ratio(lambda: seconds(lambda: joint_motion(arm, LEFT)), lambda: seconds(lambda: check(arm)))
    goal("straight line, in searches for a path around a pillar", straight / searched, 0.5)
