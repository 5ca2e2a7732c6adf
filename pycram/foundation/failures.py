"""What can go wrong in worlds and motions: plan failures (out of reach, not seen, in collision), and all usage errors.

Usage errors are defined in :mod:`pycram.foundation.usage_errors`, the two families in
:mod:`pycram.foundation.error_families`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pycram.foundation.collision_pair import CollisionPair, phrases
from pycram.foundation.error_families import PlanFailure, PycramError, UsageError
from pycram.foundation.names import export
from pycram.foundation.usage_errors import (
    AssetError,
    AttachmentError,
    BadArgument,
    ChangeRefused,
    DisplayError,
    FollowsTrajectory,
    JointLimitError,
    NoWorld,
    ObjectsChanged,
    ReadOnly,
    UnknownName,
    WorldClosed,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.geometry import PoseLike

__all__ = [
    "AccessFailed",
    "AssetError",
    "AttachmentError",
    "BadArgument",
    "Blocked",
    "ChangeRefused",
    "CollisionPair",
    "Displaced",
    "DisplayError",
    "DoesNotFit",
    "FollowsTrajectory",
    "GraspFailed",
    "GripperBlocked",
    "HandleBlocked",
    "HandleUnreachable",
    "InCollision",
    "JointLimitError",
    "LookingFailed",
    "MissingPart",
    "NoPath",
    "NoPlace",
    "NoWorld",
    "NotDrivable",
    "ObjectsChanged",
    "PerceptionError",
    "PlaceFailed",
    "PlanFailure",
    "PostureInCollision",
    "PycramError",
    "ReadOnly",
    "ReasoningError",
    "TrackingLost",
    "TrajectoryEnded",
    "UnknownName",
    "Unreachable",
    "UsageError",
    "WorldClosed",
]

_MAX_DIGITS: Final = 3  # of mm in messages


def _point(coordinates: Sequence[float]) -> str:
    return f"[{', '.join(f'{x:.3f}' for x in coordinates)}]"


class ReasoningError(PlanFailure):
    """What a plan had to rely on isn't so (thesis, Listing 5.5)."""


class PerceptionError(PlanFailure):
    """Nothing of the asked kind is seen or known (thesis 5.1).

    Attributes:
        object_type: what was looked for.
        reasons: for each object of that type, why it isn't seen.
    """

    def __init__(self, object_type: str = "", reasons: Mapping[str, str] | None = None) -> None:
        self.object_type = object_type
        self.reasons = dict(reasons or {})
        why = "; ".join(f"{name} {reason}" for name, reason in self.reasons.items())
        super().__init__(f"no {object_type or 'object'} found: {why or 'the world has none'}")


class Unreachable(PlanFailure):
    """No posture of the arm brings the tool there; if one does, but something is in its way, it is :class:`Blocked`.

    Attributes:
        arm: name of the arm (or the tool frame).
        target: xyz in m, world frame.
        distance: how near the tool came, in m.
        reason: what else prevented it.
    """

    def __init__(self, arm: str, target: Sequence[float], distance: float | None = None, reason: str = "") -> None:
        near = f"; the nearest posture stays {distance:.3f} m away" if distance is not None else ""
        super().__init__(f"{arm} arm can't reach {_point(target)}{near}{'; ' + reason if reason else ''}")
        self.arm = arm
        self.target = [float(x) for x in target]
        self.distance = distance
        self.reason = reason


class Blocked(Unreachable):
    """The arm reaches there, but something is in the way.

    Attributes:
        bodies: names of what it would touch; of the robot, if it would touch itself.
        pairs: the links that would overlap most, one pair an object.
    """

    def __init__(self, arm: str, target: Sequence[float], pairs: Sequence[CollisionPair], reason: str = "") -> None:
        super().__init__(arm, target, None, f"{phrases(pairs)}{'; ' + reason if reason else ''}")
        self.pairs = list(pairs)
        self.bodies = list(dict.fromkeys(pair.body for pair in pairs))


