"""Failures of worlds and motions (out of reach, not seen, in collision), and all usage errors.

:mod:`pycram.foundation.errors` describes how to write a failure. Lengths are in m and angles in rad. Positions xyz are
in the world frame, and orientations are quaternions xyzw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass
from typing import Any, Final

from pycram.foundation import errors
from pycram.foundation.errors import *  # noqa: F403  the module errors.py lists its exports
from pycram.foundation.errors import PlanFailure, dataclass_error, export, floats, kept_as
from recorder.geometry import PoseLike
from recorder.records.text import pair_text

__all__ = [
    "AccessFailed",
    "Blocked",
    "CollisionPair",
    "Displaced",
    "DoesNotFit",
    "GraspFailed",
    "GripperBlocked",
    "HandleBlocked",
    "HandleUnreachable",
    "InCollision",
    "LookingFailed",
    "MissingPart",
    "NoPath",
    "NoPlace",
    "NotDrivable",
    "PerceptionError",
    "PlaceFailed",
    "PostureInCollision",
    "PropertyViolated",
    "ReasoningError",
    "TrackingLost",
    "TrajectoryEnded",
    "Unreachable",
]
__all__ += errors.__all__

_MAX_DIGITS: Final = 3  # maximum number of decimal places of millimetres in messages
_MAX_LISTED: Final = 3  # maximum number of collision pairs in a message


@dataclass(frozen=True, slots=True)
class CollisionPair:
    """Two links that touch: a link of a robot or of an object that it holds, and a link of any object."""

    mover: str  # name of the object that moves: the robot, or an object that it holds
    link: str  # link of the mover; "" if the mover has only one link
    body: str  # name of the touched object, which may be the robot itself
    body_link: str  # touched link; "" if the object has only one link
    depth: float = 0.0  # depth of the overlap, m
    gripper: str = ""  # name of the arm whose gripper holds the mover; "" if the mover is the robot

    def __record__(self) -> Mapping[str, object]:
        """Return the names and values of the fields, for records."""
        return asdict(self)

    def __str__(self) -> str:
        return pair_text(asdict(self))


def phrases(pairs: Sequence[CollisionPair]) -> str:
    """Return the first three collision pairs as text, and the number of the other pairs."""
    listed = ", ".join(map(str, pairs[:_MAX_LISTED]))
    return f"{listed}, and {len(pairs) - _MAX_LISTED} more" if len(pairs) > _MAX_LISTED else listed


def _bodies(pairs: Sequence[CollisionPair]) -> list[str]:
    return list(dict.fromkeys(pair.body for pair in pairs))


def _point(coordinates: Sequence[float]) -> str:
    return f"[{', '.join(f'{x:.3f}' for x in coordinates)}]"


class ReasoningError(PlanFailure):
    """A condition of a plan doesn't hold (thesis, Listing 5.5)."""


class PerceptionError(PlanFailure):
    """No object of the requested type is seen or known (thesis 5.1)."""

    def __init__(self, object_type: str = "", reasons: Mapping[str, str] | None = None) -> None:
        self.object_type = object_type
        self.reasons = dict(reasons or {})  # why each object of that type isn't seen, by the object's name
        why = "; ".join(f"{name} {reason}" for name, reason in self.reasons.items())
        super().__init__(f"no {object_type or 'object'} found: {why or 'the world has none'}")


@dataclass_error
class Unreachable(PlanFailure):
    """No posture of the arm brings the tool to the target; see :class:`Blocked` for an obstacle."""

    arm: str  # name of the arm, or of the tool frame
    target: Sequence[float] = kept_as(floats)
    distance: float | None = None  # distance in m from the target to the tool in the nearest posture; None: unknown
    reason: str = ""  # the cause, if it isn't the distance

    def _message(self) -> str:
        near = f"; the nearest posture found stays {self.distance:.3f} m away" if self.distance is not None else ""
        reason = f"; {self.reason}" if self.reason else ""
        return f"{self.arm} arm can't reach {_point(self.target)}{near}{reason}"


class Blocked(Unreachable):
    """The arm reaches the target, but an obstacle is in the way."""

    def __init__(self, arm: str, target: Sequence[float], pairs: Sequence[CollisionPair], reason: str = "") -> None:
        super().__init__(arm, target, None, f"{phrases(pairs)}{'; ' + reason if reason else ''}")
        self.pairs = list(pairs)  # for each object, the pair of links that overlaps most
        self.bodies = _bodies(pairs)


