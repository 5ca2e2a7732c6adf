"""``info``: what ran, when, for how long, and how it ended."""

from __future__ import annotations

from collections import Counter
from datetime import datetime, timezone
from typing import TYPE_CHECKING

from recorder.records import TOPICS, Run

if TYPE_CHECKING:
    import argparse

    from replay.log import Log

HELP = "what ran, when, how long, and how it ended"


def add(parser: argparse.ArgumentParser) -> None:
    """Takes nothing more."""


def run(log: Log, _: argparse.Namespace) -> tuple[object, str]:
    """Counts the records.

    Returns:
        The facts, for machines and for people.
    """
    counts = Counter(TOPICS[type(record)].removeprefix("/") for record in log.records())
    first, last = log[0], log[-1]
    end = last if isinstance(last, Run) and last.phase == Run.FINISHED else None
    outcome = "not finished" if end is None else "succeeded" if end.succeeded else "failed"
    facts: dict[str, object] = {
        "file": str(log.path),
        "bytes": log.path.stat().st_size,
        "complete": log.complete,
        "missing": log.missing,
        "plan": log.metadata.get("plan", ""),
        "started": datetime.fromtimestamp(first.wall_time_ns / 1e9, timezone.utc).isoformat(timespec="seconds"),
        "seconds": round((last.wall_time_ns - first.wall_time_ns) / 1e9, 3),
        "outcome": outcome,
        "failure": f"{end.failure.type}: {end.failure.message}" if end is not None and not end.succeeded else "",
        "records": len(log),
        "counts": dict(counts),
        "worlds": list(log.first_steps),
        "attachments": len(log.assets),
        "metadata": {key: value for key, value in log.metadata.items() if key != "plan"},
    }
    lines = [
        f"{key:12} {_text(value)}" for key, value in facts.items() if value not in ("", None) and key != "metadata"
    ]
    told = ("pycram", "pybullet", "python", "platform")
    lines.append("versions     " + ", ".join(f"{key} {log.metadata[key]}" for key in told if key in log.metadata))
    return facts, "\n".join(lines)


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{count} {kind}" for kind, count in value.items())
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(value) if isinstance(value, list) else str(value)
