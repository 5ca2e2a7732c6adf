"""The kinds of causes of a failure, and their order. A new kind is a class in a file, and an entry in the list."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Final

from replay.explain.causes.case import CausingChange
from replay.explain.causes.changed import Gone, HandState, Misbelief, NoLonger
from replay.explain.causes.lacked import RefusedRequest, Swallowed
from replay.explain.causes.out_of_reach import NoCandidate, ObstructingBody, UnreachedTarget
from replay.explain.causes.physics import Physics
from replay.explain.causes.raised import Raised
from replay.explain.causes.waiting import Interruption, Timeout
from replay.explain.causes.worlds import NoGravity, OtherWorld

if TYPE_CHECKING:
    from replay.explain.causes.case import Cause, FailureCase

#: All kinds. The kinds that explain most come first.
KINDS: Final[tuple[type[Cause], ...]] = (
    OtherWorld,
    NoGravity,
    Swallowed,
    RefusedRequest,
    Physics,
    NoLonger,
    Misbelief,
    Timeout,
    Gone,
    Raised,
    HandState,
    ObstructingBody,
    UnreachedTarget,
    NoCandidate,
)


def find(case: FailureCase) -> tuple[Cause, ...]:
    """Return the recorded causes of a failure. The causes that explain most come first.

    Causes that a deeper cause explains are left out.
    """
    ended = tuple(Interruption.find(case))
    if ended:
        return ended
    found = [cause for kind in KINDS for cause in kind.find(case)]
    return tuple(_with_events(cause) for cause in found if not cause.is_explained(found))


def _with_events(cause: Cause) -> Cause:
    """Return a cause with the steps of the events whose handlers made its changes."""
    values = [getattr(cause, each.name) for each in fields(cause)]
    changes = [each for value in values for each in (value if isinstance(value, tuple) else (value,))]
    events = {each.handler.cause for each in changes if isinstance(each, CausingChange) and each.handler is not None}
    events.discard(0)  # before the recording
    return replace(cause, steps=tuple(sorted({*cause.steps, *events}))) if events else cause