@dataclass_error
class InCollision(PlanFailure):
    """The robot, or an object that it holds, would touch other objects at the pose."""

    position: Sequence[float] = kept_as(floats)  # position of the refused base pose
    orientation: Sequence[float] = kept_as(floats)
    bodies: Sequence[str] = kept_as(list)  # names of the objects that the robot would touch
    pairs: Sequence[CollisionPair] = kept_as(list, default=())  # for each object, the pair of links that overlaps most

    def _message(self) -> str:
        touched = phrases(self.pairs) if self.pairs else f"it would touch {', '.join(self.bodies)}"
        return f"the robot can't be at {_point(self.position)}: {touched}; the robot stays where it is"


@dataclass_error
class NotDrivable(PlanFailure):
    """The robot's base can't drive to the pose, because the base drives upright on its ground."""

    position: Sequence[float] = kept_as(floats)  # position of the refused base pose
    orientation: Sequence[float] = kept_as(floats)
    reason: str

    def _message(self) -> str:
        return f"the robot can't drive to {_point(self.position)}: {self.reason}; the robot stays where it is"


@dataclass_error
class PostureInCollision(PlanFailure):
    """In the posture, the arms would touch objects that they don't touch now."""

    arms: Sequence[str] = kept_as(list)
    bodies: Sequence[str] = kept_as(list)  # names of the objects that the arms would touch; may include the robot
    # For each object, the pair of links that would overlap most; for the robot itself, all pairs of links.
    pairs: Sequence[CollisionPair] = kept_as(list, default=())
    _: KW_ONLY
    # Name of the torso's joint, and its height in m at which the arms would touch nothing; None if there is none
    torso: tuple[str, float] | None = None

    def _message(self) -> str:
        touched = phrases(self.pairs) if self.pairs else f"it would touch {', '.join(self.bodies)}"
        hint = f"; with {self.torso[0]} at {self.torso[1]:g} m the robot can take the posture" if self.torso else ""
        return (
            f"the {' and '.join(self.arms)} arm can't take that posture: {touched}; the robot stays where it is{hint}"
        )


@dataclass_error
class NoPath(PlanFailure):
    """No collision-free path was found within a budget of collision checks; a path may still exist."""

    mover: str  # part of the robot that should move, such as "left arm" or "base".
    goal: Mapping[str, float] = kept_as(dict)  # joint values by name; for a base, x, y and yaw in the world
    checks: int  # number of configurations that were checked for collisions
    nearest: Mapping[str, float] = kept_as(dict)  # the reached configuration that is nearest to the goal
    distance: float  # joint distance from ``nearest`` to the goal; for a base in m, where 1 rad counts as 0.5 m
    pairs: Sequence[CollisionPair] = kept_as(list)  # the pairs of links whose contacts ended most paths
    reason: str = ""  # why the arm can't stay level, if that is the cause

    def _message(self) -> str:
        if self.reason:
            return f"no path was found for the {self.mover}: {self.reason}; the {self.mover} stays where it is"
        often = f"; most often {phrases(self.pairs)}" if self.pairs else ""
        searched = f"the search ended {self.distance:.2f} from the goal after {self.checks} checked configurations"
        return f"no path was found for the {self.mover}: {searched}{often}; the {self.mover} stays where it is"


@dataclass_error
class NoPlace(PlanFailure):
    """No place fulfils all constraints at the same time."""

    wanted: str  # the purpose of the place
    excluded: Mapping[str, int] = kept_as(dict)  # number of places that each constraint excluded, in order
    last: str  # the constraint that excluded the last places
    _: KW_ONLY
    _why: str = ""  # the last constraint's most frequent reason, and a remedy; only for the message

    def _message(self) -> str:
        counts = ", ".join(f"{count} by {name}" for name, count in self.excluded.items())
        total = sum(self.excluded.values())
        considered = f"{total} places were excluded, {counts}" if counts else "no place was left"
        why = f"; {self._why}" if self._why else ""
        return f"no place for {self.wanted}: {considered}; the last place was excluded by {self.last}{why}"


