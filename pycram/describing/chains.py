"""What of a URDF's tree is an arm, a gripper, a torso, a head or a camera: guesses by joints first, then by names."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.urdf import Joint, Urdf

ARM: Final = 4
"""Joints one after the other that make an arm."""
_SEVERAL: Final = 2  # fingers
_TURNS_ALL: Final = math.pi  # rad between its limits: more than any jaw's, a wrist's
_HEAD: Final = re.compile(r"head|neck", re.IGNORECASE)
_LEG: Final = re.compile(r"leg|hip|knee|ankle|foot|haa|hfe|kfe", re.IGNORECASE)
_WHEEL: Final = re.compile(r"wheel|caster|rotor", re.IGNORECASE)
_FINGER: Final = re.compile(r"finger|jaw|gripper|thumb|grasp", re.IGNORECASE)
_FINGER_LINK: Final = re.compile(r"finger|jaw|thumb", re.IGNORECASE)  # a gripper's link may hang on a wrist's joint
_OPTICAL: Final = re.compile(r"optical", re.IGNORECASE)
_CAMERA: Final = re.compile(r"camera|kinect|realsense|stereo|rgb", re.IGNORECASE)
_NO_PICTURE: Final = re.compile(r"depth|infra|laser|gazebo|screw|narrow|_ir_|forearm|hand|wrist|gripper", re.IGNORECASE)
_NO_NAME: Final = re.compile(r"[^A-Za-z0-9]+")
_UPRIGHT: Final = 0.9  # of an axis along the vertical
_FREE: Final = re.compile(r"(.+)_(x|y|z|yaw|pitch|roll)")  # a planar or floating joint's parts (models/canonical.py)


@dataclass(frozen=True, slots=True)
class ArmChain:
    """An arm in a URDF."""

    name: str  # what it is called
    joints: tuple[Joint, ...]  # its joints from the shoulder on
    fingers: tuple[Joint, ...]  # joints that hang on its last link


class Tree:
    """The movable joints of a robot, each with those that hang on it next.

    Args:
        urdf: of the robot.
    """

    def __init__(self, urdf: Urdf) -> None:
        self.urdf = urdf
        self._next: dict[str, list[Joint]] = {"": []}
        self._above: dict[str, Joint | None] = {}
        for link in urdf.links[1:]:  # parents come before their children
            joint = urdf.parent_joint(link)
            if joint is None or not self._moves(joint):
                continue
            above = self.moved_by(joint.parent)
            self._above[joint.name] = above
            self._next[joint.name] = []
            if not _WHEEL.search(joint.name):
                self._next[above.name if above else ""].append(joint)

    def _moves(self, joint: Joint) -> bool:
        """Whether a joint moves one part of a robot against another, and isn't of those by which all of it moves."""
        return joint.movable and not self._is_free(joint)

    def _is_free(self, joint: Joint) -> bool:
        part = _FREE.fullmatch(joint.name)
        return part is not None and all(f"{part[1]}_{axis}_link" in self.urdf.links for axis in "xy")

    def moved_by(self, link: str) -> Joint | None:
        """Return the joint that moves a link, the nearest; None if none does."""
        joint = self.urdf.parent_joint(link)
        while joint is not None and not self._moves(joint):
            joint = self.urdf.parent_joint(joint.parent)
        return joint

    def above(self, joint: Joint) -> Joint | None:
        """Return the next movable joint that one hangs on."""
        return self._above[joint.name]

    def below(self, joint: Joint) -> list[Joint]:
        """Return all movable joints that hang on one."""
        found = []
        for child in self._next[joint.name]:
            found += [child, *self.below(child)]
        return found

    def arms(self) -> list[ArmChain]:
        """Return the arms: joints one after the other that end at a gripper, or at nothing, and are no legs."""
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
            while run and run[0].type == "prismatic" and self._upright(run[0]):
                run.pop(0)  # a torso
            if len(run) >= ARM and not _LEG.search(text) and not _HEAD.search(text) and not _branches(below):
                found.append((run, below))
            else:
                pending += self._next[last.name]
        names = _short_names([[joint.name for joint in run] for run, _ in found], self.urdf.name)
        return [ArmChain(name, tuple(run), tuple(below)) for name, (run, below) in zip(names, found, strict=True)]

    def _begins_hand(self, joint: Joint, leading: set[str]) -> bool:
        """Whether the joint next to one is a finger's.

        A joint named so is a wrist's if several fingers hang on it, or if it turns farther than a jaw does.
        """
        (after,) = self._next[joint.name]
        lower, upper = limits(after)
        wrist = len(self._next[after.name]) >= _SEVERAL or upper - lower > _TURNS_ALL
        named = _FINGER_LINK.search(after.child) or (not wrist and _FINGER.search(after.name))
        return after.name in leading or after.name in self.urdf.mimics or bool(named)

    def _upright(self, joint: Joint) -> bool:
        _, turn = self.urdf.forward_kinematics({}, joint.child)
        return abs(geometry.rotate(turn, joint.axis)[2]) > _UPRIGHT

    def torso(self, arms: list[ArmChain]) -> Joint | None:
        """Return the joint that lifts the arms."""
        for arm in arms:
            joint = self._above[arm.joints[0].name]
            while joint is not None:
                if joint.type == "prismatic" and self._upright(joint):
                    return joint
                joint = self._above[joint.name]
        return None

    def camera(self) -> str:
        """Return the link with the camera's frame: an optical one if there is any; "" if there is none."""
        links = [link for link in self.urdf.links if _CAMERA.search(link) and not _NO_PICTURE.search(link)]
        links = links or [link for link in self.urdf.links if _OPTICAL.search(link) and not _NO_PICTURE.search(link)]
        return min(links, key=lambda link: (not _OPTICAL.search(link), links.index(link)), default="")

    def head(self, camera: str, arms: list[ArmChain]) -> dict[str, str]:
        """Return the joints that turn a camera: "pan" and "tilt", as far as there are any."""
        of_arms = {joint.name for arm in arms for joint in (*arm.joints, *arm.fingers)}
        found: dict[str, str] = {}
        joint = self.moved_by(camera) if camera else None
        while joint is not None and joint.type != "prismatic" and joint.name not in of_arms and len(found) < 2:
            found.setdefault("pan" if self._upright(joint) else "tilt", joint.name)
            joint = self._above[joint.name]
        return found

    def drives(self) -> bool:
        """Whether there are wheels, a footprint as bases have that drive, or a planar or floating joint."""
        joints = self.urdf.joints.values()
        return "footprint" in self.urdf.root or any(
            joint.movable and (_WHEEL.search(joint.name) or self._is_free(joint)) for joint in joints
        )


