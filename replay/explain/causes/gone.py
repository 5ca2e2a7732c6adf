"""An object was removed, or a hand didn't hold the object that it should, or wasn't free of another one."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder.records import Mutation
from replay.explain.causes.cause import Cause, CausingChange, since
from replay.explain.causes.lacked import RefusedRequest, Swallowed, lacking
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from replay.explain.causes.case import FailureCase


_GONE: Final = re.compile(r": object (.+) is gone$")  # of the message of a WorldClosed
_SEARCHED: Final = 5_000  # changes before the failure


@dataclass(frozen=True, slots=True)
class Gone(Cause):
    """The object that the plan used, or the last of the type that it looked for, had been removed."""

    kind = "removed"
    body: str
    change: CausingChange  # the record that removed it
    loaded: CausingChange | None = None  # the record that loaded another one of its name since then

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Gone]:
        """Yield the removal of the object that the plan used, or of the last one of the type that it looked for."""
        name, removal = _removal(case)
        if removal is None:
            return
        removed = case.change(removal, name, "removed")
        later = case.log.records(Mutation, removal.seq + 1, case.step)
        again = (each for each in later if each.HasField("load_body") and each.world == removal.world)
        reloaded = next((each for each in again if each.load_body.body == name), None)
        loaded = case.change(reloaded, name, "load") if reloaded is not None else None
        steps = (removed.step, *([loaded.step] if loaded is not None else []), case.step)
        yield Gone(steps, name, removed, loaded)

    def _words(self) -> Iterator[str]:
        yield f"{self.body} had been removed at step {self.change.step}{self.change.originator}"
        if self.loaded is not None:
            yield f"step {self.loaded.step}: another {self.loaded}"


@dataclass(frozen=True, slots=True)
class HandState(Cause):
    """A hand didn't hold what it should, or held something that it shouldn't."""

    kind = "hand-state"
    precondition: str  # "held": the arm should have held the object; "hand-free": it should have been free of it
    body: str
    arm: str  # the arm of the failed motion
    holder: str  # the holder at the failure: an arm, or ``CARRIER (LINK)``; "" if there was none
    change: CausingChange | None  # the record since when it was so; None if it always was

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[HandState]:
        """Yield why a hand didn't hold the motion's object, or still held another one."""
        arm = str(case.given.get("arm") or "")
        for lack in lacking(case):
            if lack.precondition not in ("held", "hand-free") or (lack.precondition == "hand-free" and case.pairs):
                continue
            change = _last_grip(case, lack.subject, attached=lack.precondition == "hand-free")
            steps = (*([change.step] if change is not None else []), case.step)
            yield HandState(steps, lack.precondition, lack.subject, arm, case.holder(lack.subject), change)

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether the object was removed, or a failure or refusal before left the hand so."""
        return any(
            (isinstance(each, Gone) and each.body == self.body)
            or (
                isinstance(each, Swallowed | RefusedRequest)
                and (each.precondition, each.subject) == (self.precondition, self.body)
            )
            for each in found
        )

    def _words(self) -> Iterator[str]:
        step = f"at step {self.steps[-1]}"
        if self.precondition == "hand-free":
            hand = f"the {self.holder} gripper" if " (" not in self.holder else self.holder
            yield f"{hand} held {self.body} {step}{since(self.change, 'taken')}"
            return
        if self.holder:
            end = f": the {self.holder} one did" if " " not in self.holder else f": {self.holder} did"
        else:
            end = since(self.change, "let go of") if self.change is not None else ": nothing had taken it"
        yield f"the {self.arm} gripper didn't hold {self.body} {step}{end}"


def _removal(case: FailureCase) -> tuple[str, Mutation | None]:
    """Return the name of the object that the failure is about, and the record that removed it, or None.

    The removal of an object that a hand should hold counts only if a hand held it then.
    """
    kind, sought = case.failure.type, case.data.get("name")
    for lack in lacking(case):
        removal = removal_of(case, lack.subject) if lack.precondition == "held" else None
        if removal is not None and case.holder(lack.subject, removal.seq - 1):
            return lack.subject, removal
    used = _GONE.search(case.failure.message) if kind == "WorldClosed" else None
    if used is not None:
        return used[1], removal_of(case, used[1])
    if kind == "UnknownName" and case.data.get("kind") == "object" and isinstance(sought, str):
        return sought, removal_of(case, sought)
    wanted = case.data.get("object_type")
    there = {body.type for body in case.world.bodies.values()} if case.world is not None else ()
    if kind == "PerceptionError" and isinstance(wanted, str) and wanted not in there:
        return _removal_of_type(case, wanted)
    return "", None


def removal_of(case: FailureCase, name: str, start: int = 0) -> Mutation | None:
    """Return the last record since a step that removed the object with a name; None if there is none."""
    for record in case.log.backwards(case.step, Mutation, naming=name):
        if record.seq < start:
            break
        if name in record.effect.removed and case.is_here(record):
            return record
    return None


def _removal_of_type(case: FailureCase, object_type: str) -> tuple[str, Mutation | None]:
    for record in islice(case.log.backwards(case.step, Mutation), _SEARCHED):
        if not record.HasField("remove_body") or not case.is_here(record):
            continue
        body = state_at(case.log, record.seq - 1).worlds[record.world].bodies.get(record.remove_body.body)
        if body is not None and body.type == object_type:
            return body.name, record
    return "", None


def _last_grip(case: FailureCase, body: str, *, attached: bool) -> CausingChange | None:
    """Return the last record that attached an object to something, or let go of it; None if there is none."""
    for record in case.log.backwards(case.step, Mutation, naming=body):
        made = [each.body for each in record.effect.attached] if record.HasField("attach_body") else []
        undone = [each.body for each in record.effect.detached]
        if body in (made if attached else undone):
            return case.change(record, body, "attached" if attached else "detached")
        if record.HasField("load_body") and record.load_body.body == body:
            break
    return None
