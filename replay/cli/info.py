"""``info``: what ran, when, for how long, and how it ended."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from replay.cli.console import print_json, tell
from replay.explain.summary import summary
from replay.explain.wording import one_line
from replay.file.lifetimes import title

if TYPE_CHECKING:
    import argparse

    from replay.explain.summary import Summary
    from replay.recording import Recording

_FEW = 8  # worlds that are told one by one
_TOLD = ("pycram", "pybullet", "python", "platform")


def add(_: argparse.ArgumentParser) -> None:
    """Takes nothing more."""


def run(log: Recording, options: argparse.Namespace) -> int:
    """Prints the summary."""
    facts = summary(log)
    if options.json:
        told = dataclasses.asdict(facts) | {"file": str(log.path), "started": facts.started.isoformat()}
        print_json(told)
    else:
        tell("\n".join(f"{name:12} {text}" for name, text in _lines(log, facts) if text))
    return 0


def _lines(log: Recording, facts: Summary) -> list[tuple[str, str]]:
    counts = ", ".join(f"{count} {kind}" for kind, count in facts.counts.items())
    whole = "yes" if facts.checked else "yes, as far as its index tells (too long to read it all)"
    return [
        ("file", f"{log.path} ({_size(facts.size)})"),
        ("plan", " ".join((facts.plan, facts.metadata.get("plan_arguments", ""))).strip()),
        ("started", f"{facts.started:%Y-%m-%d %H:%M:%S} UTC"),
        ("took", f"{facts.seconds:.3f} s"),
        ("outcome", facts.outcome),
        ("failure", one_line(facts.failure)),
        *(("", f"thread {thread} failed: {one_line(failure)}") for thread, failure in facts.threads),
        ("steps", f"0 to {facts.records - 1}: {counts}"),
        ("worlds", _worlds(facts)),
        ("files", f"{facts.attachments} attached"),
        ("versions", ", ".join(f"{key} {facts.metadata[key]}" for key in _TOLD if key in facts.metadata)),
        ("complete", f"no: {facts.missing}" if facts.missing else whole),
    ]


def _worlds(facts: Summary) -> str:
    told = [f"{title(each.world, each.lifetime)}: {each.seconds:.3f} s simulated" for each in facts.worlds[:_FEW]]
    if len(facts.worlds) > _FEW:
        told.append(f"{len(facts.worlds) - _FEW} more")
    return ", ".join(told)


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count} bytes"
