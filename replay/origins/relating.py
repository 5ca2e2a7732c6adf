"""Relates a plan's values to the world: objects that moved after they were read, and mistakes that fit a number."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from replay.errors import NoSuchName
from replay.history.blame import blame
from replay.history.source import PlanSource
from replay.report import phrases
from replay.state.fold import state_at

if TYPE_CHECKING:
    from replay.explain.why import Why
    from replay.file.record_reader import RecordReader
    from replay.origins.origin import Origin

_MOVED = 0.001  # in m; smaller moves are ignored


def with_moves(log: RecordReader, origin: Origin, why: Why) -> Origin:
    """Return a fact with the moves of the objects that it and its parts read."""
    parts = tuple(with_moves(log, each, why) for each in origin.parts)
    return replace(origin, parts=parts, moved=_moved_since(log, origin, why) if origin.kind == "read" else "")


def _moved_since(log: RecordReader, origin: Origin, why: Why) -> str:
    world = why.world
    if world is None or origin.step < 0 or origin.body not in world.bodies:
        return ""
    then = state_at(log, origin.step).worlds.get(world.name)
    before = None if then is None or then.lifetime != world.lifetime else then.bodies.get(origin.body)
    distance = 0.0 if before is None else math.dist(before.position, world.bodies[origin.body].position)
    if distance < _MOVED:
        return ""
    try:
        last = blame(log, origin.body, why.step, world.name)
    except NoSuchName:
        return ""
    source = PlanSource(log)
    stack = last.causes.call_stack
    motion = next((each.started for each in last.causes.tasks if each.started.kind == "motion"), None)
    by = f" by {motion.name}" if motion is not None else ""
    return (
        f"{origin.body} has moved {phrases.length(distance)} since then, last at step {last.record.seq}{by}"
        + phrases.at(stack[-1] if stack else source.line("", 0))
    )
