"""What process modules for simulated robots have in common: the robot of the current world, and its description."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import Displaced, TrackingLost, TrajectoryEnded, UsageError
from pycram.motions.execution import INSTANT
from pycram.motions.process_module import ProcessModule
from pycram.world import carried
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from pycram.models.robots.description import Arm, RobotDescription
    from pycram.motions.execution import Execution
    from pycram.world.object import Object

AS_ASKED: Final = "as asked"
"""The only candidate, where a plan leaves nothing to choose."""

FOLLOWING: Final = (TrackingLost, Displaced, TrajectoryEnded)
"""Failures of whatever follows a trajectory."""


class NoDescription(UsageError):
    """The robot has no description, so that process modules can't know its arms.

    Attributes:
        robot: its name.
    """

    def __init__(self, robot: str) -> None:
        super().__init__(f"nothing is known of the robot {robot}; give Object(..., description=...) its TOML file")
        self.robot = robot


class SimulatedModule(ProcessModule):
    """A process module that works on the current world's robot.

    Args:
        execution: how what it decides is done; at once by default.
    """

    execution: Execution = INSTANT

    def __init__(self, execution: Execution = INSTANT) -> None:
        self.execution = execution
        self.one_at_a_time = not execution.takes_time

    @staticmethod
    def robot() -> Object:
        """Return the robot.

        Raises:
            NoWorld: there is none.
        """
        return BulletWorld.current_robot()

    @staticmethod
    def held(robot: Object, arm: Arm) -> Object | None:
        """Return what a robot holds with the gripper of an arm; None if nothing."""
        return carried.attached_to(robot, arm.tool_frame)

    @staticmethod
    def description(robot: Object) -> RobotDescription:
        """Return a robot's description.

        Raises:
            NoDescription: it has none.
        """
        if robot.description is None:
            raise NoDescription(robot.name)
        return robot.description
