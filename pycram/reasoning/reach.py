"""What a robot's arm can reach, and what would be in its way (thesis 4.4.5, 4.4.6).

Postures come from :mod:`pycram.reasoning.kinematics`, which keeps to joint limits; collisions are looked for in a twin
that is put into the posture. Neither touches the world.

Grasps are named by the side of the object that the gripper comes from, as seen by the robot: "front" is the side that
faces it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram import cargo, checks
from pycram.failures import UnknownName
from pycram.reasoning.kinematics import ArmKinematics, Posture
from pycram.reasoning.twin import twin
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from pycram.body import Body
    from pycram.engine import Engine, Touch
    from pycram.objects import Object
    from recorder.geometry import Pose, Quaternion

THRESHOLD: Final = 0.01  # m between tool and target that count as reached
DEPTH: Final = 2e-3  # m of overlap below which shapes, which the engine pads, don't count as in the way
_STANDING: Final = 0.9  # of a normal's length pointing up
_FEET: Final = 0.02  # m above the ground


def approach(grasp: str, robot: Object) -> Quaternion:
    """Orientation of the tool for a grasp, in the world.

    Args:
        grasp: "front", "top", "left" or "right".
        robot: whose heading says what is front.

    Raises:
        UnknownName: another grasp.
    """
    if checks.text("grasp", grasp) not in GRASPS:
        raise UnknownName("grasp", grasp, "a gripper", GRASPS)
    x, y, _ = geometry.rotate(robot.get_orientation(), (1.0, 0.0, 0.0))
    heading = geometry.from_rpy(0.0, 0.0, math.atan2(y, x))
    return geometry.product(heading, GRASPS[grasp])


GRASPS: Final[Mapping[str, Quaternion]] = {
    "front": (0.0, 0.0, 0.0, 1.0),
    "top": geometry.from_rpy(0.0, math.pi / 2, 0.0),
    "left": geometry.from_rpy(0.0, 0.0, -math.pi / 2),  # from the robot's left side to its right
    "right": geometry.from_rpy(0.0, 0.0, math.pi / 2),
}
"""Tool orientations in a frame that has the robot's heading."""


@dataclass(frozen=True, slots=True)
class Reach:
    """How a link gets to a target.

    Attributes:
        posture: the joints that move, and how near they bring it.
        link: the link that is to get there.
    """

    posture: Posture
    link: str

    def reached(self, threshold: float) -> bool:
        """Whether position (and orientation, if one was asked for) are within tolerance."""
        return self.posture.position_error <= threshold and self.posture.turn_error < math.radians(2)

    def evidence(self) -> dict[str, object]:
        """As records carry it."""
        posture = self.posture
        return {"joints": posture.positions, "distance": posture.position_error, "turn": posture.turn_error}


def moving_joints(robot: Object, link: str) -> tuple[str, tuple[str, ...]]:
    """The joints that bring a link to a target, and the link that they hang on.

    Args:
        robot: the robot.
        link: an arm's tool frame, or any other of its links.

    Raises:
        UnknownName: there is no such link.
    """
    robot.check_link(link)
    arm = robot.description.arm_of(link) if robot.description else None
    if arm is not None:
        return arm.base_link, arm.joints
    chain = [joint for joint in robot.urdf.chain(robot.base_link, link) if joint.movable and joint.type != "prismatic"]
    if not chain:
        return robot.base_link, ()
    return chain[0].parent, tuple(joint.name for joint in chain)