class InCollision(PlanFailure):
    """The robot, or what it holds, would touch something there.

    Attributes:
        position: xyz of the refused base pose in m.
        orientation: xyzw of the refused base pose.
        bodies: names of what would be touched.
        pairs: the links that would overlap most, one pair an object.
    """

    def __init__(
        self,
        position: Sequence[float],
        orientation: Sequence[float],
        bodies: Sequence[str],
        pairs: Sequence[CollisionPair] = (),
    ) -> None:
        touched = phrases(pairs) if pairs else f"it would touch {', '.join(bodies)}"
        super().__init__(f"the robot can't be at {_point(position)}: {touched}; it stays where it is")
        self.position = [float(x) for x in position]
        self.orientation = [float(x) for x in orientation]
        self.bodies = list(bodies)
        self.pairs = list(pairs)


class NotDrivable(PlanFailure):
    """A base can't stand there: it drives on its ground, and upright.

    Attributes:
        position: xyz of the refused base pose in m.
        orientation: xyzw of the refused base pose.
        reason: why not.
    """

    def __init__(self, position: Sequence[float], orientation: Sequence[float], reason: str) -> None:
        super().__init__(f"the robot can't drive to {_point(position)}: {reason}; it stays where it is")
        self.position = [float(x) for x in position]
        self.orientation = [float(x) for x in orientation]
        self.reason = reason


class PostureInCollision(PlanFailure):
    """Arms would touch something in a posture that they don't touch now.

    Attributes:
        arms: names of the arms.
        bodies: names of what they would touch, the robot's own for itself.
        pairs: the links that would overlap most, one pair an object; of the robot itself all.
        torso: joint of the torso, and the height in m at which they would touch nothing; None if there is none.
    """

    def __init__(
        self,
        arms: Sequence[str],
        bodies: Sequence[str],
        pairs: Sequence[CollisionPair] = (),
        *,
        torso: tuple[str, float] | None = None,
    ) -> None:
        touched = phrases(pairs) if pairs else f"it would touch {', '.join(bodies)}"
        hint = f"; with {torso[0]} at {torso[1]:g} m it could" if torso else ""
        super().__init__(f"the {' and '.join(arms)} arm can't take that posture: {touched}; it stays where it is{hint}")
        self.arms = list(arms)
        self.bodies = list(bodies)
        self.pairs = list(pairs)
        self.torso = torso


class NoPath(PlanFailure):
    """No path was found, within a budget of checks, on which nothing is touched; which doesn't prove that none exists.

    Attributes:
        mover: what was to move: "left arm", "base", ...
        goal: where to: joint values in rad or m by name; of a base x, y and yaw in the world.
        checks: configurations that were checked for collisions.
        nearest: to the goal of those to which a path was found.
        distance: of that to the goal: Euclidean, of joint values; of a base in m, with half a metre for a radian.
        pairs: the links that were in the way most often.
    """

    def __init__(
        self,
        mover: str,
        goal: Mapping[str, float],
        checks: int,
        nearest: Mapping[str, float],
        distance: float,
        pairs: Sequence[CollisionPair],
    ) -> None:
        often = f"; most often {phrases(pairs)}" if pairs else ""
        looked = f"in {checks} configurations that were checked, it came within {distance:.2f} of the goal"
        super().__init__(f"the {mover} finds no path there: {looked}{often}; it stays where it is")
        self.mover = mover
        self.goal = dict(goal)
        self.checks = checks
        self.nearest = dict(nearest)
        self.distance = distance
        self.pairs = list(pairs)


class NoPlace(PlanFailure):
    """No place was found that fulfils all constraints at once, among those that were considered.

    Attributes:
        wanted: for what.
        excluded: how many places each constraint excluded, of those that came that far.
        last: the constraint that excluded the last ones.
    """

    def __init__(self, wanted: str, excluded: Mapping[str, int], last: str) -> None:
        self.wanted = wanted
        self.excluded = dict(excluded)
        self.last = last
        counts = ", ".join(f"{count} by {name}" for name, count in self.excluded.items())
        considered = f"of {sum(self.excluded.values())} places {counts} were excluded" if counts else "none was left"
        super().__init__(f"no place for {wanted}: {considered}; the last by {last}")


class MissingPart(PlanFailure):
    """A robot doesn't have a part that a motion needs; another arm or another robot may.

    Attributes:
        owner: the robot, or its arm.
        part: what is missing: "gripper", "camera".
    """

    def __init__(self, owner: str, part: str) -> None:
        super().__init__(f"the {owner} has no {part}, says its description")
        self.owner = owner
        self.part = part


