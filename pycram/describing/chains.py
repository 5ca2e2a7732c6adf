"""Kinematic chains of a URDF. Joints and names show which chains are arms, a torso, a head or a camera."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder import geometry

if TYPE_CHECKING:
    from recorder.urdf import Urdf, UrdfJoint

ARM: Final = 4  # minimum number of successive joints of an arm
_SEVERAL: Final = 2  # minimum number of fingers on a wrist
_TURNS_ALL: Final = math.pi  # range of a joint in rad: wrists have a larger range, and jaws a smaller range
_HEAD: Final = re.compile(r"head|neck", re.IGNORECASE)
_LEG: Final = re.compile(r"leg|hip|knee|ankle|foot|haa|hfe|kfe", re.IGNORECASE)
_WHEEL: Final = re.compile(r"wheel|caster|rotor", re.IGNORECASE)
_FINGER: Final = re.compile(r"finger|jaw|gripper|thumb|grasp", re.IGNORECASE)
_FINGER_LINK: Final = re.compile(r"finger|jaw|thumb", re.IGNORECASE)  # a link named "gripper" may be moved by a wrist
_OPTICAL: Final = re.compile(r"optical", re.IGNORECASE)
_CAMERA: Final = re.compile(r"camera|kinect|realsense|stereo|rgb", re.IGNORECASE)
_NO_PICTURE: Final = re.compile(r"depth|infra|laser|gazebo|screw|narrow|_ir_|forearm|hand|wrist|gripper", re.IGNORECASE)
_NO_NAME: Final = re.compile(r"[^A-Za-z0-9]+")
_UPRIGHT: Final = 0.9  # minimum |z| of a vertical axis
_FREE: Final = re.compile(r"(.+)_(x|y|z|yaw|pitch|roll)")  # replaced planar and floating joints (canonical_urdf.py)


@dataclass(frozen=True, slots=True)
class ArmChain:
    """An arm in a URDF."""

    name: str
    joints: tuple[UrdfJoint, ...]  # joints from the shoulder to the wrist
    fingers: tuple[UrdfJoint, ...]  # joints below the last link of the arm


class JointTree:
    """The tree of a robot's movable joints."""

    def __init__(self, urdf: Urdf) -> None:
        self.urdf = urdf
        self._next: dict[str, list[UrdfJoint]] = {"": []}
        self._above: dict[str, UrdfJoint | None] = {}  # the nearest movable joint above each joint
        for link in urdf.links[1:]:  # parents come before their children
            joint = urdf.parent_joint(link)
            if joint is None or not self._moves(joint):
                continue
            above = self.moved_by(joint.parent)
            self._above[joint.name] = above
            self._next[joint.name] = []
            if not _WHEEL.search(joint.name):
                self._next[above.name if above else ""].append(joint)

    def _moves(self, joint: UrdfJoint) -> bool:
        """Return whether a joint moves parts of the robot relative to each other."""
        return joint.movable and not self._is_free(joint)

    def _is_free(self, joint: UrdfJoint) -> bool:
        part = _FREE.fullmatch(joint.name)
        return part is not None and all(f"{part[1]}_{axis}_link" in self.urdf.links for axis in "xy")

    def moved_by(self, link: str) -> UrdfJoint | None:
        """Return the nearest joint that moves a link; None if there is none."""
        joint = self.urdf.parent_joint(link)
        while joint is not None and not self._moves(joint):
            joint = self.urdf.parent_joint(joint.parent)
        return joint

    def within(self, arm: ArmChain, joint: UrdfJoint) -> list[UrdfJoint]:
        """Return the joints of an arm's hand from the palm to a joint of a finger."""
        hand, found = {each.name for each in arm.fingers}, [joint]
        while (above := self._above[found[0].name]) is not None and above.name in hand:
            found.insert(0, above)
        return found

    def below(self, joint: UrdfJoint) -> list[UrdfJoint]:
        """Return all movable joints below a joint."""
        found = []
        for child in self._next[joint.name]:
            found += [child, *self.below(child)]
        return found

    def arms(self) -> list[ArmChain]:
        """Return the arms: chains of successive joints that end freely or at a gripper, and aren't legs."""
        found = []
        pending = list(self._next[""])
        leading = {mimic.leader for mimic in self.urdf.mimics.values()}
        while pending:
            run = [pending.pop(0)]
            while len(self._next[run[-1].name]) == 1 and not self._begins_hand(run[-1], leading):
                run.append(self._next[run[-1].name][0])
            last = run[-1]
            below = self.below(last)
            text = " ".join(joint.name for joint in run)
            has_more_than_hand = any(_LEG.search(joint.name) or _WHEEL.search(joint.name) for joint in below)
            if len(run) >= ARM and not _LEG.search(text) and not _HEAD.search(text) and not has_more_than_hand:
                found.append((run, below))
            else:
                pending += self._next[last.name]
        names = _short_names([[joint.name for joint in run] for run, _ in found], self.urdf.name)
        return [ArmChain(name, tuple(run), tuple(below)) for name, (run, below) in zip(names, found, strict=True)]

    def _begins_hand(self, joint: UrdfJoint, leading: set[str]) -> bool:
        """Return whether the next joint belongs to a finger.

        A joint that is named like a finger belongs to a wrist if several fingers are below it, or if it turns farther
        than jaws do.
        """
        (after,) = self._next[joint.name]
        lower, upper = limits(after)
        wrist = len(self._next[after.name]) >= _SEVERAL or upper - lower > _TURNS_ALL
        named = _FINGER_LINK.search(after.child) or (not wrist and _FINGER.search(after.name))
        return after.name in leading or after.name in self.urdf.mimics or bool(named)

    def _upright(self, joint: UrdfJoint) -> bool:
        _, turn = self.urdf.forward_kinematics({}, joint.child)
        return abs(geometry.rotate(turn, joint.axis)[2]) > _UPRIGHT

    def gripper_links(self, arm: ArmChain | None, arms: Sequence[ArmChain]) -> list[str]:
        """Return links at the end of an arm that are named like grippers or fingers, and aren't the arm's last link.

        If ``arm`` is None, return such links at the end of no arm. ``arms`` are all arms of the robot.
        """
        of_arms = {joint.name: each for each in arms for joint in each.joints}
        found = []
        for link in filter(_FINGER.search, self.urdf.links[1:]):
            joint = self.moved_by(link)
            ends = joint is not None and joint.child == link and joint.name in of_arms
            while joint is not None and joint.name not in of_arms:
                joint = self._above[joint.name]
            carrier = of_arms[joint.name] if joint is not None and joint == of_arms[joint.name].joints[-1] else None
            if carrier is arm and not ends:
                found.append(link)
        return found

    def torso(self, arms: list[ArmChain]) -> UrdfJoint | None:
        """Return the joint that lifts the arms; None if there is none."""
        for arm in arms:
            joint = self._above[arm.joints[0].name]
            while joint is not None:
                if joint.type == "prismatic" and self._upright(joint):
                    return joint
                joint = self._above[joint.name]
        return None

    def camera(self) -> str:
        """Return the link of a camera, preferably the link of an optical frame; "" without a camera."""
        links = [link for link in self.urdf.links if _CAMERA.search(link) and not _NO_PICTURE.search(link)]
        links = links or [link for link in self.urdf.links if _OPTICAL.search(link) and not _NO_PICTURE.search(link)]
        return min(links, key=lambda link: (not _OPTICAL.search(link), links.index(link)), default="")

    def head(self, camera: str, arms: list[ArmChain]) -> dict[str, str]:
        """Return the names of the joints that turn a camera, by "pan" and "tilt"."""
        of_arms = {joint.name for arm in arms for joint in (*arm.joints, *arm.fingers)}
        found: dict[str, str] = {}
        joint = self.moved_by(camera) if camera else None
        while joint is not None and joint.type != "prismatic" and joint.name not in of_arms and len(found) < 2:
            found.setdefault("pan" if self._upright(joint) else "tilt", joint.name)
            joint = self._above[joint.name]
        return found

    def drives(self) -> bool:
        """Return whether the base can drive: it has wheels, a "footprint" link, or a planar or floating joint."""
        joints = self.urdf.joints.values()
        return "footprint" in self.urdf.root or any(
            joint.movable and (_WHEEL.search(joint.name) or self._is_free(joint)) for joint in joints
        )


