"""Moving the base (thesis, Listing 4.3): it goes nowhere where the robot would touch something."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.failures import InCollision
from pycram.process_modules.simulated import SimulatedModule
from pycram.reasoning import rehearsal

if TYPE_CHECKING:
    from pycram.designator import Designator


class Navigation(SimulatedModule):
    """Puts the robot to a pose, with what it holds; refuses a pose in collision and leaves the world as it was."""

    def _execute(self, designator: Designator) -> None:
        solution = designator.reference()
        robot = self.robot()
        target, orientation = solution["target"], solution["orientation"]
        with robot.world.lock:
            touched = rehearsal.in_the_way(robot, {}, base=(tuple(target), tuple(orientation)), everything=True)
            if touched:
                raise InCollision(target, orientation, [body.name for body in touched])
            robot.set_position_and_orientation(target, orientation)