@dataclass_error
class MissingPart(PlanFailure):
    """A robot lacks a part that a motion needs; another arm or another robot may have the part."""

    owner: str  # name of the robot, or of its arm
    part: str  # "gripper", "camera"

    _template = "the {owner} has no {part} in its description"


@dataclass_error
class LookingFailed(PlanFailure):
    """The head can't turn the camera to the target."""

    target: Sequence[float] = kept_as(floats)
    angle: float  # angle that remains between the camera's axis and the target, with the head at its joint limits

    def _message(self) -> str:
        return f"the head can't look at {_point(self.target)}: joint limits stop the turn {self.angle:.3f} rad before"


@dataclass_error
class GraspFailed(PlanFailure):
    """The gripper can't grasp the object."""

    arm: str  # "left" or "right"
    body: str
    reason: str

    _template = "{arm} gripper can't grasp {body}: {reason}"


class DoesNotFit(GraspFailed):
    """From every allowed side, the object is too big or too thin for the gripper."""

    def __init__(
        self, arm: str, body: str, widths: Sequence[float], gap: float, widest: float, how: str = "", others: str = ""
    ) -> None:
        self.widths = tuple(sorted(widths))  # widths in m of the sides and rims that were tried
        self.gap = gap  # gap in m between the closed fingers: thinner objects slip through
        self.widest = widest  # gap in m between the open fingers: thicker objects don't fit
        thin = any(width < gap for width in widths)
        big = any(width >= gap for width in widths)
        size = "too big or too thin" if thin and big else "too thin" if thin else "too big"
        digits = 0
        while digits < _MAX_DIGITS and any(
            round(gap * 1e3, digits) <= round(width * 1e3, digits) <= round(widest * 1e3, digits) for width in widths
        ):
            digits += 1  # otherwise 73.04 mm and 72.96 mm would look equal
        between = f"{gap * 1e3:.{max(digits, 1)}f}-" if gap else "up to "
        between += f"{widest * 1e3:.{digits}f} mm fit between the fingers"
        measured = ", ".join(dict.fromkeys(f"{width * 1e3:.{digits}f}" for width in self.widths))
        reason = "no part of it is between the fingers from any allowed side"
        if widths:
            reason = f"it is {size} for the gripper from every allowed side: it measures {measured} mm, {between}"
        super().__init__(arm, body, f"{how}{reason}{others}")


@dataclass_error
class GripperBlocked(PlanFailure):
    """The fingers can't open far enough to release the object in the gripper."""

    arm: str
    body: str
    pairs: Sequence[CollisionPair] = kept_as(list)  # pairs of links that would touch, the deepest first

    def _message(self) -> str:
        return f"{self.arm} gripper can't release {self.body}: {phrases(self.pairs)}; the gripper didn't move"


@dataclass_error
class PlaceFailed(PlanFailure):
    """The object can't be put down at the target, or the object didn't come to rest there."""

    body: str
    target: Sequence[float] = kept_as(floats)
    reason: str
    _: KW_ONLY
    orientation: Sequence[float] | None = kept_as(floats, default=None)  # requested orientation; None for upright
    pairs: Sequence[CollisionPair] = kept_as(list, default=())  # pairs of links that would touch
    wanted: PoseLike | None = None  # pose at the release; None if the object wasn't released
    rest: PoseLike | None = None  # pose at rest after the release; None if the object wasn't released
    touching: Sequence[CollisionPair] = kept_as(list, default=())  # pairs of links that touch at rest

    def _complete(self) -> None:
        self.reason = self.reason or phrases(self.pairs)

    def _message(self) -> str:
        verb = "can't be placed" if self.rest is None else "doesn't stand"
        return f"{self.body} {verb} at {_point(self.target)}: {self.reason}"


@dataclass_error
class TrackingLost(PlanFailure):
    """A body couldn't follow its trajectory; the body stops, and stays where it is."""

    body: str
    number: int  # number of the trajectory in its world
    joint: str  # the first joint whose deviation was too large
    error: float  # deviation of ``joint``, rad or m
    time: float  # time reached on the trajectory, s
    pairs: Sequence[CollisionPair] = kept_as(list)  # contacts of the body at that time, the hardest first

    def _message(self) -> str:
        why = f": {phrases(self.pairs)}" if self.pairs else f"; {self.body} touches nothing"
        off = f"{self.error:.3f} off trajectory {self.number} after {self.time:.3f} s"
        return f"{self.joint} of {self.body} is {off}{why}"


