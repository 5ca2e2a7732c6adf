"""The reasoning queries (thesis 4.4, table 4.3): what is so, and what would be.

Import it as ``btr``. Queries leave no trace in the world; each call is on record with its answer and what it rests on.
Answers behave as the thesis' bool or list and carry their ``evidence``. Where a position of a camera is asked for, the
name of a camera's frame or a pair of position and orientation will do as well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import ReasoningError
from pycram.handle import unwrap
from pycram.reasoning.collision import checker as _rehearsal
from pycram.reasoning.collision import ray_cast as _outline
from pycram.reasoning.grasping import choice as _choice
from pycram.reasoning.kinematics import reach as _reach
from pycram.reasoning.queries import contact as _contact
from pycram.reasoning.queries import reachability as _reachability
from pycram.reasoning.queries import stability as _stability
from pycram.reasoning.queries import visibility as _visibility
from pycram.reasoning.queries.query import Asking, Found, Verdict, asking, robot_of, world_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pycram.world.object import Object
    from pycram.world.world import BulletWorld
    from recorder.geometry import Pose, Quaternion

__all__ = [
    "ReasoningError",
    "blocking",
    "contact",
    "occluding",
    "reachable",
    "reachable_object",
    "reachable_pose",
    "reachable_poses",
    "stable",
    "supporting",
    "visible",
]

VISIBLE_SHARE: Final = 0.8
"""Share of an object's pixels that make it visible (thesis 4.4.3)."""


def stable(object: Object, world: BulletWorld | None = None) -> Verdict:  # noqa: A002  the original's name
    """Whether an object stays where it is when time runs (thesis 4.4.1).

    Args:
        object: the object.
        world: its world; only for calls as in the thesis.

    Returns:
        False if it would move more than 1 cm or turn more than 5 degrees within 2 s; the evidence says how far.
        See :mod:`pycram.reasoning.queries.stability` for why creep doesn't count.
    """
    body: Object = unwrap(object)
    place = world_of(body, world=world)
    with asking("stable", place, {"object": body}) as asked:
        answer, evidence = _stability.simulate(body)
        asked.evidence = dict(evidence)
        asked.answer = verdict = Verdict(answer, asked.evidence)
    return verdict


def contact(object1: Object, object2: Object, world: BulletWorld | None = None, *, margin: float = 0.0) -> Verdict:
    """Whether two objects touch now (thesis 4.4.2); nothing is stepped.

    Args:
        object1: one.
        object2: the other.
        world: their world.
        margin: gap in m that counts as touching, beyond the millimetre of the engine.

    Returns:
        The answer; the evidence names the links and points.
    """
    one, other = unwrap(object1), unwrap(object2)
    place = world_of(one, other, world=world)
    gap = checks.in_range("margin", margin, 0.0)
    with asking("contact", place, {"object1": one, "object2": other, "margin": gap}) as asked:
        touches = _contact.touches(one, other, _contact.MARGIN + gap)
        asked.evidence = _contact.evidence(touches)
        asked.answer = verdict = Verdict(touches, asked.evidence)
    return verdict


def visible(
    object: Object,  # noqa: A002  the original's name
    camera: Sequence[float] | str,
    world: BulletWorld | None = None,
    *,
    robot: Object | None = None,
    threshold: float = VISIBLE_SHARE,
) -> Verdict:
    """Whether an object is seen (thesis 4.4.3).

    Args:
        object: the object.
        camera: a position in m (looks at the object), (position, orientation) of an optical frame, or the name of a
            robot's camera frame, as it is directed now and with its field of view.
        world: its world.
        robot: whose camera; the world's robot by default.
        threshold: share of its pixels that has to be exceeded.

    Returns:
        The answer; the evidence has the share, the pixels and what hides them.
    """
    body: Object = unwrap(object)
    machine = None if robot is None else robot_of(robot)
    place = world_of(*(other for other in (body, machine) if other is not None), world=world)
    share = checks.in_range("threshold", threshold, 0.0)
    looks = _whose(camera, place, machine)
    with asking("visible", place, {"object": body, "camera": camera, **looks, "threshold": share}) as asked:
        view = _visibility.view(body, _visibility.camera_at(camera, body, **looks))
        asked.picture = view.picture()
        asked.evidence = view.evidence()
        asked.answer = verdict = Verdict(view.share > share, asked.evidence)
    return verdict


def occluding(
    object: Object,  # noqa: A002  the original's name
    camera: Sequence[float] | str,
    world: BulletWorld | None = None,
    *,
    robot: Object | None = None,
) -> Found[Object]:
    """What stands between an object and a camera (thesis 4.4.4).

    Args:
        object: the object.
        camera: as for :func:`visible`.
        world: its world.
        robot: whose camera; the world's robot by default.

    Returns:
        The objects in between, most hiding first; the evidence has their shares.
    """
    body: Object = unwrap(object)
    machine = None if robot is None else robot_of(robot)
    place = world_of(*(other for other in (body, machine) if other is not None), world=world)
    looks = _whose(camera, place, machine)
    with asking("occluding", place, {"object": body, "camera": camera, **looks}) as asked:
        view = _visibility.view(body, _visibility.camera_at(camera, body, **looks))
        asked.picture = view.picture()
        asked.evidence = view.evidence()
        found = Found((place.get_object(name) for name in view.hiding), asked.evidence)
        asked.answer = found
    return found


