"""Checks of a robot's description in a world: reach, fingers, postures, the head, and stillness."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pycram.describing.chains import ArmChain, JointTree
from pycram.describing.grippers import Corners, guess_hand
from pycram.foundation.failures import PlanFailure
from pycram.models.robots.description import Arm, Gripper, RobotDescription
from pycram.motions.designator import MotionDesignator
from pycram.motions.modules.pick_up import PickUp
from pycram.reasoning.collision.checker import CollisionChecker
from pycram.reasoning.kinematics import pan_tilt
from pycram.reasoning.kinematics.forward import Chain
from pycram.reasoning.kinematics.inverse import Solver, halton_postures
from pycram.world.object import Object
from recorder import geometry
from recorder.geometry import Pose, Vector

OBJECTS: Final = ("cup", "bottle", "spoon")  # names of the objects that an arm picks up
_PLACES: Final = 5  # number of places on the table for each object
_SAMPLES: Final = 1000  # number of sampled postures; places on the table are below the tool in some postures
_TOP: Final = 0.72  # height in m of the table's top
_FRONT: Final = 0.3  # distance in m from the table's origin to its front edge
_INSET: Final = 0.1  # distance in m from the front edge to the objects
_BAND: Final = 0.25  # maximum height in m of the tool above the table
_LEVEL: Final = 0.3  # maximum z of the direction of the tool; a tool that points upwards takes nothing from a table
_LOW: Final = 25  # percentile of the tool's heights; if the robot doesn't drive, the table has this height
_CLEAR: Final = 1e-3  # distance in m between an object and the table, to avoid an overlap


def picked_up(robot: Object, arm: Arm, chain: Chain) -> Iterator[tuple[str, int, int, str]]:
    """Try to pick up each object from several places on a table.

    The robot stands before the table; if the robot doesn't drive, the table has the best height for the arm. For each
    object, the name, the number of places with success, the number of all places and the last failure are yielded.
    """
    world, parked = robot.world, robot.get_joint_positions()
    world.robot = robot
    assert robot.description is not None  # noqa: S101  the caller has loaded the robot with a description
    table = Object("table", "environment", "table.urdf", [0.0, 0.0, -10.0], world=world)
    places = list(_places(robot, arm, chain, table))
    for name in OBJECTS:
        taken, failure = 0, "no posture of the arm brings the tool over a table"
        for place, pose in places:
            table.set_position_and_orientation(*pose)
            body = Object(name, name, f"{name}.stl", world=world)
            body.set_position([place[0], place[1], pose[0][2] + _TOP - body.get_AABB()[0][2] + _CLEAR])
            try:
                PickUp().execute(MotionDesignator([("type", "pick-up"), ("object", body), ("arm", arm.name)]))
                taken += 1
            except PlanFailure as error:
                failure = str(error)
            body.remove()
            robot.set_joint_positions(parked)
        yield name, taken, len(places), failure
    table.remove()


def _places(robot: Object, arm: Arm, chain: Chain, table: Object) -> Iterator[tuple[Vector, Pose]]:
    """Yield places on a table before the robot, and a pose of the table without contact with the robot."""
    assert robot.description is not None  # noqa: S101  see above
    poses = chain.poses(chain.limited(halton_postures(chain, 0, _SAMPLES)))
    tools = geometry.pose_matrix(robot.get_link_position_and_orientation(arm.base_link)) @ poses
    base, found = robot.get_position(), 0
    if robot.description.drives:
        top = robot.get_AABB()[0][2] + _TOP
    else:
        top = max(base[2], float(np.percentile(tools[:, 2, 3], _LOW)))
    above = tools[:, 2, 3] - top
    for x, y, z in tools[(above > 0.0) & (above < _BAND) & (tools[:, 2, 0] < _LEVEL), :3, 3].tolist():
        yaw = math.atan2(y - base[1], x - base[0])
        away = _FRONT - _INSET
        position = x + away * math.cos(yaw), y + away * math.sin(yaw), top - _TOP
        pose: Pose = position, geometry.from_rpy(0.0, 0.0, yaw)
        table.set_position_and_orientation(*pose)
        if robot.world.engine.deepest(robot.handle, table.handle) is None:
            yield (x, y, z), pose
            found += 1
        if found == _PLACES:
            return


_POSES: Final = 40  # number of tool poses that the check of reach tries
_ENOUGH: Final = 0.9  # minimum share of the poses that an arm must reach
_CENTRED: Final = 0.003  # maximum distance in m from the tool frame to the middle between the fingers
_APERTURE: Final = 0.005  # tolerance in m for measures of fingers
_STILL_TIME: Final = 2.0  # duration in s of the simulation
_STILL: Final = 1e-3  # maximum motion in rad or m of a joint that counts as still
_TRIED: Final = 4000  # number of candidates for a parking posture
_CHECKED: Final = 300  # number of the best candidates that are checked for self-collisions
_SAMPLED: Final = 40  # number of sampled postures; links that overlap in all samples always overlap
_FLOOR: Final = 0.05  # minimum height in m of a parked arm above the root link
_NAMED: Final = 4  # maximum number of links that a finding names
_STRAIN: Final = 0.1  # penalty in m, added to the size of a posture at joint limits


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of a check."""

    passed: bool
    about: str  # the checked part of the robot
    text: str  # the measured values, for the user

    def __str__(self) -> str:
        return f"{'ok    ' if self.passed else 'FAILED'}  {self.about}: {self.text}"


