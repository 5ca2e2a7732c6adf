"""The kinds of causes of a failure, and their order. A new kind is a class in a file, and an entry in the list."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from recorder import geometry
from replay.explain.causes.case import about
from replay.explain.causes.changed import ForkedChange, Gone, HandState, Misbelief, NoGravity, NoLonger, OtherWorld
from replay.explain.causes.lacked import ClosedContainer, RefusedRequest, Swallowed
from replay.explain.causes.out_of_reach import TOO_FAR, NoCandidate, ObstructingBody, UnreachedTarget
from replay.explain.causes.physics import Physics
from replay.explain.causes.raised import Raised, Written
from replay.explain.causes.waiting import EndedWait, Interruption, Timeout

if TYPE_CHECKING:
    from replay.explain.causes.case import Cause, FailureCase

#: All kinds. Causes of earlier kinds are shown first.
KINDS: Final[tuple[type[Cause], ...]] = (
    *(ForkedChange, OtherWorld, ClosedContainer, NoGravity, Swallowed, RefusedRequest, EndedWait, Written, Physics),
    *(NoLonger, Misbelief, Timeout, Gone, Raised, HandState),
    *(ObstructingBody, UnreachedTarget, NoCandidate),
)
_DECIDING: Final = (
    *("other-world", "closed", "gravity", "swallowed-failure", "refused"),
    *("physics", "no-longer-true", "removed", "timeout", "written", "ended-wait"),
)
_BEHIND: Final = 0.2  # distance behind the robot's base, m


def find(case: FailureCase) -> tuple[Cause, ...]:
    """Return the recorded causes of a failure. The causes that explain most come first.

    Causes that a deeper cause explains are left out.
    """
    ended = tuple(Interruption.find(case))
    if ended:
        return ended
    found = [cause for kind in KINDS for cause in kind.find(case)]
    return tuple(cause.with_events() for cause in found if not cause.is_explained(found))


def decides(case: FailureCase, cause: Cause) -> bool:
    """Return whether a cause is a mistake before the failed call, rather than a state of the world."""
    target = case.data.get("target")
    if isinstance(cause, Written) and cause.change.how == "load":
        return False  # nothing has changed the value
    if not isinstance(cause, UnreachedTarget) or not isinstance(target, list) or case.robot is None:
        return cause.kind in _DECIDING
    ahead, *_ = geometry.transform(geometry.invert(case.robot.pose), [float(str(each)) for each in target])
    return cause.distance > TOO_FAR or ahead < -_BEHIND  # the robot's place is wrong


def lacks_step(case: FailureCase, causes: Sequence[Cause]) -> bool:
    """Return whether a call is missing before the failed call, whose own line counts then."""
    first = next(iter(causes), None)
    if isinstance(first, ClosedContainer):
        return True
    if isinstance(first, HandState):
        return first.precondition == "held"
    if not isinstance(first, UnreachedTarget) or not decides(case, first) or case.robot is None:
        return False
    arrived = max((each.step for each in first.changes if each.body == case.robot.name and not each.joint), default=0)
    done = (each for each in case.failed.motions if not each.failed and arrived < each.started.seq < case.began)
    return any(about(each, body=body) for each in done for body in case.subjects)
