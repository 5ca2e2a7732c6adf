"""Guesses of grippers from collision shapes: the positions of the fingers in the tool frame."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.describing.chains import ArmChain, JointTree, fingers_of, limits
from pycram.models.robots.description import Gripper
from pycram.models.shapes import pieces_of
from recorder import geometry
from recorder.geometry import IDENTITY, Array, Pose, Quaternion
from recorder.urdf import UrdfJoint

if TYPE_CHECKING:
    from pycram.models.load import Model


TIPS: Final = 0.015  # distance in m from the tool frame to the finger tips
_PADS: Final = 0.02  # length in m of the pads on the fingers, measured from the tips
_NEAR_TIP: Final = 0.02  # maximum distance in m between finger tips and a link that counts as grasping
_MAX_DEPTH: Final = 0.03  # m
_CUP_RIM: Final = 0.003  # length in m of a suction cup, which keeps the end of the arm away from a released object
_PALM_CLEARANCE: Final = 0.003  # minimum distance in m between a grasped object and the palm
_PADDING: Final = 1e-3  # thickness in m of the padding that the engine adds around shapes
_STRAIGHT: Final = math.cos(math.radians(10))  # minimum component of a direction that becomes an axis of the link
_SIDES: Final = 2
_PHALANGES: Final = 2  # a finger with more joints can curl
_SHARES: Final = (1.0, 0.7, 0.5, 0.35, 0.25)  # candidates for open fingers, as shares of the ranges of the joints


@dataclass(frozen=True, slots=True)
class Jaws:
    """Positions in m of fingers on two sides, in a frame whose x axis points out of the hand; fingers close along y."""

    left: float  # y of the inner faces on the +y side
    right: float  # y of the inner faces on the -y side
    tip: float  # x of the farthest finger tip
    low: float  # lowest z of the fingers
    high: float  # highest z of the fingers

    @property
    def gap(self) -> float:
        """Distance in m between the two sides."""
        return self.left - self.right


class Corners:
    """Corners of a model's collision shapes, for each link."""

    def __init__(self, model: Model) -> None:
        self._urdf = model.urdf
        parts: dict[str, list[Array]] = {}
        for link, corners in pieces_of(model.path):
            parts.setdefault(link, []).append(corners)
        self._corners = {link: np.vstack(pieces) for link, pieces in parts.items()}

    def __contains__(self, link: object) -> bool:
        return link in self._corners

    def of(self, links: Iterable[str], positions: Mapping[str, float], base: str, offset: Pose) -> Array:
        """Return the corners (n, 3) of links in a frame; a link without shapes has no corners.

        Joints without a position (rad or m) are at 0. The frame has a pose ``offset`` in the link ``base``.
        """
        frame = geometry.invert(geometry.multiply(self._urdf.forward_kinematics(positions, base), offset))
        found = [np.zeros((0, 3))]
        for link in links:
            if link in self._corners:
                pose = geometry.multiply(frame, self._urdf.forward_kinematics(positions, link))
                found.append(self._corners[link] @ geometry.to_matrix(pose[1]).T + np.array(pose[0]))
        return np.vstack(found)

    def jaws(self, fingers: Iterable[str], positions: Mapping[str, float], base: str, offset: Pose) -> Jaws | None:
        """Return the positions of fingers in a frame; None without fingers on two sides. Arguments: see :meth:`of`."""
        found = [corners for finger in fingers if len(corners := self.of([finger], positions, base, offset))]
        tips = [corners[corners[:, 0] >= corners[:, 0].max() - _PADS] for corners in found]
        for seen in (found, tips):  # only the tip of a fixed jaw on the palm is on one side
            sides: tuple[list[Array], list[Array]] = ([], [])
            for corners, part in zip(found, seen, strict=True):
                sides[float(part[:, 1].mean()) < 0.0].append(corners)
            if all(sides):
                break
        else:
            return None
        left, right = (np.vstack(side) for side in sides)
        every = np.vstack([left, right])
        tip = float(every[:, 0].max())
        inner, other = (side[side[:, 0] >= tip - _PADS, 1] for side in (left, right))
        if not len(inner) or not len(other):
            return None
        low, high = float(every[:, 2].min()), float(every[:, 2].max())
        return Jaws(float(inner.min()), float(other.max()), tip, low, high)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandGuess(Gripper):
    """A gripper that was guessed from its shapes."""

    offset: Pose  # pose of the tool frame in the palm


@dataclass(frozen=True, slots=True)
class SuctionGuess:
    """A suction cup for an arm without a gripper in its URDF; the cup's rim is just beyond the last link."""

    offset: Pose  # pose of the tool frame in the last link; x points away from the arm, along the last joint's axis
    underside: float  # distance in m from the tool frame down to the lowest point of the last link


