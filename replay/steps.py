"""Steps as people name them: numbers, ``last``, ``failure``, and moments of simulated time such as ``12.5s``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from recorder.records import Keyframe, Mutation, Task
from replay.errors import NoSuchStep

if TYPE_CHECKING:
    from replay.log import Log

STEPS_PER_SECOND: Final = 240
HINT: Final = "number, negative from the end, last, failure, or 12.5s of simulated time"


def step_of(log: Log, name: int | str) -> int:
    """The number of a step.

    Args:
        log: the recording.
        name: a number (negative ones count from the end), ``last``, ``failure`` (the end of the first task that
            failed), or simulated seconds with an ``s``: the last step before the clock of the first world passes them.

    Raises:
        NoSuchStep: there is no such step.
    """
    text = str(name).strip()
    if text == "last":
        return len(log) - 1
    if text == "failure":
        return failure_of(log).seq
    try:
        if text.endswith("s"):
            return _at_time(log, float(text[:-1]), text)
        number = int(text)
    except ValueError:
        raise NoSuchStep(repr(text), len(log), f"a step is a {HINT}") from None
    step = number + len(log) if number < 0 else number
    if not 0 <= step < len(log):
        raise NoSuchStep(number, len(log))
    return step


def failure_of(log: Log) -> Task:
    """The record of the end of the first task that failed.

    Raises:
        NoSuchStep: none did.
    """
    for record in log.records(Task):
        if isinstance(record, Task) and record.phase == Task.FINISHED and record.status == Task.FAILED:
            return record
    raise NoSuchStep("failure", len(log), "no task failed")


def _at_time(log: Log, seconds: float, text: str) -> int:
    if not math.isfinite(seconds) or seconds < 0 or not log.worlds:
        raise NoSuchStep(text, len(log), "simulated time begins at 0 s")
    world, (changes, _) = next(iter(log.worlds.items()))
    limit = seconds * STEPS_PER_SECOND

    def passes(at: int) -> int | None:
        """The first step in a chunk at which the clock is past the moment."""
        for record in log.records_in([changes[at]], (Mutation, Keyframe), world):
            if record.sim_step > limit:
                return record.seq
        return None

    low, high = 0, len(changes)  # the clock never goes back: the first chunk in which it passes is found by halving
    while low < high:
        middle = (low + high) // 2
        if passes(middle) is None:
            low = middle + 1
        else:
            high = middle
    if low == len(changes):
        end = log.clock(world)
        if seconds > end:
            raise NoSuchStep(text, len(log), f"the clock of {world} ends at {end:.3f}s")
        return len(log) - 1
    step = passes(low)
    return max(0, (step or 0) - 1)
