"""Hands that didn't hold what they should, or held something else: since which record."""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.records import Mutation
from replay.explain.causes.cause import HandState
from replay.explain.causes.preconditions import holder, lacking

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.explain.causes.case import Case
    from replay.explain.causes.cause import Change


def find(case: Case) -> Iterator[HandState]:
    """Yield why a hand was empty that should hold the motion's object, or wasn't free of another."""
    arm = str(case.given.get("arm") or "")
    for lack in lacking(case):
        if lack.precondition not in ("held", "hand-free") or (lack.precondition == "hand-free" and case.pairs):
            continue
        change = last_grip(case, lack.subject, attached=lack.precondition == "hand-free")
        steps = (*([change.step] if change is not None else []), case.step)
        yield HandState(steps, lack.precondition, lack.subject, arm, holder(case, lack.subject), change)


def last_grip(case: Case, body: str, *, attached: bool, before: int | None = None) -> Change | None:
    """Return the last record that attached an object to something, or let go of it; None if there is none."""
    start = case.step if before is None else before
    for record in case.log.backwards(start, Mutation, naming=body):
        made = [each.body for each in record.effect.attached] if record.HasField("attach_body") else []
        undone = [each.body for each in record.effect.detached]
        if body in (made if attached else undone):
            return case.change(record, body, "attached" if attached else "detached")
        if record.HasField("load_body") and record.load_body.body == body:
            break
    return None
