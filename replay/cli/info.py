"""``info``: what ran, when, for how long, and how it ended."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_result
from replay.cli.formatting import one_line
from replay.explain.run_summary import summary
from replay.file.lifetimes import title

if TYPE_CHECKING:
    import argparse

    from replay.explain.run_summary import Summary
    from replay.recording import Recording

_MAX_WORLDS: Final = 8  # that are listed one by one
_VERSIONS: Final = ("pycram", "pybullet", "python", "platform")


def add(_: argparse.ArgumentParser) -> None:
    """Add nothing."""


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the summary."""
    info = summary(log)
    lines = (f"{name:12} {text}" for name, text in _lines(log, info) if text)
    print_result(lambda: _data(log, info), lines, as_json=options.json)
    return 0


def _data(log: Recording, info: Summary) -> dict[str, object]:
    data: dict[str, object] = dataclasses.asdict(info)
    worlds = [{"world": each.world, "life": each.lifetime, "seconds": each.seconds} for each in info.worlds]
    missing = data.pop("problems")
    return data | {"worlds": worlds, "missing": missing, "file": str(log.path), "started": info.started.isoformat()}


def _lines(log: Recording, info: Summary) -> list[tuple[str, str]]:
    counts = ", ".join(f"{count} {kind}" for kind, count in info.counts.items())
    complete = "yes" if info.checked else "yes, according to its index (too long to be read whole)"
    return [
        ("file", f"{log.path} ({_size(info.size)})"),
        ("plan", " ".join((info.plan, info.metadata.get("plan_arguments", ""))).strip()),
        ("started", f"{info.started:%Y-%m-%d %H:%M:%S} UTC"),
        ("took", f"{info.seconds:.3f} s"),
        ("outcome", info.outcome),
        ("failure", one_line(info.failure)),
        *(("", f"thread {thread} failed: {one_line(failure)}") for thread, failure in info.threads),
        ("steps", f"0 to {info.records - 1}: {counts}"),
        ("worlds", _worlds(info)),
        ("files", f"{info.attachments} attached"),
        ("versions", ", ".join(f"{key} {info.metadata[key]}" for key in _VERSIONS if key in info.metadata)),
        ("complete", f"no: {info.problems}" if info.problems else complete),
    ]


def _worlds(info: Summary) -> str:
    worlds = [
        f"{title(each.world, each.lifetime)}: {each.seconds:.3f} s simulated" for each in info.worlds[:_MAX_WORLDS]
    ]
    if len(info.worlds) > _MAX_WORLDS:
        worlds.append(f"{len(info.worlds) - _MAX_WORLDS} more")
    return ", ".join(worlds)


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count} bytes"
