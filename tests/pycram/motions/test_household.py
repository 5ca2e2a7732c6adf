"""Each robot in the box carries the household from one place to another: 48 cases each, as twelve objects lie."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from pycram import bullet_world_reasoning as btr
from pycram.failures import Blocked, DoesNotFit
from tests.measures import seeded
from tests.pycram.motions import household
from tests.pycram.motions.household import CASES, PLACES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.bullet_world import BulletWorld

#: What a robot's gripper can't take, at which angles, and what says so: a pot's wall is thinner than the gap that closed
#: fingers leave, and only its handle fits, if it lies along; a plate on a table has no room below its rim for blunt ones.
ALL = (0, 30, 45, 60)
REFUSED = {
    "tiago_pro": (
        "pot",
        (30, 45, 60),
        DoesNotFit,
        r"it is too big or too thin for the gripper.*, 7\.5-73 mm fit between",
    ),
    "panda": ("plate", ALL, Blocked, "; panda_rightfinger would touch thing"),
    "ur5": ("plate", ALL, Blocked, "; gripper_right_finger would touch thing"),
}


@pytest.fixture(scope="module", params=list(PLACES))
def built(request: pytest.FixtureRequest) -> Iterator[tuple[str, BulletWorld]]:
    for world in household.build(request.param):
        yield request.param, world


@seeded("household carried by four robots", range(len(CASES)), 4)
def test_what_a_robot_carries_stands_where_it_should(
    built: tuple[str, BulletWorld], seeds: range, record_property: Callable[[str, object], None]
) -> None:
    robot, world = built
    place = PLACES[robot]
    refused = 0
    for number in seeds:
        kind, degrees = CASES[number]
        body = household.put(world, place, kind, degrees)
        refusal = REFUSED.get(robot)
        try:
            if refusal is not None and kind == refusal[0] and degrees in refusal[1]:
                with pytest.raises(refusal[2], match=refusal[3]):
                    household.carry(world, place, body)
                refused += 1
                continue
            household.carry(world, place, body)
            assert math.dist(body.get_position()[:2], place.goal) < 0.02, (kind, degrees)
            assert btr.stable(body), (kind, degrees)
            assert body.carrier is None, (kind, degrees)
        finally:
            body.remove()
    record_property("carried", len(seeds) - refused)
    record_property("refused", refused)
