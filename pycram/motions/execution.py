"""How motions are carried out: at once, as in the thesis, or in simulated time.

Process modules decide what is to get where, and look at what came of it; an execution gets it there. What it is asked
for is planned when it is asked, with the world's lock held, so that a motion fails before anything has moved; it is
done when what was returned is called, without the lock.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final, TypeAlias

from pycram.foundation.failures import WorldClosed
from pycram.world import settling
from recorder.records import STEPS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from contextlib import AbstractContextManager

    from pycram.models.robots.description import Arm
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld
    from recorder.geometry import Vector

#: Does what was planned.
Step: TypeAlias = Callable[[], None]

TIMEOUT: Final = 5
"""Seconds of simulated time within which all has to be at rest."""


class Execution(ABC):
    """How joints and bases get from where they are to where they shall be.

    All but :meth:`whole` and :meth:`settle` return what does it, and raise PlanFailure if there is no way there.

    Attributes:
        takes_time: Whether simulated time passes meanwhile, in which others move too.
    """

    takes_time: bool

    @abstractmethod
    def whole(self, world: BulletWorld) -> AbstractContextManager[None]:
        """Return the context that all of a motion is carried out in."""

    @abstractmethod
    def drive(self, robot: Object, position: Sequence[float], orientation: Sequence[float]) -> Step:
        """Get the base to a pose: xyz in m, xyzw."""

    @abstractmethod
    def move(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Get joints to positions in rad or m by name, past what is in the way."""

    @abstractmethod
    def approach(
        self,
        robot: Object,
        arm: Arm,
        posture: Mapping[str, float],
        direction: Vector,
        *,
        opened: Mapping[str, float] | None = None,
        ignored: Sequence[Object] = (),
        ignored_links: Sequence[tuple[Object, str]] = (),
    ) -> Step:
        """Get an arm to a posture, the last centimetres straight.

        Args:
            robot: The robot.
            arm: The arm.
            posture: Positions in rad or m by joint.
            direction: From which the tool comes: a unit vector in the tool frame of that posture.
            opened: Positions of the gripper's joints, to which it is brought before.
            ignored: What the hand may touch on the last centimetres.
            ignored_links: The same, by objects and links of theirs.
        """

    @abstractmethod
    def grip(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Get a gripper's joints to positions where nothing stops the fingers."""

    @abstractmethod
    def open(self, robot: Object, arm: Arm) -> Step:
        """Open a gripper as far as it gets."""

    @abstractmethod
    def close(self, robot: Object, arm: Arm) -> Step:
        """Close a gripper as far as it gets."""

    @abstractmethod
    def pull(
        self,
        robot: Object,
        container: Object,
        joint: str,
        values: Sequence[float],
        postures: Sequence[Mapping[str, float]],
    ) -> Step:
        """Get an arm that holds a handle through postures, and the handle's joint through their values (rad or m)."""

    @abstractmethod
    def retreat(self, robot: Object, arm: Arm, ignored_links: Sequence[tuple[Object, str]] = ()) -> Step | None:
        """Draw a hand straight back out of what it has let go of; None if it stays where it is.

        Args:
            robot: The robot.
            arm: The arm.
            ignored_links: What the hand may touch on its way, by objects and links of theirs.
        """

    @abstractmethod
    def lift(self, robot: Object, arm: Arm) -> Step | None:
        """Raise what an arm has taken off what it stands on; None if it stays where it is."""

    @abstractmethod
    def settle(self, world: BulletWorld) -> Sequence[Object]:
        """Let simulated time pass until everything is at rest, at most :data:`TIMEOUT`; return what isn't.

        Raises:
            WorldClosed: Another thread has ended the world meanwhile.
        """


class InstantExecution(Execution):
    """Joints and bases are there at once: each change is exact, and no time passes but to settle.

    The world's lock is held over a motion, so nobody sees half of it.
    """

    takes_time = False

    def whole(self, world: BulletWorld) -> AbstractContextManager[None]:
        """Return the world's lock."""
        return world.lock

    def drive(self, robot: Object, position: Sequence[float], orientation: Sequence[float]) -> Step:
        """Put the robot there."""
        return partial(robot.set_position_and_orientation, position, orientation)

    def move(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Put the joints there."""
        return partial(robot.set_joint_positions, positions)

    def approach(
        self,
        robot: Object,
        arm: Arm,  # noqa: ARG002  as below: no way leads there
        posture: Mapping[str, float],
        direction: Vector,  # noqa: ARG002
        *,
        opened: Mapping[str, float] | None = None,
        ignored: Sequence[Object] = (),  # noqa: ARG002
        ignored_links: Sequence[tuple[Object, str]] = (),  # noqa: ARG002
    ) -> Step:
        """Put gripper and arm there."""

        def step() -> None:
            if opened is not None:
                robot.set_joint_positions(opened)
            robot.set_joint_positions(posture)

        return step

    def grip(self, robot: Object, positions: Mapping[str, float]) -> Step:
        """Put the fingers there."""
        return partial(robot.set_joint_positions, positions)

    def open(self, robot: Object, arm: Arm) -> Step:
        """Put the fingers as far apart as they get where nothing is."""
        return partial(robot.set_joint_positions, arm.gripper.positions("open"))

    def close(self, robot: Object, arm: Arm) -> Step:
        """Put the fingers together, or through what is between them."""
        return partial(robot.set_joint_positions, arm.gripper.positions("close"))

    def pull(
        self,
        robot: Object,
        container: Object,
        joint: str,
        values: Sequence[float],
        postures: Sequence[Mapping[str, float]],
    ) -> Step:
        """Put the handle's joint, then the arm, to each value."""

        def step() -> None:
            for value, posture in zip(values[1:], postures[1:], strict=True):
                container.set_joint_position(joint, value)
                robot.set_joint_positions(posture)

        return step

    def retreat(
        self,
        robot: Object,  # noqa: ARG002  as above
        arm: Arm,  # noqa: ARG002
        ignored_links: Sequence[tuple[Object, str]] = (),  # noqa: ARG002
    ) -> Step | None:
        """Leave the hand where it is."""
        return None

    def lift(self, robot: Object, arm: Arm) -> Step | None:  # noqa: ARG002  as above
        """Leave it where it is."""
        return None

    def settle(self, world: BulletWorld) -> Sequence[Object]:
        """Simulate, as one change of the world."""
        restless, completed = settling.settle(world, TIMEOUT * STEPS_PER_SECOND)
        if world.exiting and not completed:
            raise WorldClosed(world.name, "simulate on")
        return restless


INSTANT: Final = InstantExecution()