def suction_cup(tree: JointTree, arm: ArmChain, corners: Corners) -> SuctionGuess:
    """Return a suction cup for the end of an arm."""
    last = arm.joints[-1]
    links = [link for link in tree.urdf.links if link in corners and tree.moved_by(link) is last]
    points = corners.of(links, {}, last.child, IDENTITY)
    axis = np.array(last.axis)
    along = points @ axis
    ends = float(along.min(initial=0.0)), float(along.max(initial=0.0))
    out, far = (-axis, -ends[0]) if -ends[0] > ends[1] else (axis, ends[1])
    across = np.array([0.0, 0.0, 1.0]) if abs(out[2]) < _STRAIGHT else np.array([0.0, 1.0, 0.0])
    turn = _frame(out, np.cross(across, out))
    assert turn is not None  # noqa: S101  both directions have length 1, and they aren't parallel
    around = np.linalg.norm(points - along[:, None] * axis, axis=1)
    return SuctionGuess((tuple((out * (far + _CUP_RIM)).tolist()), turn), float(around.max(initial=0.0)))


def guess_hand(tree: JointTree, arm: ArmChain, corners: Corners) -> HandGuess | str:
    """Return the gripper of an arm, or a text: why no gripper that closes from two sides was found."""
    if not arm.fingers:
        return "no movable joint follows the arm's last link"
    ends = [joint for joint in arm.fingers if not tree.below(joint) and joint.type != "continuous"]  # without screws
    tips = list(fingers_of(tree, arm, {link for link in tree.urdf.links if link in corners}))
    if any(len(moving) > _PHALANGES for _, moving in tips):
        return f"{len(arm.fingers)} joints follow the arm's last link, in fingers that curl"
    if len(tips) < max(min(len(ends), _SIDES), 1):
        solid = {link for link, _ in tips}
        names = [joint.child for joint in ends or arm.fingers if joint.child not in solid]
        return f"{', '.join(names)} {'has' if len(names) == 1 else 'have'} no collision shapes that could hold objects"
    stuck = [joint.name for _, moving in tips for joint in moving if joint.lower == joint.upper]
    palm = tree.within(arm, tips[0][1][0])[0].parent
    if len(tips) < _SIDES:
        ((jaw, (joint, *others)),) = tips
        hand = None if others else _one_jaw(tree, corners, palm, jaw, joint)
        reason = f"by its collision shapes, {jaw} doesn't close against a fixed link"
    else:
        hand = _fingers(tree, palm, tips, corners)
        names = [link for link, _ in tips]
        reason = f"by their collision shapes, {', '.join(names)} don't close on one another from two sides"
    if stuck:
        limits_of = ", ".join(
            f"{name} from {tree.urdf.joints[name].lower:g} to {tree.urdf.joints[name].upper:g}" for name in stuck
        )
        reason = f"the limits in the URDF don't let the fingers move ({limits_of})"
    return hand or reason


def _fingers(
    tree: JointTree, palm: str, tips: Sequence[tuple[str, list[UrdfJoint]]], corners: Corners
) -> HandGuess | None:
    """Return a gripper with two or more moving fingers; None if they don't close from two sides."""
    links = [link for link, _ in tips]
    closed, widest = _ends(tree, corners, palm, tips)
    there = [corners.of([link], closed, palm, IDENTITY).mean(axis=0) for link in links]
    for opened in _openings(closed, widest):
        here = [corners.of([link], opened, palm, IDENTITY).mean(axis=0) for link in links]
        ways = [b - a for a, b in zip(there, here, strict=True)]
        apart = np.sum([way if way @ ways[0] >= 0 else -way for way in ways], axis=0)
        out = np.mean([*there, *here], axis=0)
        body = corners.of([palm], {}, palm, IDENTITY)
        out -= body.mean(axis=0) if len(body) else 0.0
        axes = _frame(out, apart)
        if axes is None:
            return None
        hand = _fitted(tree, corners, palm, (np.mean(there, axis=0), axes), links, (closed, opened))
        if hand is not None:
            return hand
    return None


def _openings(closed: Mapping[str, float], widest: Mapping[str, float]) -> Iterator[Mapping[str, float]]:
    """Yield candidates for open positions, from wide to narrow: wide open fingers may not close along a line."""
    for share in _SHARES:
        yield {name: value + share * (widest[name] - value) for name, value in closed.items()}


def _one_jaw(tree: JointTree, corners: Corners, palm: str, jaw: str, joint: UrdfJoint) -> HandGuess | None:
    """Return a gripper with one moving and one fixed jaw; None if the jaw doesn't close against a link."""
    still = [link for link in tree.urdf.links if link in corners and tree.moved_by(link) is tree.moved_by(palm)]
    if not still:
        return None
    hinge, axis = np.array(joint.origin[0]), np.array(geometry.rotate(joint.origin[1], joint.axis))
    others = {link: corners.of([link], {}, palm, IDENTITY) for link in still}
    ends = []
    for value in limits(joint):
        points = corners.of([jaw], {joint.name: value}, palm, IDENTITY)
        tip = points[np.linalg.norm(points - hinge, axis=1).argmax()]
        gaps = {link: np.linalg.norm(other - tip, axis=1).min() for link, other in others.items()}
        ends.append((min(gaps.values()), value, tip, min(gaps, key=gaps.__getitem__)))
    (_, closed, tip, anvil), (_, opened, *_) = sorted(ends, key=lambda end: end[0])
    if joint.type == "prismatic":
        out, apart = tip - np.vstack(list(others.values())).mean(axis=0), axis
    else:
        out, apart = tip - hinge, np.cross(axis, tip - hinge)
    axes = _frame(out, apart)
    if axes is None:
        return None
    frame = (tip + others[anvil][np.linalg.norm(others[anvil] - tip, axis=1).argmin()]) / 2, axes
    shut = {joint.name: closed}
    hands = (
        _fitted(tree, corners, palm, frame, [jaw, anvil], (shut, opening))
        for opening in _openings(shut, {joint.name: opened})
    )
    return next((hand for hand in hands if hand is not None), None)