def check(robot: Object, description: RobotDescription) -> Iterator[Finding]:
    """Check a robot that was loaded with a description, alone in a world above the ground; checks move the robot."""
    for arm in description.arms.values():
        yield _reach(robot, arm)
        if arm.hand is not None and arm.hand.fingers:
            yield from _fingers(robot, arm, arm.hand)
        yield from _postures(robot, arm)
        if arm.hand is not None:
            yield _grasps(robot, arm)
    yield from _missing_grippers(robot, description)
    if description.camera is not None:
        yield _head(robot, description)
    yield _stillness(robot)


def _reach(robot: Object, arm: Arm) -> Finding:
    """Check that inverse kinematics reaches tool poses that were computed from postures."""
    chain = chain_of(robot, arm)
    postures = chain.limited(halton_postures(chain, 0, _POSES))
    root = robot.get_link_position_and_orientation(arm.base_link)
    poses = []
    for matrix in chain.poses(postures):
        x, y, z = matrix[:3, 3].tolist()
        poses.append(geometry.multiply(root, ((x, y, z), geometry.from_matrix(matrix[:3, :3]))))
    found = Solver(robot, arm.tool_frame).search([(*pose, None) for pose in poses])
    reached = sum(postures[0].reaches() for postures in found)
    far = max(math.dist(position, root[0]) for position, _ in poses)
    return Finding(
        reached >= _ENOUGH * _POSES,
        f"{arm.name} arm, reach",
        f"the arm reaches {reached} of {_POSES} tool poses, up to {far:.2f} m from {arm.base_link}",
    )


def _grasps(robot: Object, arm: Arm) -> Finding:
    """Check that an arm picks up at least one household object from a table."""
    tried = list(picked_up(robot, arm, chain_of(robot, arm)))
    counts = ", ".join(f"{name} {taken} of {places}" for name, taken, places, _ in tried)
    taken = any(taken for _, taken, _, _ in tried)
    return Finding(taken, f"{arm.name} arm, picked up from a table", counts if taken else f"{counts}; {tried[0][3]}")


