"""Random motions of the four robots in furniture and clutter: nearly all are found, soon, and touch nothing on the way."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

from pycram.failures import NoPath
from pycram.planning import path
from tests.measures import seeded
from tests.pycram.motions.household import PLACES
from tests.pycram.planning import random_queries

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pycram.bullet_world import BulletWorld

#: Queries that no path was found for, by robot and seed; each is one that a search of ten times the budget doesn't
#: solve either, or else counts as a failure of ours.
UNSOLVED: dict[str, set[int]] = {}


@pytest.fixture(scope="module", params=list(PLACES))
def built(request: pytest.FixtureRequest) -> Iterator[tuple[str, BulletWorld]]:
    for world in random_queries.scenes(request.param):
        yield request.param, world


@seeded("random queries of four robots for paths", range(300), 3)
def test_a_path_is_found_and_touches_nothing_on_the_way(
    built: tuple[str, BulletWorld], seeds: range, record_property: Callable[[str, object], None]
) -> None:
    robot, world = built
    rate = 20 if seeds[0] == 0 else 240  # times a second at which it is looked at
    for seed in seeds:
        query = random_queries.query(world, PLACES[robot], seed)
        try:
            began = time.process_time()
            try:
                planned = query.plan(world.robot)
            except NoPath as failure:
                if seed not in UNSOLVED.get(robot, ()):
                    raise AssertionError(f"query {seed} of {robot}: {failure}") from failure
                record_property("unsolved", 1)
                continue
            finally:
                record_property("seconds", round(time.process_time() - began, 3))
            assert planned.search.checks <= 2 * path.MAX_CHECKS
            deep = random_queries.deepest(world.robot, planned, rate)
            assert deep < 5e-3, (seed, query.kind, deep)
            record_property("searched", int(planned.search.attempts > 0))
        finally:
            random_queries.end(world)
