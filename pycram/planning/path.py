"""Paths between configurations: the straight line if it is free, otherwise a path that a search finds."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pycram.foundation.failures import NoPath
from pycram.planning import timing
from pycram.reasoning.choosing import Choice
from pycram.reasoning.rejections import Touching, Unreached
from pycram.scheduling.schedule import run_seed
from pycram.world.trajectory import Trajectory
from recorder import records

if TYPE_CHECKING:
    from pycram.planning.space import Clearance, Space
    from pycram.planning.timing import Knots, Rates

    Array = NDArray[np.float64]

STRAIGHT: Final = "straight line"
EARLIER: Final = "earlier path"
RRT_CONNECT: Final = "RRT-Connect"
MAX_CHECKS: Final = 20_000  # maximum number of checked configurations in all searches for a path

_STEPS: Final = (1.0, 0.5, 0.25)  # steps of searches as shares of the space's step; small steps miss fewer collisions
_FINE: Final = 0.25  # step of the final check as a share of the space's step
_RATE: Final = 240.0  # number of samples per second with which a timed path is checked
_MAX_EARLIER: Final = 4  # maximum number of earlier paths that are tried before a search
_MAX_PAIRS: Final = 3  # maximum number of pairs of links in a failure


@dataclass(frozen=True, slots=True)
class Query:
    """A query for a path."""

    mover: str  # name of the moving part in messages
    names: tuple[str, ...]  # names of the coordinates
    space: Space  # space of the first search
    start: Array  # (d,) the first configuration
    goal: Array  # (d,) the last configuration
    rates: Rates  # limits of the motion
    seed: int | None  # seed of the search; None for the run's seed
    wider: Space | None = None  # space of the second search; None for the same space
    patience: float = 1.0  # budget as a multiple of MAX_CHECKS

    def drawn_seed(self, attempt: int) -> int:
        """Return the seed of an attempt, from 1 to 2**31. The seed depends only on the run's seed and the query."""
        run = run_seed() if self.seed is None else self.seed
        text = f"path {run} {attempt} {self.names} {self.start.tolist()} {self.goal.tolist()}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") % 2**31 + 1

    def named(self, row: Array) -> dict[str, float]:
        """Return a configuration as values by coordinate name."""
        return dict(zip(self.names, row.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class Path:
    """A path without new collisions, with its times."""

    planner: str  # STRAIGHT, EARLIER or RRT_CONNECT
    seed: int  # seed of the successful search; 0 without a search
    attempts: int  # number of searches
    budget: int  # maximum number of checked configurations
    way_points: Array  # (n, d) configurations of the path before timing
    knots: Knots  # knots of the timed path


def find_path(
    query: Query, clearance: Clearance, choice: Choice, failure: NoPath | None = None, earlier: Iterable[Array] = ()
) -> Path:
    """Return a path that touches only objects that the robot touches at the ends; raise NoPath if the budget is spent.

    The first search has half of the budget, keeps a distance from obstacles, and stays in the query's narrower space.
    Before a search, ``earlier`` paths (n, d) are tried in both directions. With the ``failure`` of an equal search, no
    search is made.
    """
    fine = _FINE * query.space.step
    line = np.array([query.start, query.goal])
    reached = [query.start]  # the start, followed by the nearest configuration of each search
    most = int(query.patience * MAX_CHECKS)
    rooms = (True, query.space, most // 2), (False, query.wider or query.space, most)
    # ways along earlier paths whose middle parts are the nearest
    candidates = [np.vstack([query.start, way, query.goal]) for path in earlier for way in (path, path[::-1])]
    gaps = {id(way): query.space.distance(way[[0, -1]], way[[1, -2]]).sum() for way in candidates}
    direct = query.space.distance(query.start, query.goal)
    ways = sorted([way for way in candidates if gaps[id(way)] < direct], key=lambda way: gaps[id(way)])[:_MAX_EARLIER]
    for clearance.strict, space, budget in rooms:
        touch = clearance.first_touch(query.space.along(line, fine))
        if touch is None and choice.admits(STRAIGHT):
            choice.take(STRAIGHT, checks=clearance.checks)
            return Path(STRAIGHT, 0, len(reached) - 1, most, line, timing.timed(line, query.rates, timing.SPACINGS[0]))
        if touch is not None:
            choice.reject(STRAIGHT, Touching([touch]))
        way = _shortest_free(query, clearance, ways, fine) if ways and choice.admits(EARLIER) else None
        if way is not None:
            choice.take(EARLIER, checks=clearance.checks)
            knots = _timed(query, clearance, way, fine)
            return Path(EARLIER, 0, len(reached) - 1, most, way, knots)
        if not choice.admits(RRT_CONNECT):
            break
        found = None if failure else _searched(query, clearance, space, budget, reached)
        if found is not None:
            attempts = len(reached) - 1
            knots = _timed(query, clearance, found, fine)
            choice.take(RRT_CONNECT, checks=clearance.checks, attempts=attempts)
            return Path(RRT_CONNECT, query.drawn_seed(attempts), attempts, most, found, knots)
    if failure is None:
        distances = query.space.distance(np.array(reached), query.goal)
        nearest, goal = (query.named(row) for row in (reached[int(np.argmin(distances))], query.goal))
        pairs = clearance.worst(_MAX_PAIRS)
        failure = NoPath(query.mover, goal, clearance.checks, nearest, float(distances.min()), pairs)
    choice.reject(RRT_CONNECT, Unreached(failure.checks, failure.distance, failure.pairs))
    raise copy(failure)


def _shortest_free(query: Query, clearance: Clearance, ways: Iterable[Array], fine: float) -> Array | None:
    """Return the first of some paths (n, d) that is free, without its unnecessary way points; None if no path is."""
    found = next((way for way in ways if clearance.free(query.space.along(way, fine))), None)
    number = 1
    while found is not None and number < len(found) - 1:
        if clearance.free(query.space.along(found[[number - 1, number + 1]], fine)):
            found = np.delete(found, number, axis=0)
        else:
            number += 1
    return found


def _searched(query: Query, clearance: Clearance, space: Space, budget: int, reached: list[Array]) -> Array | None:
    """Return a free path (n, d), or None; append the nearest configuration of each search to ``reached``."""
    from pycram.planning import rrt_connect  # noqa: PLC0415  loading OMPL takes as long as a whole instantaneous plan

    for share in _STEPS:
        found, nearest = rrt_connect.search(
            space,
            query.start,
            query.goal,
            clearance,
            step=space.step * share,
            fine=space.step * _FINE,
            seed=query.drawn_seed(len(reached)),
            max_checks=budget,
        )
        rows = None if found is None else space.along(found, space.step * _FINE)
        is_free = rows is None or clearance.free(rows)
        reached.append(nearest if rows is None or is_free else clearance.last_free(query.start, rows))
        if is_free:
            return found
    return None


def _timed(query: Query, clearance: Clearance, path: Array, fine: float) -> Knots:
    """Return the fastest knots of a path; corners are rounded if that causes no collision."""
    for spacing in timing.SPACINGS:
        knots = timing.timed(path, query.rates, spacing)
        if clearance.free(_looked_at(query, knots, fine)):
            return knots
    return timing.stopping(path, query.rates)


def _looked_at(query: Query, knots: Knots, fine: float) -> Array:
    """Return configurations (n, d) of a timed path, about a step apart."""
    rows = timing.at(knots, np.arange(0.0, knots.times[-1], 1 / _RATE))
    moved = np.cumsum(np.abs(np.diff(rows, axis=0) * query.space.weights).max(axis=1, initial=0.0))
    return rows[1:][np.diff(np.floor(moved / fine), prepend=0.0) > 0]


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """A trajectory for a body, and the search for its path."""

    trajectory: Trajectory
    search: records.PathSearch

    @property
    def end(self) -> dict[str, float]:
        """Final joint positions in rad or m by name; for a base, x, y and yaw."""
        return dict(zip(self.trajectory.coordinates, self.trajectory.positions[-1], strict=True))


def trajectory_of(joints: Sequence[str], knots: Knots) -> Trajectory:
    """Return knots as a trajectory of joints; without joints, of a base."""
    rows = (tuple(map(tuple, values.tolist())) for values in (knots.positions, knots.velocities))
    return Trajectory(tuple(joints), tuple(knots.times.tolist()), *rows)


def search_record(found: Path, checks: int, way_points: Array) -> records.PathSearch:
    """Return the record of a search for a path; way points are the configurations before timing."""
    return records.PathSearch(
        planner=found.planner,
        seed=found.seed,
        attempts=found.attempts,
        checks=checks,
        max_checks=found.budget,
        way_points=way_points.ravel().tolist(),
    )


def given(joints: Sequence[str], knots: Knots, way_points: Array) -> PlannedMotion:
    """Return a trajectory along a given path, without a search."""
    search = records.PathSearch(planner="given", way_points=way_points.ravel().tolist())
    return PlannedMotion(trajectory_of(joints, knots), search)