def _whose(camera: object, world: BulletWorld, robot: Object | None) -> dict[str, Object]:
    """The robot whose camera a frame's name means; nothing where no frame is named, or there is no robot."""
    machine = robot or world.robot
    return {"robot": machine} if isinstance(camera, str) and machine is not None else {}


def reachable_object(
    object: Object,  # noqa: A002  the original's name
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    threshold: float = _reach.THRESHOLD,
    *,
    grasp: str | None = None,
    collision_free: bool = False,
) -> Verdict:
    """Whether a robot reaches an object with a link (thesis 4.4.5).

    Args:
        object: the object.
        robot: the robot.
        gripper_name: the link, mostly a tool frame.
        world: their world.
        threshold: m that the link may stay away.
        grasp: "front", "top", "left" or "right"; any orientation by default.
        collision_free: also ask that nothing else is in the way.

    Returns:
        The answer; the evidence has the joints of the posture.
    """
    body, machine = unwrap(object), robot_of(robot)
    place = world_of(body, machine, world=world)
    machine.check_link(checks.text("gripper link", gripper_name))
    orientation = None if grasp is None else _reach.approach(grasp, machine)
    told = {"object": body, "robot": machine, "gripper": gripper_name, "threshold": threshold, "grasp": grasp}
    told["collision_free"] = collision_free
    with asking("reachable_object", place, told) as asked:
        target = _outline.middle(body)
        asked.answer = verdict = _reaches(
            asked, machine, gripper_name, target, orientation, threshold, body, collision_free
        )
    return verdict


def reachable_pose(
    pose: Sequence[float],
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    threshold: float = _reach.THRESHOLD,
    *,
    orientation: Sequence[float] | None = None,
    collision_free: bool = False,
) -> Verdict:
    """Whether a robot reaches a place with a link (thesis 4.4.5).

    Args:
        pose: position xyz in the world, m.
        robot: the robot.
        gripper_name: the link, mostly a tool frame.
        world: its world.
        threshold: m that the link may stay away.
        orientation: xyzw that the link shall have there; any by default.
        collision_free: also ask that nothing is in the way.

    Returns:
        The answer; the evidence has the joints of the posture.
    """
    machine = robot_of(robot)
    place = world_of(machine, world=world)
    machine.check_link(checks.text("gripper link", gripper_name))
    target = checks.vector("pose", pose)
    turn = None if orientation is None else checks.quaternion("orientation", orientation)
    told = {"pose": target, "robot": machine, "gripper": gripper_name, "threshold": threshold, "orientation": turn}
    told["collision_free"] = collision_free
    with asking("reachable_pose", place, told) as asked:
        asked.answer = verdict = _reaches(asked, machine, gripper_name, target, turn, threshold, None, collision_free)
    return verdict


def reachable_poses(
    poses: Sequence[Sequence[float]],
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    threshold: float = _reach.THRESHOLD,
    *,
    orientations: Sequence[Sequence[float]] | None = None,
    bases: Sequence[tuple[Sequence[float], Sequence[float]]] | None = None,
    collision_free: bool = False,
    ignoring: Sequence[Object] = (),
) -> Found[Verdict]:
    """As :func:`reachable_pose`, for many targets or for many places of the robot, in a fraction of the time.

    Args:
        poses: positions xyz in the world, m. One of them goes with all bases, one base with all of them; else there
            are as many of each.
        robot: the robot.
        gripper_name: the link, mostly a tool frame.
        world: its world.
        threshold: m that the link may stay away.
        orientations: xyzw that the link shall have, one or as many as poses; any by default.
        bases: positions and orientations of the robot's base to try; where it stands by default.
        collision_free: also ask that nothing is in the way, of the base neither.
        ignoring: objects that aren't in the way, as the one that is to be grasped.

    Returns:
        The answers in order, each with its evidence.

    Raises:
        BadArgument: numbers of poses, orientations and bases don't fit.
    """
    machine = robot_of(robot)
    place = world_of(machine, world=world)
    machine.check_link(checks.text("gripper link", gripper_name))
    near = checks.in_range("threshold", threshold, 0.0)
    ignored: list[Object] = [unwrap(other) for other in ignoring]
    world_of(machine, *ignored, world=place)
    count = max(len(poses), len(bases or ()), len(orientations or ()))
    targets = _reachability.as_many("poses", [checks.vector("pose", pose) for pose in poses], count)
    turns: list[Quaternion | None] = [None] * count
    if orientations is not None:
        turns = [
            *_reachability.as_many(
                "orientations", [checks.quaternion("orientation", turn) for turn in orientations], count
            )
        ]
    stands: list[Pose | None] = [None] * count
    if bases is not None:
        places = [(checks.vector("base", at), checks.quaternion("base", turn)) for at, turn in bases]
        stands = [*_reachability.as_many("bases", places, count)]
    told = {"poses": poses, "robot": machine, "gripper": gripper_name, "threshold": near, "bases": bases}
    told |= {"orientations": orientations, "collision_free": collision_free, "ignoring": ignored}
    with asking("reachable_poses", place, told) as asked:
        solver = _reach.Solver(machine, gripper_name)
        rehearsal = _rehearsal.CollisionChecker(machine, solver.joints, ignored, everything=bases is not None)
        everything = list(zip(targets, turns, stands, strict=True))
        found: Found[Verdict] = Found()
        with rehearsal:
            for (at, turn, base), ways in zip(everything, solver.at_once(everything), strict=True):
                options = ways or solver.postures(at, turn, thorough=collision_free, base=base, threshold=near)
                rehearsed = rehearsal if collision_free else None
                found.append(_reachability.judge(options, near, rehearsed, oriented=turn is not None, base=base))
        asked.evidence = {"reached": sum(found), "distances": [verdict.evidence["distance"] for verdict in found]}
        found.evidence = dict(asked.evidence)
        asked.answer = found
    return found


