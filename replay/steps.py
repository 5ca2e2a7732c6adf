"""Steps as people name them: numbers, ``last``, ``failure``, and moments of simulated time such as ``12.5s``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.records import Task
from replay.errors import NoSuchStep

if TYPE_CHECKING:
    from replay.log import Log

STEPS_PER_SECOND = 240


def step_of(log: Log, text: str) -> int:
    """The number of a step.

    Args:
        log: the recording.
        text: a number (negative ones count from the end), ``last``, ``failure`` (the first task that failed), or
            simulated seconds with an ``s``: the last step up to that moment.

    Raises:
        NoSuchStep: there is no such step.
    """
    if text == "last":
        return len(log) - 1
    if text == "failure":
        return failure_of(log).seq
    try:
        if text.endswith("s"):
            return _at_time(log, float(text[:-1]))
        number = int(text)
    except ValueError:
        hint = "; say a number, -1, last, failure or 12.5s"
        raise NoSuchStep(text, len(log), hint) from None
    step = number + len(log) if number < 0 else number
    if not 0 <= step < len(log):
        raise NoSuchStep(text, len(log))
    return step


def failure_of(log: Log) -> Task:
    """The record of the first task that failed.

    Raises:
        NoSuchStep: none did.
    """
    for record in log.records(Task):
        if isinstance(record, Task) and record.phase == Task.FINISHED and record.status == Task.FAILED:
            return record
    raise NoSuchStep("failure", len(log), "; no task failed")


def _at_time(log: Log, seconds: float) -> int:
    found = 0
    for record in log.records():
        if record.world and record.sim_step / STEPS_PER_SECOND <= seconds:
            found = record.seq
    return found
