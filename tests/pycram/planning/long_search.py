"""A longer search for paths where ours finds none: ten times the budget for each of several seeds, a minute or more.

``python -m tests.pycram.planning.long_search tiago_pro 44 59`` searches for these queries, and writes down in
``queries.json`` what comes of it: a path's way points, or null.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.failures import NoPath
from pycram.planning import path
from tests.pycram.motions.household import PLACES
from tests.pycram.planning import random_queries

if TYPE_CHECKING:
    from pycram.bullet_world import BulletWorld
    from tests.pycram.planning.random_queries import Query

RESULTS: Final = Path(__file__).with_name("queries.json")
SECONDS: Final = 60.0  # of the processor
SEEDS: Final = 2  # at least
TIMES: Final = 10  # the budget of checks, for each seed

#: Joint values of the arm, or x, y and yaw of the base, from the start to the goal.
WayPoints = list[list[float]]


def search(world: BulletWorld, query: Query) -> tuple[WayPoints | None, int, float]:
    """Return a path's way points, None if none was found, and the number of seeds and seconds it took."""
    usual, path.MAX_CHECKS = path.MAX_CHECKS, TIMES * path.MAX_CHECKS
    began, seed = time.process_time(), 0
    try:
        while seed < SEEDS or time.process_time() - began < SECONDS:
            seed += 1
            try:
                planned = query.plan(world.robot, seed)
            except NoPath:
                continue
            rows, width = list(planned.search.way_points), len(planned.trajectory.coordinates)
            way = [rows[start : start + width] for start in range(0, len(rows), width)]
            return way, seed, time.process_time() - began
        return None, seed, time.process_time() - began
    finally:
        path.MAX_CHECKS = usual


def main() -> None:
    """Search for queries of a robot whose seeds are given, and write down what comes of it."""
    robot, *seeds = sys.argv[1:]
    for world in random_queries.scenes(robot):
        for seed in map(int, seeds):
            query = random_queries.query(world, PLACES[robot], seed)
            way, tried, seconds = search(world, query)
            random_queries.end(world)
            known = json.loads(RESULTS.read_text(encoding="utf-8"))
            known[robot][str(seed)] = way
            RESULTS.write_text(_text(known), encoding="utf-8")
            found = "no path" if way is None else f"a path of {len(way)} way points"
            print(f"{robot} {seed}, {query.kind}: {found} with {tried} seeds in {seconds:.0f} s", flush=True)


def _text(known: dict[str, dict[str, WayPoints | None]]) -> str:
    """Return JSON with a line for each query."""
    robots = []
    for robot, ways in known.items():
        lines = [f'  "{seed}": {json.dumps(way)}' for seed, way in sorted(ways.items(), key=lambda item: int(item[0]))]
        robots.append(f' "{robot}": {{\n' + ",\n".join(lines) + "\n }" if lines else f' "{robot}": {{}}')
    return "{\n" + ",\n".join(robots) + "\n}\n"


if __name__ == "__main__":
    main()