class LookingFailed(PlanFailure):
    """The head can't turn the camera to the target.

    Attributes:
        target: xyz in m, world frame.
        angle: angle in rad that remains between the camera's axis and the target.
    """

    def __init__(self, target: Sequence[float], angle: float) -> None:
        super().__init__(f"the head can't look at {_point(target)}: {angle:.3f} rad remain at its joint limits")
        self.target = [float(x) for x in target]
        self.angle = angle


class GraspFailed(PlanFailure):
    """The gripper can't take the object.

    Attributes:
        arm: "left" or "right".
        body: name of the object.
        reason: why not.
    """

    def __init__(self, arm: str, body: str, reason: str) -> None:
        super().__init__(f"{arm} gripper can't take {body}: {reason}")
        self.arm = arm
        self.body = body
        self.reason = reason


class DoesNotFit(GraspFailed):
    """The object is too big or too thin for the gripper, from any side that is allowed.

    Attributes:
        widths: of the object between the fingers, m, of the sides and rims that were tried.
        gap: m between the fingers when closed: thinner things slip through.
        widest: m that fit between the fingers when open.
    """

    def __init__(self, arm: str, body: str, widths: Sequence[float], gap: float, widest: float, how: str = "") -> None:
        self.widths = tuple(sorted(widths))
        self.gap = gap
        self.widest = widest
        thin = any(width < gap for width in widths)
        big = any(width >= gap for width in widths)
        size = "too big or too thin" if thin and big else "too thin" if thin else "too big"
        digits = 0
        while digits < _MAX_DIGITS and any(
            round(gap * 1e3, digits) <= round(width * 1e3, digits) <= round(widest * 1e3, digits) for width in widths
        ):
            digits += 1  # 73.04 mm don't fit where 72.96 mm do
        between = f"{gap * 1e3:.{max(digits, 1)}f}-" if gap else "up to "
        between += f"{widest * 1e3:.{digits}f} mm"
        measured = ", ".join(dict.fromkeys(f"{width * 1e3:.{digits}f}" for width in self.widths))
        tells = f": it measures {measured} mm, {between} fit between the fingers" if widths else ""
        super().__init__(arm, body, f"{how}it is {size} for the gripper from any side that is allowed{tells}")


class GripperBlocked(PlanFailure):
    """The fingers can't open far enough to let go of what they hold.

    Attributes:
        arm: name of the arm.
        body: name of the object that it holds.
        pairs: the links that would meet, deepest first.
    """

    def __init__(self, arm: str, body: str, pairs: Sequence[CollisionPair]) -> None:
        super().__init__(f"{arm} gripper can't let go of {body}: {phrases(pairs)}; it stays as it is")
        self.arm = arm
        self.body = body
        self.pairs = list(pairs)


class PlaceFailed(PlanFailure):
    """The object can't be set down there, or didn't come to rest where it was set down.

    Attributes:
        body: name of the object.
        target: xyz in m, world frame.
        reason: why not.
        orientation: xyzw that was asked for; None for upright.
        pairs: links that would meet, if that is why it wasn't set down.
        wanted: position and orientation in which it was let go; None if it was not.
        rest: position and orientation in which it is now; None if it was not let go.
        touching: what it touches there.
    """

    def __init__(
        self,
        body: str,
        target: Sequence[float],
        reason: str,
        *,
        orientation: Sequence[float] | None = None,
        pairs: Sequence[CollisionPair] = (),
        wanted: PoseLike | None = None,
        rest: PoseLike | None = None,
        touching: Sequence[CollisionPair] = (),
    ) -> None:
        verb = "can't be placed" if rest is None else "doesn't stand"
        super().__init__(f"{body} {verb} at {_point(target)}: {reason or phrases(pairs)}")
        self.body = body
        self.target = [float(x) for x in target]
        self.reason = reason or phrases(pairs)
        self.orientation = None if orientation is None else [float(x) for x in orientation]
        self.pairs = list(pairs)
        self.wanted = wanted
        self.rest = rest
        self.touching = list(touching)


class TrackingLost(PlanFailure):
    """A body couldn't follow its trajectory; it was stopped, and stands where it has got.

    Attributes:
        body: name of the object.
        number: the trajectory's number in its world.
        joint: the joint that was off first.
        error: how far it was from where it was to be, rad or m.
        time: how far the trajectory had got, s.
        pairs: what of the body, or of what it holds, touched something then, hardest first.
    """

    def __init__(
        self, body: str, number: int, joint: str, error: float, time: float, pairs: Sequence[CollisionPair]
    ) -> None:
        why = f": {phrases(pairs)}" if pairs else "; it touches nothing"
        super().__init__(f"{joint} of {body} is {error:.3f} off trajectory {number} after {time:.3f} s{why}")
        self.body = body
        self.number = number
        self.joint = joint
        self.error = error
        self.time = time
        self.pairs = list(pairs)