def _branches(below: list[Joint]) -> bool:
    """Whether what hangs on an arm is more than a hand."""
    return any(_LEG.search(joint.name) or _WHEEL.search(joint.name) for joint in below)


def _short_names(runs: list[list[str]], robot: str) -> list[str]:
    """Return names of arms: by side if their joints say it, the robot's for a single one.

    Names are keys of TOML and parts of slots (``NAME-arm``): letters, digits and hyphens.
    """
    if len(runs) == 1:
        return [_NO_NAME.sub("-", robot).strip("-") or "arm"]
    names = []
    for number, run in enumerate(runs, 1):
        text = "_".join(run)  # as "l_elbow_joint", "LElbowYaw" or "left_elbow"
        left, right = (
            bool(re.search(rf"(?:^|_){side}(?:_|$)|(?:^|_){side.upper()}(?=[A-Z])|(?i:{word})", text))
            for side, word in (("l", "left"), ("r", "right"))
        )
        names.append("left" if left and not right else "right" if right and not left else f"arm{number}")
    return names if len(set(names)) == len(names) else [f"arm{number}" for number in range(1, len(runs) + 1)]


def fingers_of(tree: Tree, arm: ArmChain, with_shape: set[str]) -> Iterator[tuple[str, list[Joint]]]:
    """Yield links of finger tips, the last of each branch of an arm's hand that have a shape, and what moves each."""
    hand = {joint.name for joint in arm.fingers}
    for joint in arm.fingers:
        if tree.below(joint) or joint.child not in with_shape:
            continue
        moving, above = [joint], tree.above(joint)
        while above is not None and above.name in hand:
            moving.insert(0, above)
            above = tree.above(above)
        yield joint.child, moving


def limits(joint: Joint) -> tuple[float, float]:
    """Return the limits of a joint, a turn about zero where there are none."""
    return max(joint.lower, -math.pi), min(joint.upper, math.pi)
