"""Random motions of the four robots in furniture and clutter: nearly all are found, soon, and touch nothing on the way.

``queries.json`` has, for queries that a path wasn't found for, what a longer search found: way points, null where it found
none either.
"""

from __future__ import annotations

import json
import math
import time
from typing import TYPE_CHECKING

import pytest

from pycram.failures import NoPath
from pycram.planning import path
from tests.measures import seeded
from tests.pycram.motions.household import PLACES
from tests.pycram.planning import long_search, random_queries

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.bullet_world import BulletWorld

QUERIES = range(300)
KNOWN = json.loads(long_search.RESULTS.read_text(encoding="utf-8"))
WAYS = {robot: {int(seed): way for seed, way in ways.items()} for robot, ways in KNOWN.items()}
FOUND = [(robot, seed) for robot, ways in WAYS.items() for seed, way in ways.items() if way is not None]
DEEP = 5e-3  # m


@pytest.fixture(scope="module")
def built(request: pytest.FixtureRequest) -> Iterator[tuple[str, BulletWorld]]:
    for world in random_queries.scenes(request.param):
        yield request.param, world


@pytest.mark.parametrize("built", list(PLACES), indirect=True, scope="module")
@seeded("random queries for paths, {built}", QUERIES, 3)
def test_a_path_is_found_and_touches_nothing_on_the_way(
    built: tuple[str, BulletWorld], seeds: range, record_property: pytest.RecordProperty
) -> None:
    robot, world = built
    rate = 20 if seeds[0] == 0 else 240  # times a second at which it is looked at
    solved = straight = impossible = missed = 0
    seconds: list[float] = []
    for seed in seeds:
        query = random_queries.query(world, PLACES[robot], seed)
        try:
            began = time.process_time()
            try:
                planned = query.plan(world.robot)
            except NoPath as failure:
                if seed not in WAYS[robot]:
                    search = f"python -m tests.pycram.planning.long_search {robot} {seed}"
                    raise AssertionError(f"query {seed} of {robot}: {failure}; search longer: {search}") from failure
                missed += WAYS[robot][seed] is not None
                impossible += WAYS[robot][seed] is None
                continue
            finally:
                seconds.append(round(time.process_time() - began, 3))
            assert planned.search.checks <= 2 * path.MAX_CHECKS
            deep = random_queries.deepest(world.robot, planned, rate)
            assert deep < DEEP, (seed, query.kind, deep)
            solved += 1
            straight += planned.search.attempts == 0
        finally:
            random_queries.end(world)
    record_property("solved", solved)
    record_property("of them straight", straight)
    record_property("missed", missed)
    record_property("without any way known", impossible)
    record_property("s of planning", seconds)


@pytest.mark.parametrize("robot", list(PLACES))
def test_nearly_all_queries_with_a_solution_are_solved(robot: str) -> None:
    ways = WAYS[robot]
    possible = len(QUERIES) - sum(way is None for way in ways.values())
    missed = sum(way is not None for way in ways.values())
    assert missed <= 0.05 * possible


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "seed"), [each if each[0] == "ur5" else pytest.param(*each, marks=pytest.mark.long) for each in FOUND]
)
def test_known_paths_are_free(robot: str, seed: int) -> None:
    for world in random_queries.scenes(robot):
        query = random_queries.query(world, PLACES[robot], seed)
        way = WAYS[robot][seed]
        for row, wanted in zip((way[0], way[-1]), query.ends, strict=True):
            turned = [math.remainder(a - b, math.tau) for a, b in zip(row, wanted, strict=True)]
            assert turned == pytest.approx([0.0] * len(row), abs=1e-6)
        assert random_queries.deepest(world.robot, random_queries.along(world.robot, query, way), 240) < DEEP