def _short_names(runs: list[list[str]], robot: str) -> list[str]:
    """Return names of arms: "left" or "right" if the names of the joints contain this side; else, "arm" with a number.

    A single arm has the robot's name, in letters, digits and hyphens, because TOML keys and slots contain this name.
    """
    if len(runs) == 1:
        return [_NO_NAME.sub("-", robot).strip("-") or "arm"]
    names = []
    for number, run in enumerate(runs, 1):
        text = "_".join(run)  # a name may contain the side as in "l_elbow_joint", "LElbowYaw" or "left_elbow"
        left, right = (
            bool(re.search(rf"(?:^|_){side}(?:_|$)|(?:^|_){side.upper()}(?=[A-Z])|(?i:{word})", text))
            for side, word in (("l", "left"), ("r", "right"))
        )
        names.append("left" if left and not right else "right" if right and not left else f"arm{number}")
    return names if len(set(names)) == len(names) else [f"arm{number}" for number in range(1, len(runs) + 1)]


def fingers_of(tree: JointTree, arm: ArmChain, with_shape: set[str]) -> Iterator[tuple[str, list[UrdfJoint]]]:
    """Yield each finger tip of an arm that has a shape, and the joints that move the tip.

    Links without a shape are frames below a finger tip, or sliders and screws of a motor above the tip.
    """
    for joint in arm.fingers:
        if joint.child not in with_shape or any(below.child in with_shape for below in tree.below(joint)):
            continue
        yield joint.child, [each for each in tree.within(arm, joint) if each.child in with_shape]


def limits(joint: UrdfJoint) -> tuple[float, float]:
    """Return the limits of a joint; without limits, -pi and pi."""
    return max(joint.lower, -math.pi), min(joint.upper, math.pi)