def _fitted(
    tree: JointTree,
    corners: Corners,
    palm: str,
    between: tuple[Array, Quaternion],
    links: Sequence[str],
    ends: tuple[Mapping[str, float], Mapping[str, float]],
) -> HandGuess | None:
    """Return the gripper whose fingers close around a pose in the palm; None if no fingers close there."""
    (x, y, z), axes = between
    frame: Pose = ((float(x), float(y), float(z)), axes)
    shut, wide = (corners.jaws(links, positions, palm, frame) for positions in ends)
    if shut is None or wide is None or wide.gap <= max(shut.gap, 0.0):
        return None
    closed, opened = ends
    middle = (shut.tip - TIPS, (shut.left + shut.right) / 2, (shut.low + shut.high) / 2)
    offset = geometry.transform(frame, middle), frame[1]
    taking = [link for link in links if corners.of([link], closed, palm, offset)[:, 0].max() > TIPS - _NEAR_TIP]
    body = corners.of([palm], closed, palm, offset)
    front = float(body[:, 0].max(initial=-_MAX_DEPTH))
    every = np.vstack([body, corners.of(links, closed, palm, offset), corners.of(links, opened, palm, offset)])
    hand = HandGuess(
        palm=palm,
        offset=offset,
        fingers=tuple(taking),
        joints=tuple(closed),
        closed=tuple(closed.values()),
        open=tuple(opened.values()),
        tips=TIPS,
        aperture=max(wide.gap - 2 * _PADDING, 1e-3),
        gap=max(shut.gap - _PADDING, 0.0),  # the engine's padding reduces the gap
        depth=min(max(-front - _PALM_CLEARANCE, 0.0), _MAX_DEPTH),
        underside=float(-every[:, 2].min()) + 2 * _PADDING,
    )
    return hand if hand.fingers and not any(hand.wrong_ways(tree.urdf, palm, hand.offset)) else None


def _ends(
    tree: JointTree, corners: Corners, palm: str, tips: Sequence[tuple[str, list[UrdfJoint]]]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the joint positions when closed and when open: a finger is open when it is far from the other fingers."""
    joints = {joint.name: joint for _, moving in tips for joint in moving}
    middles = {name: sum(limits(joint)) / 2 for name, joint in joints.items()}
    closed: dict[str, float] = {}
    opened: dict[str, float] = {}
    for link, moving in tips:
        others = np.vstack([corners.of([other], middles, palm, IDENTITY) for other, _ in tips if other != link])
        ends = [{joint.name: limits(joint)[end] for joint in moving} for end in (0, 1)]
        away = [
            np.linalg.norm(corners.of([link], {**middles, **end}, palm, IDENTITY).mean(axis=0) - others.mean(axis=0))
            for end in ends
        ]
        near, far = ends if away[0] < away[1] else ends[::-1]
        for chosen, end in ((closed, near), (opened, far)):
            for name, value in end.items():
                chosen.setdefault(name, value)
    for values in (closed, opened):
        for name, joint in joints.items():
            mimic = tree.urdf.mimics.get(name)
            if mimic is not None and mimic.leader in values:
                low, high = limits(joint)
                values[name] = min(max(mimic.multiplier * values[mimic.leader] + mimic.offset, low), high)
    return closed, opened


def _frame(out: Array, apart: Array) -> Quaternion | None:
    """Return the orientation of a frame with x along ``out`` and y along ``apart``; None if either is too short."""
    if np.linalg.norm(apart) < _PADDING:
        return None
    y = _straightened(apart / np.linalg.norm(apart))
    out = out - (out @ y) * y
    if np.linalg.norm(out) < _PADDING:
        return None
    x = _straightened(out / np.linalg.norm(out))
    y -= (x @ y) * x
    y /= np.linalg.norm(y)
    return geometry.from_matrix(np.column_stack([x, y, np.cross(x, y)]))


def _straightened(axis: Array) -> Array:
    """Return the link's axis to which a unit vector is nearly parallel, else the vector."""
    largest = int(np.abs(axis).argmax())
    if abs(axis[largest]) < _STRAIGHT:
        return axis
    straight = np.zeros(3)
    straight[largest] = math.copysign(1.0, axis[largest])
    return straight
