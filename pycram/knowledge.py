"""What a robot believes of objects: where they are, as it last saw, took or put them down.

``believed("milk")`` is what a plan may act on without looking: what the robot's latest look told, a step of the
recording. What somebody else has moved since it doesn't know; it looks again. Of what it has never seen it believes
nothing. The motions ``detecting`` and ``world-state-detecting`` teach it, and what it takes and puts down itself;
process modules for other cameras call :func:`learn`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from pycram.reasoning.choosing import Question
from pycram.scheduling.future import unwrap
from pycram.world.world import BulletWorld, Object
from recorder import records
from recorder.records.beliefs import sightings, word

if TYPE_CHECKING:
    from collections.abc import Mapping

    from recorder.geometry import PoseLike, Quaternion, Vector

__all__ = ["Belief", "beliefs", "believed", "learn"]


@dataclass(frozen=True, slots=True)
class Belief:
    """Where a robot believes an object to be.

    Attributes:
        object: The object.
        position: Of its base in the world, m; of what the robot holds, where the hand has it now.
        orientation: Of the same, xyzw.
        sim_step: Of the world when that was learned: simulated steps of 1/240 s.
        step: Of the recording, by which it was learned: a look, or a change with which it was taken or put down; -1 if
            that is in no recording that runs.
        source: "seen"; "told" by the world's state, without being seen; "held"; "placed", where the robot let go of it.
    """

    object: Object
    position: Vector
    orientation: Quaternion
    sim_step: int
    step: int
    source: str


def believed(what: str | Object, *, robot: Object | None = None) -> Belief | None:
    """Return what a robot believes of an object, or of those of a type what it learned last; None if nothing.

    Args:
        what: An object, or a type or a name of objects.
        robot: Who believes it; the current world's robot by default.

    Raises:
        BadArgument: It is none of these.
        NoWorld: There is no robot.
    """
    return next(iter(beliefs(what, robot=robot)), None)


def beliefs(what: str | Object | None = None, *, robot: Object | None = None) -> list[Belief]:
    """Return all that a robot believes of objects, what it learned last first.

    The arguments and errors are those of :func:`believed`; without ``what``, of any object.
    """
    wanted, who = unwrap(what), _robot(robot)
    if wanted is not None and not isinstance(wanted, str | Object):
        raise BadArgument("what", wanted, "an Object, or a type or a name of objects")
    world = who.world
    found = []
    with world.lock:
        for belief, step in world.beliefs.of(who.name):
            body = world.get_object(belief.object)
            if wanted is None or wanted is body or wanted in (body.type, body.name):
                held = belief.source == records.Belief.HELD
                position, turn = world.engine.pose(body.handle) if held else (belief.position, belief.orientation)
                (x, y, z), (i, j, k, w) = position, turn
                found.append(Belief(body, (x, y, z), (i, j, k, w), belief.sim_step, step, word(belief.source)))
    return found


def learn(poses: Mapping[Object, PoseLike], *, robot: Object | None = None) -> None:
    """Have a robot believe objects to be where it has seen them: for process modules with a camera of their own.

    It is one query on record, ``seen``.

    Args:
        poses: Of the objects in the world: xyz in m, xyzw.
        robot: Who saw them; the current world's robot by default.

    Raises:
        BadArgument: An object is in another world, or a pose is none.
        NoWorld: There is no robot.
    """
    who = _robot(robot)
    world, seen = who.world, {}
    for body, (position, orientation) in poses.items():
        if not isinstance(body, Object) or body.world is not world:
            raise BadArgument("poses", body, f"objects of {world.name}")
        seen[body.name] = checks.vector("position", position), checks.quaternion("orientation", orientation)
    question = Question("seen", {"robot": who}, list(poses), sightings(who.name, "seen", seen))
    with world.lock:
        with question.asked(world):
            pass
        world.beliefs.look(question.evidence, question.steps)


def _robot(robot: Object | None) -> Object:
    robot = unwrap(robot)
    if robot is None:
        return BulletWorld.current_robot()
    if not isinstance(robot, Object) or not robot.is_robot:
        raise BadArgument("robot", robot, 'an object of type "robot"')
    return robot
