"""What was in the way, and what had put it there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from replay.explain.causes.cause import InTheWay
from replay.explain.causes.preconditions import joints_to

if TYPE_CHECKING:
    from collections.abc import Iterator

    from replay.explain.causes.case import Case
    from replay.explain.causes.cause import Change


def in_the_way(case: Case) -> Iterator[InTheWay]:
    """Yield what the robot, or what it holds, would have touched, and what hid an object."""
    if case.world is None:
        return
    for pair in case.pairs:
        body, link = pair.get("body", ""), pair.get("body_link", "")
        if body in case.world.bodies and body != case.world.robot:
            yield _obstacle(case, body, link, pair.get("link") or pair.get("mover", ""))
    touching = case.data.get("touching")  # where it came to rest
    for met in touching if isinstance(touching, list) else []:
        body = str(met.get("body", "")) if isinstance(met, dict) else ""
        if case.free_body(body) is not None:
            yield _obstacle(case, body, "", ", ".join(case.subjects))
    reasons = case.data.get("reasons")
    if case.failure.type == "PerceptionError" and isinstance(reasons, dict):
        for name in case.mentioned:
            if name not in reasons and name != case.world.robot:
                yield _obstacle(case, name, "", "")


def _obstacle(case: Case, body: str, link: str, mover: str) -> InTheWay:
    change: Change | None = None
    if case.free_body(body) is not None:
        change = case.changed(body)
    else:
        for joint in joints_to(case, body, link):
            change = change or case.changed(f"{body}.{joint}")
    steps = (change.step, case.step) if change is not None else (case.step,)
    return InTheWay(steps, body, link, mover, change)