def reachable(
    pose: Object | Sequence[float],
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    threshold: float = _reach.THRESHOLD,
) -> Verdict:
    """Whether a robot reaches an object or a position with a link (thesis 4.4.5).

    Args:
        pose: an object, or a position xyz in the world, m.
        robot: the robot.
        gripper_name: the link, mostly a tool frame.
        world: their world.
        threshold: m that the link may stay away.
    """
    target = unwrap(pose)
    if isinstance(target, list | tuple) or hasattr(target, "__array__"):
        return reachable_pose(target, robot, gripper_name, world, threshold)
    return reachable_object(target, robot, gripper_name, world, threshold)


def blocking(
    object: Object,  # noqa: A002  the original's name
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    *,
    grasp: str | None = None,
) -> Found[Object]:
    """What a robot would touch if it reached for an object (thesis 4.4.6).

    Of the postures that reach, the one that touches least counts: a plan would take that one.

    Args:
        object: the object.
        robot: the robot.
        gripper_name: the link, mostly a tool frame.
        world: their world.
        grasp: "front", "top", "left" or "right"; by default the one that touches least.

    Returns:
        The objects in the way, deepest first, without the target and what the robot holds, and without the floor it
        stands on; the environment has the type "environment". Empty if it can't be reached at all, which the
        evidence says.
    """
    body, machine = unwrap(object), robot_of(robot)
    place = world_of(body, machine, world=world)
    machine.check_link(checks.text("gripper link", gripper_name))
    if grasp is not None:
        _reach.approach(grasp, machine)
    told = {"object": body, "robot": machine, "gripper": gripper_name, "grasp": grasp}
    with asking("blocking", place, told) as asked:
        plan = _choice.best(body, machine, gripper_name, None if grasp is None else (grasp,))
        asked.evidence = plan.evidence()
        found = Found(plan.obstacles, asked.evidence)
        asked.answer = found
    return found


def supporting(object1: Object, object2: Object, world: BulletWorld | None = None) -> Verdict:
    """Whether the first object carries the second from below (thesis 4.4.7).

    Args:
        object1: the one that would carry.
        object2: the one that would be carried.
        world: their world.

    Returns:
        The answer; the evidence names the links that carry and the normals there.
    """
    lower, upper = unwrap(object1), unwrap(object2)
    place = world_of(lower, upper, world=world)
    with asking("supporting", place, {"object1": lower, "object2": upper}) as asked:
        answer, evidence = _contact.supports(lower, upper)
        asked.evidence = dict(evidence)
        asked.answer = verdict = Verdict(answer, asked.evidence)
    return verdict


def _reaches(
    asked: Asking,
    robot: Object,
    link: str,
    target: Sequence[float],
    orientation: Sequence[float] | None,
    threshold: float,
    body: Object | None,
    collision_free: bool,
) -> Verdict:
    """The common part of the reachable queries."""
    near = checks.in_range("threshold", threshold, 0.0)
    solver = _reach.Solver(robot, link)
    options = solver.postures(target, orientation, thorough=collision_free, threshold=near)
    oriented = orientation is not None
    if collision_free:
        with _rehearsal.CollisionChecker(robot, solver.joints, [] if body is None else [body]) as rehearsal:
            verdict = _reachability.judge(options, near, rehearsal, oriented=oriented)
    else:
        verdict = _reachability.judge(options, near, None, oriented=oriented)
    asked.evidence = dict(verdict.evidence)
    return verdict
