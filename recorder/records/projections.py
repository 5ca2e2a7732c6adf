"""What a projection foresaw, in words: of the task that a plan asked for it with."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from recorder.records.values import from_json

if TYPE_CHECKING:
    from recorder.records.log_pb2 import Task


def foreseen(record: Task) -> str:
    """Return how what was projected would end, and where that is recorded; empty for other tasks and without an end."""
    outcome = _outcome(record)
    if "succeeded" not in outcome:
        return ""
    failure = str(outcome.get("failure") or "").partition("\n")[0]
    text = "it would succeed" if outcome["succeeded"] is True else f"it would fail{': ' + failure if failure else ''}"
    recording = recording_name(record)
    return f"{text}; see {recording}" if recording else text


def recording_name(record: Task) -> str:
    """Return the name of the file, beside the run's, with all that a projection did; empty if there is none.

    Of a path only the name counts: recordings are moved together, and a stranger's shall name no other folder.
    """
    recording = _outcome(record).get("recording")
    return PurePath(recording).name if isinstance(recording, str) else ""


def _outcome(record: Task) -> dict[str, Any]:
    if record.kind != "projection" or not record.result_json:
        return {}
    outcome = from_json(record.result_json)
    return outcome if isinstance(outcome, dict) else {}