def _missing_grippers(robot: Object, description: RobotDescription) -> Iterator[Finding]:
    """Check that an arm has a gripper if links at its end are named like grippers or fingers."""
    tree = JointTree(robot.urdf)
    arms = {
        arm.name: ArmChain(
            arm.name, tuple(map(robot.urdf.joint, arm.joints)), tuple(tree.below(robot.urdf.joint(arm.joints[-1])))
        )
        for arm in description.arms.values()
    }
    chains = list(arms.values())
    for name, chain in arms.items():
        links = tree.gripper_links(chain, chains)
        if links and description.arms[name].hand is None:
            hand = guess_hand(tree, chain, Corners(robot.model))
            reason = f"pycram describe finds {f'no gripper: {hand}' if isinstance(hand, str) else 'a gripper'}"
            text = f"links {_some(links)} are named like a gripper, but the description has no gripper ({reason})"
            yield Finding(False, f"{name} arm", text)
    if links := tree.gripper_links(None, chains):
        yield Finding(False, "grippers", f"links {_some(links)} are named like a gripper, but no arm ends there")


def _some(links: Sequence[str]) -> str:
    return ", ".join(links[:_NAMED]) + (f" and {len(links) - _NAMED} more" if len(links) > _NAMED else "")


def _fingers(robot: Object, arm: Arm, gripper: Gripper) -> Iterator[Finding]:
    corners = Corners(robot.model)
    about = f"{arm.name} gripper"
    fingers = gripper.jaws(robot.urdf, arm.tool_frame, arm.tool_offset)
    opened, closed = (corners.jaws(fingers, gripper.at(share), arm.tool_frame, arm.tool_offset) for share in (1.0, 0.0))
    if opened is None or closed is None:
        yield Finding(False, about, "the fingers don't have shapes on both sides of the tool frame")
        return
    wide = arm.bias(robot.urdf) * (opened.gap - closed.gap) / 2  # y of the middle of open jaws that move unevenly
    middle = max(abs((jaws.left + jaws.right) / 2 - y) for jaws, y in ((opened, wide), (closed, 0.0)))
    text = f"the middle between the fingers is {1e3 * middle:.1f} mm from the tool frame"
    yield Finding(middle <= _CENTRED, about, text)
    for name, said, measured in (
        ("aperture", gripper.aperture, opened.gap),
        ("gap", gripper.gap, max(closed.gap, 0.0)),
        ("tips", gripper.tips, closed.tip),
    ):
        text = f"{name} is described as {1e3 * said:.1f} mm, measured {1e3 * measured:.1f} mm"
        yield Finding(abs(said - measured) <= _APERTURE, about, text)
    # the underside and the depth are wrong if the x axis of the tool frame points sideways
    about = f"{arm.name} gripper"
    links = (gripper.palm, *gripper.fingers)
    hand = np.vstack([corners.of(links, gripper.at(share), arm.tool_frame, arm.tool_offset) for share in (1.0, 0.0)])
    low = float(-hand[:, 2].min())
    text = f"underside is described as {1e3 * gripper.underside:.1f} mm, measured {1e3 * low:.1f} mm"
    yield Finding(low <= gripper.underside + _APERTURE, about, text)
    palm = corners.of([gripper.palm], gripper.at(0.0), arm.tool_frame, arm.tool_offset)
    if len(palm) and gripper.palm not in gripper.fingers:  # if only one jaw moves, the palm may be the fixed jaw
        room = max(-float(palm[:, 0].max()), 0.0)
        text = f"depth is described as {1e3 * gripper.depth:.1f} mm, measured {1e3 * room:.1f} mm"
        yield Finding(gripper.depth <= room + _APERTURE, about, text)


def _postures(robot: Object, arm: Arm) -> Iterator[Finding]:
    for name in arm.poses:
        with robot.world.lock, CollisionChecker(robot, arm.joints) as checker:
            (candidate,) = checker.predict([arm.posture(name)])
            pairs = checker.self_collisions(candidate)
        text = "; ".join(f"{pair.link} would penetrate {pair.body_link}" for pair in pairs)
        yield Finding(not pairs, f"{arm.name} arm, {name}", text or "the robot doesn't touch itself")


