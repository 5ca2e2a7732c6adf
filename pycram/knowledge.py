"""A robot's beliefs: where it last saw objects, took them or put them down.

A plan may act on ``believed("milk")`` without a new look: this is the result of the robot's latest look, a step of the
recording. If others move objects afterwards, the robot doesn't notice until it looks again. It has no belief about
objects that it never saw. The motions ``detecting`` and ``world-state-detecting`` update beliefs, and so do its own
grasps and placements; process modules for other cameras call :func:`learn`.
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
    """A robot's belief about the pose of an object."""

    object: Object
    position: Vector  # position of its base in the world, m; for a held object, its present position
    orientation: Quaternion  # orientation of its base, xyzw
    sim_step: int  # simulated step (1/240 s) of the world at which the robot learned it
    #: The recorded step that taught it: a look, a grasp or a placing; -1 if no running recording has the step.
    step: int
    #: "seen"; "told" by the world's state, without being seen; "held"; "placed", where the robot released it.
    source: str


def believed(what: str | Object, *, robot: Object | None = None) -> Belief | None:
    """Return a robot's latest belief about an object, or about objects of a type; None if it has none.

    Args:
        what: An object, or a type or a name of objects.
        robot: By default the current world's robot.

    Raises:
        BadArgument: ``what`` is something else.
        NoWorld: There is no robot.
    """
    return next(iter(beliefs(what, robot=robot)), None)


def beliefs(what: str | Object | None = None, *, robot: Object | None = None) -> list[Belief]:
    """Return a robot's beliefs about objects, the latest first; without ``what``, about all objects.

    The arguments and errors are those of :func:`believed`.
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
    """Update a robot's beliefs with seen poses; for process modules with a camera of their own.

    This is recorded as one query, ``seen``.

    Args:
        poses: Poses of the objects in the world: xyz in m, xyzw.
        robot: By default the current world's robot.

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