@dataclass_error
class TrajectoryEnded(PlanFailure):
    """A trajectory ended early: the trajectory was stopped, or its world was reset or restored."""

    body: str
    number: int  # number of the trajectory in its world
    time: float  # time reached on the trajectory, s
    duration: float  # duration of the whole trajectory, s

    _template = (
        "trajectory {number} of {body} ended after {time:.3f} of {duration:.3f} s: the trajectory was "
        "stopped, or the world was reset or restored"
    )


@dataclass_error
class Displaced(PlanFailure):
    """Between two parts of a motion, something else, such as another branch, moved a joint or the base."""

    body: str
    coordinate: str  # name of the joint; x, y or yaw for the base
    expected: float  # expected value of this coordinate in rad or m
    position: float

    _template = (
        "{coordinate} of {body} is at {position:.3f} instead of {expected:.3f}: something else moved {body} during the "
        "motion; {body} stays where it is: perform the motion again"
    )


@dataclass_error
class AccessFailed(PlanFailure):
    """A door or drawer can't be opened or closed as asked."""

    joint: str
    reason: str
    _: KW_ONLY
    handle: str = ""  # name of the handle's link
    arm: str = ""
    asked: float | None = None  # requested position of the joint in rad or m
    value: float | None = None  # joint position up to which the arm can follow; None if there is another cause
    reached: float | None = None  # the last joint position that the arm could reach; None if it reaches no position
    orientation: Sequence[float] | None = kept_as(floats, default=None)  # orientation of the tool at ``value``
    remedies: Sequence[str] = kept_as(list, default=())  # ways to succeed, as texts

    def _message(self) -> str:
        moved = "opened" if self.asked is None else f"moved to {self.asked:g}"
        path = ""
        if self.value is not None:
            path = f" by {self.handle} with the {self.arm} arm: at {self.joint} = {self.value:.3f}"
        turned = "" if self.orientation is None else f", with the gripper turned to {_point(self.orientation)}"
        hints = "".join(f"; {remedy}" for remedy in self.remedies)
        why = f"{path}{turned}, {self.reason}" if path else f": {self.reason}"
        return f"{self.joint} can't be {moved}{why}{hints}"


class HandleUnreachable(AccessFailed, Unreachable):
    """The arm can't reach the handle, or can't follow the handle on the whole path of the door or drawer."""

    def __init__(
        self, joint: str, reason: str, *, target: Sequence[float], distance: float | None, turn: float, **details: Any
    ) -> None:
        AccessFailed.__init__(self, joint, reason, **details)
        self.target = floats(target)  # target position of the tool
        self.distance = distance  # distance in m from the target to the tool in the nearest posture
        self.turn = turn  # angle in rad between the requested orientation and the reached orientation


class HandleBlocked(AccessFailed):
    """The arm, the door or the drawer would touch an object on its way."""

    def __init__(self, joint: str, reason: str, *, pairs: Sequence[CollisionPair], **details: Any) -> None:
        super().__init__(joint, reason, **details)
        self.pairs = list(pairs)  # pairs of links that would touch
        self.bodies = _bodies(pairs)


@dataclass_error
class PropertyViolated(PlanFailure):
    """The run violates a watched property."""

    property: str  # text of the property
    step: int  # step of the record that violates the property; -1 without a recording
    seconds: float  # simulated time of the world at the violation
    margin: float | None  # negative margin in m, rad or s by which the property is violated; None if it has no margin
    values: Mapping[str, object]  # values of the quantities in the property, by their texts
    reason: str = ""  # why the property is violated; "" if the values show it

    def _message(self) -> str:
        values = ", ".join(
            f"{text} = {f'{value:.4g}' if isinstance(value, float) else value}" for text, value in self.values.items()
        )
        step = f" at step {self.step}" if self.step >= 0 else ""
        why = "; ".join(filter(None, (self.reason, values)))
        return f"{self.property}: violated{step} ({self.seconds:.3f} s){why and f': {why}'}"


export("pycram.failures", *(globals()[name] for name in __all__))
