"""Folding the arms, so that they are in nobody's way."""

from __future__ import annotations

from pycram.actions.action import action
from pycram.actions.hands import is_parked
from pycram.actions.performing import perform
from pycram.foundation.failures import NoPath, PostureInCollision
from pycram.motions.designator import MotionDesignator
from pycram.world.world import BulletWorld


@action("parking-arms")
def parking_arms(arm: str | None = None) -> None:
    """Folds the arms that aren't folded, together if they can; with what they hold.

    Args:
        arm: Name of the arm; all by default.
    """
    description = BulletWorld.current_robot().description
    every = [] if description is None else [each for each in description.arms.values() if "park" in each.poses]
    open_ = [each.name for each in every if arm in (None, each.name) and not is_parked(each)]
    if not open_:
        return
    try:
        perform(MotionDesignator([("type", "move-arm-joints"), *((f"{name}-arm", "park") for name in open_)]))
    except (PostureInCollision, NoPath):
        if len(open_) == 1:
            raise
        for name in open_:
            perform(MotionDesignator([("type", "move-arm-joints"), (f"{name}-arm", "park")]))
