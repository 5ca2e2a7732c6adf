"""Reachability: whether a robot reaches a target with a link (thesis 4.4.5), and the objects in the way (4.4.6)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from pycram.reasoning.choosing import Choice, considering
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.grasping import choice
from pycram.reasoning.grasping.grasps import grasp_orientation
from pycram.reasoning.kinematics.inverse import THRESHOLD, Posture, Solver
from pycram.reasoning.queries.query import Found, Verdict, query
from pycram.reasoning.rejections import OutOfReach, Touching
from pycram.scheduling.future import unwrap
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder.geometry import Pose, Quaternion

T = TypeVar("T")


def reachable(
    pose: Object | Sequence[float],
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    threshold: float = THRESHOLD,
    *,
    orientation: Sequence[float] | None = None,
    grasp: str | None = None,
    collision_free: bool = False,
) -> Verdict:
    """Return whether a robot reaches an object or a position with a link (thesis 4.4.5).

    Args:
        pose: an object, or a position xyz in the world, m.
        gripper_name: the link, usually a tool frame.
        threshold: m, largest distance between the link and a reached target.
        orientation: xyzw of the link at the target; None for any orientation.
        grasp: the side from which the link comes, instead of an orientation: "front", "top", "left" or "right".
        collision_free: whether the robot may not touch any object.

    Raises:
        BadArgument: Both ``orientation`` and ``grasp`` are given.
    """
    target = unwrap(pose)
    if grasp is not None and orientation is not None:
        raise BadArgument("grasp", grasp, "either a grasp or an orientation")
    given = (target, robot, gripper_name, world, threshold)
    if isinstance(target, list | tuple) or hasattr(target, "__array__"):
        turn = orientation if grasp is None else grasp_orientation(grasp, robot)
        return reachable_pose(*given, orientation=turn, collision_free=collision_free)
    return reachable_object(*given, grasp=grasp, orientation=orientation, collision_free=collision_free)


@query
def reachable_object(
    object: Object,
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    threshold: float = THRESHOLD,
    *,
    grasp: str | None = None,
    orientation: Sequence[float] | None = None,
    collision_free: bool = False,
) -> Verdict:
    """Return whether a robot reaches an object with a link (thesis 4.4.5).

    :func:`reachable` describes the arguments. With ``collision_free``, the robot may touch only the target.

    Returns:
        The answer. The evidence has the joint positions of the posture.
    """
    if grasp is not None:
        orientation = grasp_orientation(grasp, robot)
    return _reach(robot, gripper_name, center(object), orientation, threshold, [object] if collision_free else None)


@query
def reachable_pose(
    pose: Sequence[float],
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    threshold: float = THRESHOLD,
    *,
    orientation: Sequence[float] | None = None,
    collision_free: bool = False,
) -> Verdict:
    """Return whether a robot reaches a position with a link (thesis 4.4.5), as :func:`reachable_object` does."""
    return _reach(robot, gripper_name, pose, orientation, threshold, [] if collision_free else None)


@query
def reachable_poses(
    poses: Sequence[Sequence[float]],
    robot: Object,
    gripper_name: str,
    world: BulletWorld | None = None,
    threshold: float = THRESHOLD,
    *,
    bases: Sequence[tuple[Sequence[float], Sequence[float]]] | None = None,
    orientations: Sequence[Sequence[float]] | None = None,
    collision_free: bool = False,
    ignoring: Sequence[Object] = (),
) -> Found[Verdict]:
    """Answer :func:`reachable_pose` for many targets or many poses of the robot, much faster than one by one.

    Args:
        poses: positions xyz in the world, m: one for each base, or a single position for all bases.
        bases: positions and orientations of the robot's base: one for each position, or a single base for all
            positions; None for the present pose of the base.
        orientations: xyzw of the link at the targets, one for all or one for each; None for any orientation.
        collision_free: whether the robot, with its base at each pose, may not touch any object.
        ignoring: objects that the robot may touch, such as the object to grasp.

    Returns:
        The answers in order, each with evidence.

    Raises:
        BadArgument: The numbers of poses, orientations and bases don't match.
    """
    count = max(len(poses), len(bases or ()), len(orientations or ()))
    positions = _repeated("poses", [checks.vector("pose", pose) for pose in poses], count)
    turns: Sequence[Quaternion | None] = [None] * count
    if orientations is not None:
        turns = _repeated("orientations", [checks.quaternion("orientation", turn) for turn in orientations], count)
    stands: Sequence[Pose | None] = [None] * count
    if bases is not None:
        checked = [(checks.vector("base", position), checks.quaternion("base", turn)) for position, turn in bases]
        stands = _repeated("bases", checked, count)
    targets = list(zip(positions, turns, stands, strict=True))
    solver = Solver(robot, gripper_name)
    verdicts: list[Verdict] = []
    with _checker(robot, solver, ignoring if collision_free else None, all_links=bases is not None) as checker:
        for target, exact in zip(targets, solver.closed_form(targets), strict=True):
            postures = exact or solver.search([target], thorough=collision_free, threshold=threshold)[0]
            oriented = None if orientations is None else gripper_name
            verdicts.append(_judge(postures, threshold, checker, oriented, target[2]))
    return Found(
        verdicts,
        {"reached": sum(verdicts), "distances": [verdict.evidence["distance"] for verdict in verdicts]},
        considered=_summed_up(verdicts),
    )


def _summed_up(verdicts: Sequence[Verdict]) -> Choice:
    """Return a choice of the first target that the robot reaches, with the reasons why other targets aren't reached."""
    considered = considering()
    for number, verdict in enumerate(verdicts, 1):
        reasons = verdict.considered.reasons() if verdict.considered is not None else []
        if reasons and not verdict:
            considered.reject(f"target {number}", min(reasons, key=lambda reason: reason.miss()))
    first = next((number for number, verdict in enumerate(verdicts, 1) if verdict), None)
    if first is not None:
        considered.take(f"target {first}")
    return considered


