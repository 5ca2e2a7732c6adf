"""A robot's beliefs: where it last saw, took or put down objects.

``believed("milk")`` returns the result of the robot's latest look. A robot notices later changes by others only when it
looks again. Grasps, placements, and the motions ``detecting`` and ``world-state-detecting`` update beliefs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from pycram.reasoning.choosing import Question
from pycram.scheduling.future import unwrap
from pycram.world.world import BulletWorld, Object
from recorder import records
from recorder.geometry import PoseLike, Quaternion, Vector
from recorder.records.beliefs import sightings, word

__all__ = ["Belief", "beliefs", "believed", "learn"]


@dataclass(frozen=True, slots=True)
class Belief:
    """A robot's belief about the pose of an object."""

    object: Object
    position: Vector  # position of the object's base in the world, m; for a held object, its present position
    orientation: Quaternion  # orientation of the object's base, xyzw
    sim_step: int  # simulated step (1/240 s) of the world at which the robot learned the pose
    step: int  # step of the look, grasp or placement that set the belief; -1 if no running recording contains the step
    #: "seen"; "told" (the robot read the world's state); "held"; "placed" (the robot released the object there).
    source: str


def believed(what: str | Object, *, robot: Object | None = None) -> Belief | None:
    """Return a robot's latest belief about an object, or about objects of a type; None without a belief.

    Args:
        what: An object, or a type or a name of objects.
        robot: None for the current world's robot.

    Raises:
        BadArgument: ``what`` has another type.
        NoWorld: There is no robot.
    """
    return next(iter(beliefs(what, robot=robot)), None)


def beliefs(what: str | Object | None = None, *, robot: Object | None = None) -> list[Belief]:
    """Return a robot's beliefs about objects, the latest first; by default about all objects; see :func:`believed`."""
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
    """Update a robot's beliefs with seen poses; own process modules for cameras call this.

    The recording contains the update as a query with the name ``seen``.

    Args:
        poses: Poses of the objects in the world: xyz in m, xyzw.
        robot: None for the current world's robot.

    Raises:
        BadArgument: An object is in another world, or a pose is invalid.
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
