"""Where an object comes to rest when it is set down: the height at which it touches what is below."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import PlaceFailed
from pycram.reasoning.collision.simulation_clone import clone_of
from pycram.world import carried
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object
    from recorder.geometry import Quaternion, Vector

_ABOVE: Final = 0.05  # m by which the support may be higher than the target says
_BELOW: Final = 0.10  # m by which it may be lower
_STEP: Final = 0.005  # m between heights that are tried; thinner things than this are thick enough to stop a gripper
_ACCURACY: Final = 2e-4  # m
_ALONE: Final = 240  # steps in which an object falls that only the gripper held up
_STILL: Final = (0.01, math.radians(5))  # m, rad by which it may move then, as in `stable`
_OVERLAP: Final = 2e-4  # m that shapes at rest overlap anyway


def set_down(body: Object, target: Sequence[float], orientation: Quaternion) -> Vector:
    """Return the position at which an object rests.

    Args:
        body: the object; robots and what they hold don't count as support.
        target: xyz where it is wanted, m.
        orientation: xyzw there.

    Returns:
        The target with the height at which the object first touches something when it comes from above.

    Raises:
        PlaceFailed: there is no room, or nothing below that it could stand on.
    """
    world = body.world
    clone = clone_of(world, "reach")
    others = [other for other in world.objects if other is not body and not other.is_robot and other.carrier is None]
    clone.sync()
    copy, engine = clone.body(body.name), clone.engine
    x, y, z = target

    def touched(height: float) -> list[str]:
        engine.set_pose(copy, ((x, y, height), orientation))
        return [
            other.name
            for other in others
            if any(touch.distance < -_OVERLAP for touch in engine.closest_points(copy, clone.body(other.name)))
        ]

    try:
        high = z + _ABOVE
        blockers = touched(high)
        if blockers:
            raise PlaceFailed(body.name, target, f"{', '.join(blockers)} is there already")
        low = high
        while not touched(low):
            high, low = low, low - _STEP
            if low < z - _BELOW:
                raise PlaceFailed(body.name, target, f"nothing is within {_BELOW} m below that it could stand on")
        while high - low > _ACCURACY:
            half = (high + low) / 2
            if touched(half):
                low = half
            else:
                high = half
    finally:
        clone.invalidate(body.name)
    return x, y, high


def stands_alone(body: Object) -> bool:
    """Return whether an object stays where it is without robots and what they hold: tried for 1 s in a clone."""
    without = [other for other in body.world.objects if not carried.root_of(other).is_robot]
    clone = clone_of(body.world, "physics")
    copies, _ = clone.sync(without)
    try:
        before = clone.engine.pose(copies[body.name])
        clone.engine.step(_ALONE)
        after = clone.engine.pose(copies[body.name])
    finally:
        clone.invalidate(*(other.name for other in without))
    moved, turned = math.dist(before[0], after[0]), geometry.angle(before[1], after[1])
    return moved < _STILL[0] and turned < _STILL[1]