def _repeated(name: str, given: Sequence[T], count: int) -> Sequence[T]:
    if len(given) not in {1, count}:
        raise BadArgument(name, len(given), f"a single value, or {count} values")
    return given if len(given) == count else [given[0]] * count


def _checker(
    robot: Object, solver: Solver, ignored: Sequence[Object] | None, *, all_links: bool = False
) -> AbstractContextManager[CollisionChecker | None]:
    """Return a collision checker; None if the robot may touch all objects."""
    return nullcontext() if ignored is None else CollisionChecker(robot, solver.joints, ignored, all_links=all_links)


def _reach(
    robot: Object,
    link: str,
    position: Sequence[float],
    orientation: Sequence[float] | None,
    threshold: float,
    ignored: Sequence[Object] | None,
) -> Verdict:
    """Return whether a robot reaches a target. It may touch the ``ignored`` objects, or all objects if None."""
    solver = Solver(robot, link)
    (postures,) = solver.search([(position, orientation, None)], thorough=ignored is not None, threshold=threshold)
    with _checker(robot, solver, ignored) as checker:
        return _judge(postures, threshold, checker, None if orientation is None else link)


def _judge(
    found: Sequence[Posture],
    threshold: float,
    checker: CollisionChecker | None,
    oriented: str | None,
    base: Pose | None = None,
) -> Verdict:
    """Return whether a posture reaches the target, within ``threshold`` m and without a collision.

    If the first posture misses the target, all postures miss it. If ``checker`` is None, the robot may touch anything.
    The link ``oriented`` has the same orientation in all postures; None without such a link. The evidence has the good
    posture, or the first bad posture with its collisions.
    """
    postures = [posture for posture in found if posture.reaches(threshold)]
    evidence = (postures or found)[0].evidence()
    considered = considering()
    if not postures:
        considered.reject("the nearest posture", OutOfReach(found[0].position_error, found[0].turn_error))
    if checker is None or not postures:
        return Verdict(postures, evidence, considered=considered if not postures else None)
    constant = checker.constant_links(oriented)
    candidates = checker.predict([posture.positions for posture in postures], base)
    for number, (posture, candidate) in enumerate(zip(postures, candidates, strict=True), 1):
        touched, own = checker.touched(candidate), checker.self_collisions(candidate)
        if not touched and not own:
            considered.take(f"posture {number}")
            return Verdict(True, posture.evidence() | {"obstacles": {}}, considered=considered)
        considered.reject(f"posture {number}", Touching([*(info["pair"] for info in touched.values()), *own]))
        obstacles: dict[str, object] = {body.name: info for body, info in touched.items()}
        if own:
            obstacles[checker.robot.name] = {
                "links": [pair.link for pair in own],
                "by": [pair.body_link for pair in own],
                "pair": own[0],
            }
        evidence.setdefault("obstacles", obstacles)
        if any(not constant.isdisjoint(info["links"]) for info in touched.values()):
            break  # all other postures would have the same collision
    return Verdict(False, evidence, considered=considered)


@query
def blocking(
    object: Object, robot: Object, gripper_name: str, world: BulletWorld | None = None, *, grasp: str | None = None
) -> Found[Object]:
    """Return the objects that a robot would touch if it reached for an object (thesis 4.4.6).

    A plan would choose the posture with the least contact, so this posture is checked.

    Args:
        gripper_name: the link, usually a tool frame.
        grasp: "front", "top", "left" or "right"; None for the side with the least contact.

    Returns:
        The touched objects, deepest first, except the target, held objects, and the floor below the robot. Furniture
        has the type "environment". If the robot can't reach the object, the list is empty, and the evidence says so.

    Raises:
        UnknownName: There is no such grasp, or the robot has no such link.
    """
    if grasp is not None:
        grasp_orientation(grasp, robot)  # raises UnknownName
    considered = considering()
    plan = choice.best_grasp(object, robot, gripper_name, None if grasp is None else (grasp,), choice=considered)
    if plan.grasp is not None:
        considered.take(str(plan.grasp))
    return Found(plan.obstacles, plan.evidence(), considered=considered)