class TrajectoryEnded(PlanFailure):
    """A trajectory that was followed ended before its time: it was stopped, or its world was reset or restored.

    Attributes:
        body: name of the object.
        number: the trajectory's number in its world.
        time: how far it had got, s.
        duration: how long it takes, s.
    """

    def __init__(self, body: str, number: int, time: float, duration: float) -> None:
        super().__init__(
            f"trajectory {number} of {body} ended after {time:.3f} of {duration:.3f} s: it was stopped, "
            "or the world was reset or restored"
        )
        self.body = body
        self.number = number
        self.time = time
        self.duration = duration


class Displaced(PlanFailure):
    """What a motion was to move on isn't where it had left it: another branch, or something else, has moved it.

    Attributes:
        body: name of the object.
        coordinate: name of the joint, or x, y or yaw of the base.
        expected: where it was to be, rad or m.
        position: where it is.
    """

    def __init__(self, body: str, coordinate: str, expected: float, position: float) -> None:
        super().__init__(
            f"{coordinate} of {body} was moved to {position:.3f} during a motion that goes on from {expected:.3f}; "
            "it stays there: perform the motion again"
        )
        self.body = body
        self.coordinate = coordinate
        self.expected = expected
        self.position = position


class AccessFailed(PlanFailure):
    """A door or drawer can't be opened or closed as asked.

    Attributes:
        joint: its joint.
        reason: why not.
        handle: the link by which it should be moved.
        arm: name of the arm.
        asked: value of the joint that was asked for, rad or m.
        value: of the joint, from which on it fails; None if it isn't the path that fails.
        reached: value up to which that arm would move it from where the robot stands; None if it can't begin.
        orientation: xyzw of the gripper that was asked for at that value, in the world; None where it doesn't matter.
        remedies: what would do, in words.
    """

    def __init__(
        self,
        joint: str,
        reason: str,
        *,
        handle: str = "",
        arm: str = "",
        asked: float | None = None,
        value: float | None = None,
        reached: float | None = None,
        orientation: Sequence[float] | None = None,
        remedies: Sequence[str] = (),
    ) -> None:
        moved = "opened" if asked is None else f"moved to {asked:g}"
        path = "" if value is None else f" by {handle} with the {arm} arm: at {joint} = {value:.3f}"
        turned = "" if orientation is None else f", with the gripper turned to {_point(orientation)}"
        hints = "".join(f"; {remedy}" for remedy in remedies)
        why = f"{path}{turned}, {reason}" if path else f": {reason}"
        PlanFailure.__init__(self, f"{joint} can't be {moved}{why}{hints}")
        self.joint = joint
        self.reason = reason
        self.handle = handle
        self.arm = arm
        self.asked = asked
        self.value = value
        self.reached = reached
        self.orientation = None if orientation is None else [float(x) for x in orientation]
        self.remedies = list(remedies)


class HandleUnreachable(AccessFailed, Unreachable):
    """The arm doesn't get to the handle, or doesn't stay at it, as far as a door or drawer should move.

    Attributes:
        target: xyz of the tool there in m, world frame.
        distance: m that the tool stays away.
        turn: rad that remain to the orientation.
    """

    def __init__(
        self,
        joint: str,
        reason: str,
        *,
        target: Sequence[float],
        distance: float | None,
        turn: float,
        **details: Any,
    ) -> None:
        AccessFailed.__init__(self, joint, reason, **details)
        self.target = [float(x) for x in target]
        self.distance = distance
        self.turn = turn


class HandleBlocked(AccessFailed):
    """The arm, or the door or drawer itself, would touch something on the way.

    Attributes:
        pairs: which link would touch which.
        bodies: names of what is in the way.
    """

    def __init__(self, joint: str, reason: str, *, pairs: Sequence[CollisionPair], **details: Any) -> None:
        AccessFailed.__init__(self, joint, reason, **details)
        self.pairs = list(pairs)
        self.bodies = list(dict.fromkeys(pair.body for pair in pairs))


export("pycram.failures", *(globals()[name] for name in __all__))