def _head(robot: Object, description: RobotDescription) -> Finding:
    """Check that the camera can be turned to a point in front of the robot."""
    camera = description.camera
    assert camera is not None  # noqa: S101  the caller has checked that the robot has a camera
    joints = description.head.joints if description.head else ()
    now = robot.get_joint_positions()
    frame = camera.pose(robot.urdf.forward_kinematics(now, camera.frame))
    point = frame[0][0] + 1.5, frame[0][1], max(frame[0][2] - 0.5, 0.0)
    _, (x, y, z) = pan_tilt.aim_camera(robot.urdf, joints, camera, point, now)
    angle = math.degrees(math.atan2(math.hypot(x, y), z))
    limit = math.degrees(min(camera.horizontal_fov, camera.vertical_fov)) / 2
    text = f"the camera looks {angle:.1f} degrees past a point 1.5 m in front of the camera and 0.5 m below"
    return Finding(angle <= (1.0 if len(joints) > 1 else limit), "camera", text)


def _stillness(robot: Object) -> Finding:
    """Check that no joint moves in two simulated seconds with parked arms and without a floor."""
    if robot.description is not None:
        for arm in robot.description.arms.values():
            robot.set_joint_positions(arm.posture("park") if "park" in arm.poses else {})
    robot.world.set_gravity([0, 0, -9.8])
    before = robot.get_joint_positions()
    robot.world.simulate(_STILL_TIME)
    now = robot.get_joint_positions()
    moved = {name: abs(now[name] - value) for name, value in before.items()}
    worst = max(moved, key=lambda name: moved[name], default="")
    text = f"no joint moves in {_STILL_TIME:g} s" if not moved else ""
    if worst:
        text = f"in {_STILL_TIME:g} s of simulation {worst} moves most, by {moved[worst]:.5f} rad or m"
    finite = all(np.isfinite(value) for value in moved.values())
    return Finding(finite and (not worst or moved[worst] < _STILL), "stillness", text)


def chain_of(robot: Object, arm: Arm) -> Chain:
    """Return the kinematics of an arm for the robot's present joint positions."""
    return Chain(robot.urdf, arm.base_link, arm.tool_frame, arm.joints, robot.get_joint_positions(), arm.tool_offset)


def always_touching(robot: Object, arm: Arm) -> set[tuple[str, str]]:
    """Return pairs of links that overlap in all sampled postures of an arm, because their shapes are too large."""
    chain = chain_of(robot, arm)
    postures = [dict(zip(arm.joints, row, strict=True)) for row in halton_postures(chain, 0, _SAMPLED).tolist()]
    with CollisionChecker(robot, arm.joints) as checker:
        found = [
            {(pair.link, pair.body_link) for pair in checker.self_collisions(candidate)}
            for candidate in checker.predict(postures)
        ]
    return set.intersection(*found) if found else set()


def parked(robot: Object, arm: Arm) -> list[float]:
    """Return a compact posture of an arm in which the robot doesn't touch itself; other arms don't move."""
    chain = chain_of(robot, arm)
    postures = chain.limited(halton_postures(chain, 0, _TRIED))
    root = geometry.pose_matrix(robot.urdf.forward_kinematics(robot.get_joint_positions(), arm.base_link))
    points = (root @ np.concatenate([chain.frames(postures), chain.poses(postures)[None]]))[:, :, :3, 3]
    size = np.hypot(points[:, :, 0], points[:, :, 1]).max(axis=0)
    low = np.maximum(_FLOOR - points[:, :, 2].min(axis=0), 0.0)
    middle = np.abs((postures - chain.lower) / (chain.upper - chain.lower) - 0.5).max(axis=1)
    rows = postures[np.argsort(size + 10 * low + _STRAIN * 2 * middle, kind="stable")[:_CHECKED]].round(3).tolist()
    with CollisionChecker(robot, arm.joints) as checker:
        named = [dict(zip(arm.joints, row, strict=True)) for row in rows]
        for row, candidate in zip(rows, checker.predict(named), strict=True):
            if not checker.self_collisions(candidate):
                return list(map(float, row))
    return list(map(float, chain.limited(np.zeros((1, len(arm.joints))))[0].round(3)))
