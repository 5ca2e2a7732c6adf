"""Where a robot's outline has room: by layers of heights, roughly, for all places at once."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.reasoning.places import maps
from pycram.reasoning.places.reaching import held
from recorder import geometry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pycram.reasoning.collision.boxes import Boxes
    from pycram.world.object import Object

    Array = NDArray[np.float64]

_FLOOR: Final = 0.03  # m above the ground; lower things are driven over, or don't reach up
_LAYERS: Final = (0.35, 0.7, 1.0, 1.4)  # m: heights between which a robot has one outline


def surroundings(robot: Object, *without: Object) -> Boxes:
    """Return boxes around everything but a robot, what it holds, and some other objects."""
    clone = clone_of(robot.world, "reach")
    own = {robot, *held(robot), *without}
    return clone.all_boxes(body for body in robot.world.objects if body not in own)[0]


def room(robot: Object, centers: Array) -> Array:
    """Return 0 where a robot would touch something whatever its heading, up to 1 where nothing is near.

    Args:
        robot: the robot, with what it holds; its world's lock is held, and its clone in sync.
        centers: (cells, 2) where its base would be, m.
    """
    clone = clone_of(robot.world, "reach")
    others = surroundings(robot)
    position, turn = robot.get_position_and_orientation()
    yaw, ground = geometry.to_rpy(turn)[2], position[2]
    back = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    score = np.ones(len(centers))
    for low, high in itertools.pairwise((_FLOOR, *_LAYERS)):
        outline = maps.Footprints(clone.boxes(robot), ground + low, ground + high).corners()
        inner, outer = maps.radii((outline - np.asarray(position[:2])) @ back)
        left = np.flatnonzero(score)
        score[left] *= maps.clear(centers[left], maps.Footprints(others, ground + low, ground + high), inner, outer)
    return score
