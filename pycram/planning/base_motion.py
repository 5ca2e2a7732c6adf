"""Motions of a base: where a robot drives with its arms as they are, and with what they hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.foundation import checks
from pycram.foundation.failures import InCollision
from pycram.planning import path
from pycram.planning.clearance import MARGIN, Clearance
from pycram.planning.planned import Planned, search_record, trajectory_of
from pycram.planning.rates import base_rates
from pycram.planning.space import Space, nearest_turns
from pycram.reasoning.choosing import choosing
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.driving import check_drives, check_ground
from pycram.reasoning.rejections import Touching
from pycram.world.trajectory import BaseFrame
from recorder import geometry
from recorder.records.motion import BASE_COORDINATES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pycram.reasoning.collision.checker import Candidate
    from pycram.world.object import Object
    from recorder.geometry import Pose

    Array = NDArray[np.float64]

_ROOM: Final = 3.0  # m around start and goal that a path may go
_WIDER: Final = 9.0  # m likewise, if there is none: to the next door
_TURN: Final = 0.5  # m for a radian of turn, as the outline of a robot moves
_STEP: Final = 0.06  # m between poses that are checked while a path is searched


def base_motion(
    robot: Object,
    position: Sequence[float],
    orientation: Sequence[float],
    *,
    start: tuple[Sequence[float], Sequence[float]] | None = None,
    seed: int | None = None,
) -> Planned:
    """Return a motion of a robot's base to a pose on which it touches nothing that it doesn't touch at the start.

    All links of the robot in its present posture count, and what it holds. Height and lean stay: only x, y and yaw
    move, all at once. The choice between the straight line and a search is on record.

    Args:
        robot: the robot.
        position: xyz of the goal in m.
        orientation: xyzw of the goal.
        start: position and orientation from which it begins; the present ones by default.
        seed: of the search; the run's by default.

    Raises:
        BadArgument: The pose is none.
        NotDrivable: Its base is fixed, or the goal isn't on its ground.
        InCollision: Something would be touched at the goal.
        NoPath: No path was found within :data:`pycram.planning.path.MAX_CHECKS` checks.
    """
    target, turn = checks.vector("position", position), checks.quaternion("orientation", orientation)
    check_drives(robot, target, turn)
    with robot.world.lock, choosing("path", robot.world, position=target, orientation=turn, seed=seed) as choice:
        check_ground(robot, target, turn)
        position, orientation = start or robot.get_position_and_orientation()
        here = (checks.vector("start", position), checks.quaternion("start", orientation))
        begin, end = np.array(_row(here)), np.array(_row((target, turn)))
        frame = BaseFrame.of(here)
        end = nearest_turns(begin, end, np.array([np.inf, np.inf, -np.inf]), np.full(3, np.inf))
        with CollisionChecker(robot, (), all_links=True, margin=MARGIN) as checker:

            def predict(rows: Array) -> list[Candidate]:
                return checker.predict_at([frame.pose(row) for row in rows.tolist()])

            clearance = Clearance(checker, predict, begin, end)
            if touched := clearance.touched:
                choice.reject(path.STRAIGHT, Touching(touched))
                raise InCollision(target, turn, list(dict.fromkeys(pair.body for pair in touched)), touched)
            space, wider = (_space(begin, end, room) for room in (_ROOM, _WIDER))
            query = path.Query("base", BASE_COORDINATES, space, begin, end, base_rates(robot), seed, wider)
            found = path.find(query, clearance, choice)
    return Planned(trajectory_of((), found.knots), search_record(found, clearance.checks, found.way_points))


def _space(begin: Array, end: Array, room: float) -> Space:
    """Return the space of x, y and yaw that is some room (m) around both ends."""
    around = np.array([room, room, np.pi])
    low, high = np.minimum(begin, end) - around, np.maximum(begin, end) + around
    return Space(low, high, np.array([1.0, 1.0, _TURN]), _STEP)


def _row(pose: Pose) -> tuple[float, float, float]:
    """Return x, y and yaw of a pose."""
    return pose[0][0], pose[0][1], geometry.to_rpy(pose[1])[2]
