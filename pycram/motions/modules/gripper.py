"""Opening and closing grippers: as far as nothing stops the fingers."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from pycram.foundation.failures import GripperBlocked, MissingPart
from pycram.motions.modules.simulated import FOLLOWING, SimulatedModule
from pycram.reasoning.choosing import choosing
from pycram.reasoning.grasping import fingers
from pycram.reasoning.rejections import Touching, short
from pycram.world import settling

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.foundation.collision_pair import CollisionPair
    from pycram.motions.designator import Designator
    from pycram.world.object import Object


@dataclass(frozen=True, slots=True)
class GripperMoved:
    """What came of opening or closing a gripper.

    Attributes:
        arm: name of the arm.
        share: how far it is open now: 0 is closed, 1 is open.
        stopped_by: what stopped the fingers, deepest first; nothing if they got as far as they can.
        released: what it has let go of, if anything.
        settled: whether that, and everything else, is at rest now.
    """

    arm: str
    share: float
    stopped_by: Sequence[CollisionPair] = ()
    released: Object | None = None
    settled: bool = True

    def __record__(self) -> object:
        """Return its fields, as records have it."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class MoveGripper(SimulatedModule):
    """Opens or closes the gripper of an arm until something stops the fingers; opening lets go of what it holds.

    What it lets go of falls, until everything is at rest or 5 s of simulated time are over. What it holds stops the
    fingers that would close.
    """

    failures = (GripperBlocked, MissingPart)
    failures_in_time = FOLLOWING

    def _execute(self, designator: Designator) -> GripperMoved:
        solution = designator.reference()
        robot = self.robot()
        arm = self.description(robot).arm(solution["gripper"])
        opening = solution["motion"] == "open"
        with self.execution.whole(robot.world):
            held = self.held(robot, arm) if opening else None
            with (
                robot.world.lock,
                choosing("finger_motion", robot.world, arm=arm.name, motion=solution["motion"], release=held) as choice,
            ):
                motion = fingers.moved(robot, arm, 1.0 if opening else 0.0, release=held)
                if motion.stopped_by:
                    choice.reject("all the way", Touching(motion.stopped_by))
                if held is not None and motion.stopped_by and motion.gap < fingers.CLEAR:
                    raise GripperBlocked(arm.name, held.name, motion.stopped_by)
                as_far = "as far as they get" if motion.stopped_by else "all the way"
                choice.take(as_far, share_open=short(motion.share))
                grip = self.execution.grip(robot, motion.positions)
            grip()
            settled = True
            if held is not None:
                with robot.world.lock:
                    robot.detach(held)
                    settling.separate(robot.world)
                settled = not self.execution.settle(robot.world)
        return GripperMoved(arm.name, motion.share, motion.stopped_by, held, settled)