def postures(
    robot: Object,
    link: str,
    position: Sequence[float],
    orientation: Sequence[float] | None,
    *,
    thorough: bool = False,
    quick: bool = False,
    seed: Mapping[str, float] | None = None,
) -> list[Reach]:
    """Postures that bring a link of a robot to a pose in the world, nearest to its present one first.

    Args:
        robot: the robot, as it stands.
        link: an arm's tool frame, or any other of its links.
        position: xyz in the world, m.
        orientation: xyzw in the world, None if any will do.
        thorough: look for several.
        quick: don't look long; a miss then proves nothing.
        seed: posture to start from; the present one by default.

    Returns:
        At least one; if the first doesn't reach, none does.
    """
    base, joints = moving_joints(robot, link)
    now = robot.get_joint_positions()
    if not joints:
        away = math.dist(robot.get_link_position(link), position)
        return [Reach(Posture({}, away, 0.0, away < THRESHOLD), link)]
    solver = ArmKinematics(robot.urdf, base, link, joints, now)
    world_T_base = robot.get_link_position_and_orientation(base)
    base_T_world = geometry.invert(world_T_base)
    target = geometry.transform(base_T_world, position)
    turn = None if orientation is None else geometry.product(base_T_world[1], orientation)
    arm = robot.description.arm_of(link) if robot.description else None
    start = now if seed is None else seed
    seeds = [start, *(arm.posture(name) for name in arm.poses)] if arm else [start]
    return [Reach(posture, link) for posture in solver.solve_all(target, turn, seeds, thorough=thorough, quick=quick)]


def in_the_way(
    robot: Object,
    positions: Mapping[str, float],
    ignored: Iterable[Object] = (),
    base: Pose | None = None,
    *,
    everything: bool = False,
) -> dict[Object, dict[str, object]]:
    """What the robot would touch in another posture or at another place.

    Args:
        robot: the robot.
        positions: joint values in rad or m by name that differ from the present ones.
        ignored: objects that don't count.
        base: pose of the robot's base; the present one by default.
        everything: count all links of the robot; else only those that the joints move.

    Returns:
        For each object, the robot's links that would touch it, its own links, and the depth in m. The floor that a
        robot stands on isn't in the way of its wheels; what it holds moves along and may be in the way of others too.
    """
    world = robot.world
    copy = twin(world, "reach")
    bodies = copy.sync()
    engine, body = copy.engine, bodies[robot.name]
    held = _held(robot)
    skipped = {robot, *(other for other, _, _ in held), *ignored}
    moving = set(robot.links) if everything else set(cargo.moved_links(robot.urdf, positions))
    movers = [(robot, body, moving)]
    movers += [(other, bodies[other.name], set(other.links)) for other, link, _ in held if link in moving or everything]
    try:
        if base is not None:
            engine.set_pose(body, base)
        engine.set_joints(body, positions)
        for other, link, pose in held:
            engine.set_pose(bodies[other.name], geometry.multiply(engine.link_pose(body, link), pose))
        found: dict[Object, dict[str, object]] = {}
        for other in world.objects:
            if other in skipped:
                continue
            hits = _hits(engine, movers, other, bodies[other.name])
            if hits:
                found[other] = hits
    finally:
        copy.disturbed(robot.name, *(other.name for other, _, _ in held))
    return found


def _held(robot: Object) -> list[tuple[Object, str, Pose]]:
    """What a robot carries, directly and through other things: object, the robot's link, pose in that link."""
    held: list[tuple[Object, str, Pose]] = []
    queue = [(attachment.body, attachment.carrier_link) for attachment in robot.carried]
    while queue:
        body, link = queue.pop()
        link_T_world = geometry.invert(robot.get_link_position_and_orientation(link))
        held.append((body, link, geometry.multiply(link_T_world, body.get_position_and_orientation())))
        queue.extend((attachment.body, link) for attachment in body.carried)
    return held


def _hits(
    engine: Engine, movers: Iterable[tuple[Object, Body, set[str]]], other: Object, obstacle: Body
) -> dict[str, object]:
    links: set[str] = set()
    own: set[str] = set()
    deepest = 0.0
    for mover, body, moving in movers:
        for touch in engine.touches(body, obstacle):
            if touch.link_a not in moving or touch.distance > -DEPTH:
                continue
            if mover.is_robot and other.is_environment and _carries_wheels(touch):
                continue
            links.add(touch.link_a)
            own.add(touch.link_b)
            deepest = max(deepest, -touch.distance)
    return {"links": sorted(links), "by": sorted(own), "depth": deepest} if links else {}


def _carries_wheels(touch: Touch) -> bool:
    """Whether a robot stands there rather than bumps: a contact from below, at the height of its base's feet."""
    return touch.normal[2] > _STANDING and touch.position_b[2] < _FEET
