"""``info``: what ran, when, for how long, and how it ended."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_json, print_text
from replay.explain.summary import summary
from replay.explain.wording import one_line
from replay.file.lifetimes import title

if TYPE_CHECKING:
    import argparse

    from replay.explain.summary import Summary
    from replay.recording import Recording

_MAX_WORLDS: Final = 8  # that are listed one by one
_VERSIONS: Final = ("pycram", "pybullet", "python", "platform")


def add(_: argparse.ArgumentParser) -> None:
    """Add nothing."""


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the summary."""
    found = summary(log)
    if options.json:
        print_json(_data(log, found))
    else:
        print_text("\n".join(f"{name:12} {text}" for name, text in _lines(log, found) if text))
    return 0


def _data(log: Recording, found: Summary) -> dict[str, object]:
    data: dict[str, object] = dataclasses.asdict(found)
    worlds = [{"world": each.world, "life": each.lifetime, "seconds": each.seconds} for each in found.worlds]
    missing = data.pop("problems")
    return data | {"worlds": worlds, "missing": missing, "file": str(log.path), "started": found.started.isoformat()}


def _lines(log: Recording, found: Summary) -> list[tuple[str, str]]:
    counts = ", ".join(f"{count} {kind}" for kind, count in found.counts.items())
    complete = "yes" if found.checked else "yes, according to its index (too long to be read whole)"
    return [
        ("file", f"{log.path} ({_size(found.size)})"),
        ("plan", " ".join((found.plan, found.metadata.get("plan_arguments", ""))).strip()),
        ("started", f"{found.started:%Y-%m-%d %H:%M:%S} UTC"),
        ("took", f"{found.seconds:.3f} s"),
        ("outcome", found.outcome),
        ("failure", one_line(found.failure)),
        *(("", f"thread {thread} failed: {one_line(failure)}") for thread, failure in found.threads),
        ("steps", f"0 to {found.records - 1}: {counts}"),
        ("worlds", _worlds(found)),
        ("files", f"{found.attachments} attached"),
        ("versions", ", ".join(f"{key} {found.metadata[key]}" for key in _VERSIONS if key in found.metadata)),
        ("complete", f"no: {found.problems}" if found.problems else complete),
    ]


def _worlds(found: Summary) -> str:
    worlds = [
        f"{title(each.world, each.lifetime)}: {each.seconds:.3f} s simulated" for each in found.worlds[:_MAX_WORLDS]
    ]
    if len(found.worlds) > _MAX_WORLDS:
        worlds.append(f"{len(found.worlds) - _MAX_WORLDS} more")
    return ", ".join(worlds)


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count} bytes"
