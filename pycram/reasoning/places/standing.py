"""Places where a robot can stand to reach or see something (CRAM's ``reachable-for`` and ``visible-for``)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import MissingPart, UnknownName
from pycram.models.robots.description import Arm
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping.grasps import GRASPS, GraspSide
from pycram.reasoning.kinematics.inverse import Solver
from pycram.reasoning.places import maps
from pycram.reasoning.places.goals import PullGoal, TakeGoal, Target, description_of, goal_of, promising
from pycram.reasoning.places.maps import Grid, arm_reach, draw_cells, random_generator, room, surroundings
from pycram.reasoning.places.search import Batch, FoundPlace, Search, Spot
from pycram.reasoning.queries.query import world_of
from pycram.reasoning.queries.visibility import VISIBLE_SHARE, seen_share
from pycram.reasoning.rejections import OutOfReach, Rejection, Touching, Unseen, Untried
from pycram.scheduling.future import unwrap
from pycram.world.object import Object
from pycram.world.trajectory import BaseFrame
from recorder import geometry
from recorder.geometry import Array, Pose, Vector

if TYPE_CHECKING:
    from pycram.reasoning.places.goals import Goal


_SPOTS: Final = (30, 120, 120)  # number of places in a batch, by the number of batches since the last found place
_AT_FIRST: Final = 4  # number of first places that are checked together; each next group is twice as large
_TRIES: Final = 40  # number of places of a batch that are checked one by one
_FEWER: Final = 16  # the same number if an arm has no closed form, because searches are slow
_JITTER: Final = tuple(math.radians(angle) for angle in (6, 40, 60))  # turns in rad from the best heading, by batch
_APART: Final = 0.07  # minimum distance in m between offered places
_TRIED: Final = 0.02  # minimum distance in m between drawn places and rejected places
_POOR: Final = 1e-3  # minimum score of drawn places, as a share of the best score
_HERE: Final = "where it stands"
_OFFSETS: Final = tuple(math.radians(angle) for angle in range(-75, 76, 15))  # angles from headings to the target
_FACING: Final = 0.5  # share of the score that is lost if the target is at a right angle to the heading
_SIGHT: Final = (0.6, 2.5)  # distance in m up to which the camera sees well, and the farthest distance of a place
_ROOM: Final = 1.5  # largest distance in m to a point that the robot must be near
_NEAR: Final = 0.7  # at this distance in m from a point, a score is half of the best
_SHORT_WAY: Final = 8.0  # at this distance in m from the robot, a score is half of the best
_LEVEL: Final = 0.05  # height in m above the target; lower objects aren't obstacles


def standing_places(
    robot: Object,
    *,
    reach: Sequence[Target] = (),
    arms: Sequence[str] | None = None,
    both: bool = False,
    see: Object | None = None,
    near: Sequence[float] | None = None,
    avoid: Sequence[Sequence[float]] = (),
    grasp: str | None = None,
    seed: int | None = None,
    quickly: bool = False,
) -> Iterator[FoundPlace]:
    """Return places where a robot can stand with its arms in their present postures, best first.

    `moving` would reach each place, and from there an arm reaches the targets by `pick-up`, `place` or `accessing`.
    Each place is checked at the caller's request, and recorded as one query. The world may change between requests. The
    only place of a robot that can't drive is its present place.

    Args:
        reach: targets; the robot must reach all of them.
        arms: names of the arms that may reach; None for all arms.
        both: whether each of these arms must reach the targets; otherwise one arm is enough.
        see: an object that the camera must see.
        near: xyz or xy in m of a point, at most 1.5 m away.
        avoid: xyz or xy in m of places that are excluded with their surroundings.
        grasp: the side from which an arm takes objects: "front", "top", "left" or "right"; None for any side.
        seed: seed of the draws; None for the run's seed.
        quickly: whether to end the search after 30 excluded places in a row, instead of 270.

    Raises:
        BadArgument: A value is impossible.
        UnknownName: The robot has no such arm, or there is no such side.
        MissingPart: The robot has no arm or camera, but needs it.
        NoPlace: There is no place; raised at the first request.
    """
    robot = unwrap(robot)
    description = description_of("robot", robot)
    targets = [unwrap(target) for target in reach]
    chosen = [description.arm(name) for name in (description.arms if arms is None else arms)]
    if targets and not chosen:
        raise MissingPart(robot.name, "arm")
    if see is not None:
        see = unwrap(see)
        world_of(robot, see)
        if description.camera is None:
            raise MissingPart(robot.name, "camera")
    points = [None if near is None else _point("near", near), *(_point("avoid", each) for each in avoid)]
    if grasp is not None and grasp not in GRASPS:
        raise UnknownName("side", grasp, "a grasp", GRASPS)
    goals = [goal_of(robot, target, grasp) for target in targets]
    avoided = [each for each in points[1:] if each]
    return StandingSearch(robot, goals, chosen, both, see, points[0], avoided, grasp, seed, quickly).places()


def _point(name: str, given: Sequence[float]) -> Vector:
    return checks.vector(name, (*given, 0.0) if len(given) == 2 else given)


class StandingSearch(Search):
    """A search for places of a robot."""

    query = "standing_places"

    def __init__(
        self,
        robot: Object,
        goals: Sequence[Goal],
        arms: Sequence[Arm],
        both: bool,
        see: Object | None,
        near: Vector | None,
        avoid: Sequence[Vector],
        grasp: str | None,
        seed: int | None,
        quickly: bool,
    ) -> None:
        wanted = [f"reach {goal.named()}" for goal in goals] + ([f"see {see.name}"] if see is not None else [])
        self._purpose = " and ".join(wanted) or "stand"
        arguments = {
            "robot": robot,
            "reach": [goal.named() for goal in goals] if goals else None,
            "arms": [arm.name for arm in arms] if goals else None,
            "see": see,
            "near": near,
            "avoid": list(avoid) or None,
            "grasp": grasp,
        }
        super().__init__(robot.world, f"{robot.name} to {self._purpose}", arguments, robot)
        self._robot, self._goals, self._arms, self._both = robot, goals, arms, both
        self._see, self._near, self._seed = see, near, seed
        self._offered: list[Vector] = list(avoid)  # offered places, and the places to avoid
        self._rejected: list[Vector] = []
        self._failed = 0  # number of batches without a place since the last place
        self._batches = 1 if quickly else len(_SPOTS)  # number of batches without a place after which the search ends

    def _next(self, batch: Batch, number: int) -> FoundPlace | None:
        position, turn = self._robot.get_position_and_orientation()
        here: Pose = (position[0], position[1], position[2]), (turn[0], turn[1], turn[2], turn[3])
        grid, factors, yaws = self._maps()
        scores, _ = self._product(factors)
        scores[scores < _POOR] = 0.0
        centers = grid.centers()
        scores = scores * (maps.away(centers, self._offered, _APART) * maps.away(centers, self._rejected, _TRIED))
        spots = []
        known = (*self._offered, *self._rejected)
        near = self._near is None or math.dist(here[0][:2], self._near[:2]) <= _ROOM
        if near and not any(math.dist(here[0][:2], each[:2]) < _APART for each in known):
            spots.append(Spot(_HERE, here, geometry.to_rpy(turn)[2], 1.0))
        if not self._stays:
            random = random_generator(self._seed, self.query, number, repr(self._arguments), here)
            base = BaseFrame.of(here)
            jitter = _JITTER[self._failed]
            for cell, (x, y) in draw_cells(grid, scores, _SPOTS[self._failed], random):
                yaw = round(float(yaws[cell] + random.uniform(-jitter, jitter)), 4)
                spots.append(Spot(f"[{x:.2f}, {y:.2f}]", base.pose((x, y, yaw)), yaw, float(scores[cell])))
        drawn = batch.draw(grid, scores, spots)
        place = self._first(batch, drawn)
        self._failed = 0 if place is not None else self._failed + 1
        self._over = not drawn or self._stays or self._failed == self._batches
        return place

    def _maps(self) -> tuple[Grid, list[tuple[str, Array]], Array]:
        """Return the cells, the maps (cells,) with their constraints' names, and the best yaws (cells,) in rad."""
        robot = self._robot
        here, turn = robot.get_position_and_orientation()
        areas: list[tuple[Sequence[float], float]] = []
        if self._goals:
            radius = max(arm_reach(self._robot, arm).radius for arm in self._arms)
            areas += [(goal.position, radius) for goal in self._goals]
        if self._see is not None:
            areas.append((center(self._see), _SIGHT[1]))
        if not areas:
            areas.append((self._near or here, _ROOM))
        low = [max(point[axis] - radius for point, radius in areas) for axis in (0, 1)]
        high = [min(point[axis] + radius for point, radius in areas) for axis in (0, 1)]
        grid = Grid.over(low, high, here[2])
        centers = grid.centers()
        factors: list[tuple[str, Array]] = [("distance", maps.near(centers, here, _SHORT_WAY))]
        yaws = np.full(len(centers), geometry.to_rpy(turn)[2])
        cells = np.arange(len(centers))  # cells that no map has excluded; other cells need no further maps
        if self._goals or self._see is not None:
            faced, yaws = self._faced(centers, here[2])
            cells = np.flatnonzero(faced)
            factors.append((self._purpose, faced))
            for goal in self._goals:
                x, y, z = goal.position
                target = [goal.body] if isinstance(goal, TakeGoal) else []
                between = maps.Footprints(surroundings(robot, *target), z, z + _LEVEL)  # obstacles as high as the goal
                straight = maps.straight(centers[cells], (x, y), between)
                factors.append((self._purpose, maps.scattered(straight, cells, len(centers))))
        if not self._stays:
            factors.append(("collision", maps.scattered(room(robot, centers[cells]), cells, len(centers))))
        if self._near is not None:
            factors.append(("near", maps.near(centers, self._near, _NEAR, _ROOM)))
        return grid, factors, yaws

    def _faced(self, centers: Array, ground: float) -> tuple[Array, Array]:
        """Return, for each cell, the score of the best heading for reaching or seeing all targets, and this heading."""
        points = [goal.position for goal in self._goals] or ([center(self._see)] if self._see is not None else [])
        offsets = np.asarray(points)[None, :, :2] - centers[:, None]  # (cells, points, 2)
        distances, bearings = np.hypot(offsets[..., 0], offsets[..., 1]), np.arctan2(offsets[..., 1], offsets[..., 0])
        middle = offsets.mean(axis=1)
        facing = np.arctan2(middle[:, 1], middle[:, 0])
        best, yaws = np.full(len(centers), -1.0), facing.copy()
        for offset in _OFFSETS if self._goals else (0.0,):
            score = np.full(len(centers), 1.0 - _FACING * abs(offset) / (math.pi / 2))
            for number, point in enumerate(points if self._goals else ()):
                score *= self._by_arms(point[2] - ground, distances[:, number], bearings[:, number] - facing - offset)
            if self._see is not None:
                good, far = _SIGHT
                away = np.hypot(*(np.asarray(center(self._see)[:2]) - centers).T)
                score *= np.where(away < good, away / good, np.clip((far - away) / (far - good), 0.0, 1.0))
            better = score > best
            best[better], yaws[better] = score[better], (facing + offset)[better]
        return best, yaws

    def _by_arms(self, height: float, distance: Array, bearing: Array) -> Array:
        """Return scores of how well the best arm reaches points; if both arms must reach, of the worst arm."""
        every = []
        base_T_world = geometry.invert(self._robot.get_position_and_orientation())
        for arm in self._arms:
            shoulder = geometry.transform(base_T_world, self._robot.get_link_position(arm.base_link))
            every.append(arm_reach(self._robot, arm).scores(height - shoulder[2], distance, bearing))
        together: Array = np.min(every, axis=0) if self._both else np.max(every, axis=0)
        return together

    def _first(self, batch: Batch, spots: Sequence[Spot]) -> FoundPlace | None:
        quick = all(Solver(self._robot, arm.tool_frame).in_closed_form for arm in self._arms)
        tries = _TRIES if quick else _FEWER
        place: FoundPlace | None = None
        closely: list[tuple[Spot, str, Rejection]] = []  # counted last, because these places satisfy most constraints
        spots = batch.admitted(spots)
        for some in _growing(spots) if quick else (spots,):
            left = []
            for spot, known in zip(some, self._at_first_sight(some), strict=True):
                if known is None:
                    left.append(spot)
                else:
                    self._exclude(batch, spot, *known)
            for spot in left[tries:]:
                batch.reject(spot.name, Untried())
            for spot in left[:tries]:
                excluded = self._excluded(spot)
                if isinstance(excluded, FoundPlace):
                    place = excluded
                    break
                closely.append((spot, *excluded))
            if place is not None:
                break
            tries = max(0, tries - len(left))
        for each in closely:
            self._exclude(batch, *each)
        if place is not None:
            self._offered.append(spot.pose[0])
            batch.take(spot.name, {"position": spot.pose[0], "orientation": spot.pose[1], "arms": place.arms})
        return place

    def _exclude(self, batch: Batch, spot: Spot, constraint: str, reason: Rejection) -> None:
        """Count a place that a constraint excludes; the place won't be drawn again."""
        self._rejected.append(spot.pose[0])
        super()._exclude(batch, spot, constraint, reason)

    def _at_first_sight(self, spots: Sequence[Spot]) -> Sequence[tuple[str, Rejection] | None]:
        """Check all places quickly. Return the constraint that excludes each place, with the reason, or None."""
        found = self._collisions(spots)
        for goal, look in itertools.product(self._goals, (self._struck, self._out_of_reach)):
            left = [number for number, excluded in enumerate(found) if excluded is None]
            for number, reason in zip(left, look(goal, [spots[each].pose for each in left]), strict=True):
                if reason is not None:
                    found[number] = f"reach {goal.named()}", reason
        return found

    def _struck(self, goal: Goal, bases: Sequence[Pose]) -> Sequence[Rejection | None]:
        """Return the collisions of a moved drawer or door with the robot at each place; None for other goals."""
        return goal.struck(self._arms, bases) if isinstance(goal, PullGoal) else [None] * len(bases)

    def _out_of_reach(self, goal: Goal, bases: Sequence[Pose]) -> Sequence[Rejection | None]:
        promises = promising(self._robot, goal, self._arms, bases)
        return [None if promising else OutOfReach(None) for promising in promises]

    def _collisions(self, spots: Sequence[Spot]) -> list[tuple[str, Rejection] | None]:
        """Return the first collision of the robot at each place; None at free places, and at its present place."""
        found: list[tuple[str, Rejection] | None] = []
        if not spots:
            return found
        with CollisionChecker(self._robot, (), all_links=True) as checker:
            for spot, candidate in zip(spots, checker.predict_at([spot.pose for spot in spots]), strict=True):
                first = None if spot.name == _HERE else next(checker.collisions(candidate), None)
                if first is None:
                    found.append(None)
                else:
                    pair, touches = first
                    depth = max(-touch.distance for touch in touches)
                    found.append((f"collision with {pair[2].name}", Touching([checker.named(pair, depth)])))
        return found

    def _excluded(self, spot: Spot) -> FoundPlace | tuple[str, Rejection]:
        """Return a place that satisfies all constraints, or the constraint that excludes it, with the reason."""
        able = list(self._arms)
        grasps: dict[str, GraspSide] = {}
        for goal in self._goals:
            reasons: list[Rejection] = []
            reached: list[Arm] = []
            for arm in self._arms:
                found = goal.reached(arm, spot.pose)
                if isinstance(found, str):
                    reached.append(arm)
                    grasps.update({arm.name: cast("GraspSide", found)} if found else {})
                else:
                    reasons.append(found)
            if not reached or (self._both and reasons):
                return f"reach {goal.named()}", min(reasons, key=lambda reason: reason.miss())
            able = [arm for arm in able if arm in reached]
        if self._see is not None:
            seen = seen_share(self._robot, self._see, spot.pose)
            if seen.share <= VISIBLE_SHARE:
                return f"see {self._see.name}", Unseen(seen.share, list(seen.hiding))
        names = tuple(arm.name for arm in able) if self._goals else ()
        return FoundPlace(*spot.pose, names, spot.score, "", {name: grasps[name] for name in names if name in grasps})


def _growing(spots: Sequence[Spot]) -> Iterator[Sequence[Spot]]:
    """Yield the places in parts, in order; each part after the first is twice as long as the part before."""
    start, size = 0, _AT_FIRST
    while start < len(spots):
        yield spots[start : start + size]
        start, size = start + size, 2 * size
