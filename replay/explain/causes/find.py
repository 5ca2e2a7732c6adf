"""Finds the causes of a case, those that explain most first; what a deeper cause explains isn't listed twice."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING

from recorder.tasks import Node
from replay.explain.causes import (
    gone,
    hand_states,
    in_the_way,
    interrupted,
    misbelief,
    no_longer,
    out_of_reach,
    physics,
    raised,
    refused,
    swallowed,
    timeout,
)
from replay.explain.causes.cause import (
    Change,
    Gone,
    HandState,
    InTheWay,
    Misbelief,
    NoCandidate,
    NoLonger,
    OutOfReach,
    Physics,
    Refused,
    Swallowed,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from replay.explain.causes.case import Case
    from replay.explain.causes.cause import Cause


def find(case: Case) -> tuple[Cause, ...]:
    """Return the causes of a failure that the recording holds; none if it holds no more than the failure."""
    ended = tuple(interrupted.find(case))
    if ended:
        return ended
    found: list[Cause] = [
        *swallowed.find(case),
        *refused.find(case),
        *physics.find(case),
        *no_longer.find(case),
        *misbelief.find(case),
        *timeout.find(case),
        *gone.find(case),
        *raised.find(case),
        *hand_states.find(case),
        *in_the_way.in_the_way(case),
        *out_of_reach.out_of_reach(case),
        *out_of_reach.no_candidate(case),
    ]
    return tuple(_with_events(cause) for cause in found if not _is_explained(cause, found))


def _with_events(cause: Cause) -> Cause:
    """Return a cause with the steps of the events whose handlers made its changes."""
    values = [getattr(cause, each.name) for each in fields(cause)]
    changes = [each for value in values for each in (value if isinstance(value, tuple) else (value,))]
    events = {each.handler.cause for each in changes if isinstance(each, Change) and each.handler is not None}
    events.discard(0)  # before the recording
    return replace(cause, steps=tuple(sorted({*cause.steps, *events}))) if events else cause


def _is_explained(cause: Cause, found: Sequence[Cause]) -> bool:
    """Return whether a deeper cause explains the same already."""
    if isinstance(cause, HandState):
        deeper = [each for each in found if isinstance(each, Swallowed | Refused)]
        gone = any(isinstance(each, Gone) and each.body == cause.body for each in found)
        return gone or any((each.precondition, each.subject) == (cause.precondition, cause.body) for each in deeper)
    if isinstance(cause, NoLonger) and isinstance(cause.asked, Node):  # what a look has told
        believed = {each.body for each in found if isinstance(each, Misbelief)}
        return believed.issuperset(change.body for change in cause.changes)
    if isinstance(cause, InTheWay | Misbelief):
        return any(isinstance(each, Physics) and each.body == cause.body for each in found)
    if isinstance(cause, NoCandidate) and cause.count == 1:  # then the message says it
        return len(found) > 1
    if isinstance(cause, OutOfReach | NoCandidate):
        return any(isinstance(each, Physics | NoLonger | Misbelief | Swallowed) for each in found)
    return False
