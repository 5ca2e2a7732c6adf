"""What the plan used, or looked for, and had been removed; another of its name may have been loaded since then."""

from __future__ import annotations

import re
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder.records import Mutation
from replay.explain.causes.cause import Gone
from replay.explain.causes.preconditions import holder, lacking
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.explain.causes.case import Case
    from replay.explain.causes.cause import Change

_GONE: Final = re.compile(r": object (.+) is gone$")  # of the message of a WorldClosed
_SEARCHED: Final = 5_000  # changes before the failure


def find(case: Case) -> Iterator[Gone]:
    """Yield the object that the plan used, or the last one of the kind that it looked for, if it had been removed."""
    name, removal = _removal(case)
    if removal is None:
        return
    removed = case.change(removal, name, "removed")
    loaded = _loaded_again(case, removal, name)
    steps = (removed.step, *([loaded.step] if loaded is not None else []), case.step)
    yield Gone(steps, name, removed, loaded)


def _removal(case: Case) -> tuple[str, Mutation | None]:
    """Return the name of what the failure is about, and the record that removed it; None if none did.

    Of what a hand should hold, only a removal out of a hand counts.
    """
    kind, sought = case.failure.type, case.data.get("name")
    for lack in lacking(case):
        removal = removal_of(case, lack.subject) if lack.precondition == "held" else None
        if removal is not None and holder(case, lack.subject, removal.seq - 1):
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


def removal_of(case: Case, name: str, start: int = 0) -> Mutation | None:
    """Return the last record, from a step on, that removed an object of a name; None if there is none."""
    for record in case.log.backwards(case.step, Mutation, naming=name):
        if record.seq < start:
            break
        if name in record.effect.removed and case.is_here(record):
            return record
    return None


def _removal_of_type(case: Case, object_type: str) -> tuple[str, Mutation | None]:
    for record in islice(case.log.backwards(case.step, Mutation), _SEARCHED):
        if not record.HasField("remove_body") or not case.is_here(record):
            continue
        body = state_at(case.log, record.seq - 1).worlds[record.world].bodies.get(record.remove_body.body)
        if body is not None and body.type == object_type:
            return body.name, record
    return "", None


def _loaded_again(case: Case, removal: Mutation, name: str) -> Change | None:
    for record in case.log.records(Mutation, removal.seq + 1, case.step):
        if record.HasField("load_body") and record.load_body.body == name and record.world == removal.world:
            return case.change(record, name, "load")
    return None
