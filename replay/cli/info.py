"""``info``: what ran, when, for how long, and how it ended."""

from __future__ import annotations

import dataclasses
import shlex
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_result
from replay.file.lifetimes import title
from replay.history.summary import summary
from replay.report.phrases import one_line
from replay.state.json_data import record_data

if TYPE_CHECKING:
    import argparse

    from recorder.records import Change, Revision, Run
    from replay.history.summary import Summary
    from replay.recording import Recording
    from replay.runs.runs import Runs

_MAX_WORLDS: Final = 8  # that are listed one by one
_DIGITS: Final = 12  # of a commit or hash
_VERSIONS: Final = ("pycram", "pybullet", "python", "platform")


def run(log: Recording, options: argparse.Namespace) -> int:
    """Print the summary."""
    info = summary(log)
    lines = (f"{name:12} {text}" for name, text in _lines(log, info) if text)
    print_result(lambda: _data(log, info), lines, as_json=options.json)
    return 0


def run_folder(runs: Runs, options: argparse.Namespace) -> int:
    """Print the summary of a folder of recordings."""
    from replay.cli.stats import data, summary_lines  # noqa: PLC0415  what they need is an extra
    from replay.runs.statistics import statistics  # noqa: PLC0415

    stats = statistics(runs)
    print_result(lambda: data(stats), summary_lines(stats), as_json=options.json)
    return 0


def _data(log: Recording, info: Summary) -> dict[str, object]:
    data: dict[str, object] = dataclasses.asdict(info)
    data["start"] = info.start and record_data(info.start)
    worlds = [{"world": each.world, "life": each.lifetime, "seconds": each.seconds} for each in info.worlds]
    missing = data.pop("problems")
    return data | {"worlds": worlds, "missing": missing, "file": str(log.path), "started": info.started.isoformat()}


def _lines(log: Recording, info: Summary) -> list[tuple[str, str]]:
    counts = ", ".join(f"{count} {kind}" for kind, count in info.counts.items())
    complete = "yes" if info.checked else "yes, according to its index (too long to be read whole)"
    return [
        ("file", f"{log.path} ({_size(info.size)})"),
        ("plan", _plan(info)),
        ("parameters", _parameters(info.start)),
        ("sweep", _sweep(info.start)),
        ("origin", _origin(info.start)),
        ("directory", info.start.directory if info.start else ""),
        ("seed", _seed(info.start)),
        ("motion", _motion(info.start)),
        ("revision", _revision(info.start)),
        ("started", f"{info.started:%Y-%m-%d %H:%M:%S} UTC"),
        ("took", f"{info.seconds:.3f} s"),
        ("outcome", info.outcome),
        ("failure", one_line(info.failure)),
        *(("", f"thread {thread} failed: {one_line(failure)}") for thread, failure in info.threads),
        ("steps", f"0 to {info.records - 1}: {counts}"),
        ("worlds", _worlds(info)),
        ("files", f"{info.attachments} attached{_shared(log)}"),
        ("computer", _computer(info.start)),
        ("versions", ", ".join(f"{key} {info.metadata[key]}" for key in _VERSIONS if key in info.metadata)),
        ("repaired", _repair(info)),
        ("complete", f"no: {info.problems}" if info.problems else complete),
    ]


def _repair(info: Summary) -> str:
    by, problems = (info.metadata.get(f"pycram.repair.{key}", "") for key in ("by", "problems"))
    return f"by PyCRAM {by}; before: {problems or 'complete'}" if by else ""


def _plan(info: Summary) -> str:
    given = info.start.arguments if info.start else ()  # older recordings have them as one text
    return " ".join((info.plan, shlex.join(given) or info.metadata.get("plan_arguments", ""))).strip()


def _parameters(start: Run | None) -> str:
    given = start.parameters if start is not None else ()
    return ", ".join(f"{each.name}={each.value_json}" for each in given)


def _sweep(start: Run | None) -> str:
    if start is None or not start.HasField("sweep"):
        return ""
    again = f", at attempt {start.sweep.attempt}" if start.sweep.attempt > 1 else ""
    return f"run {start.sweep.number} of one with seed {start.sweep.seed}{again}"


def _shared(log: Recording) -> str:
    shared = log.assets.shared
    return f", or in {shared.name} beside it" if shared is not None else ""


def _origin(start: Run | None) -> str:
    if start is None or not start.HasField("origin"):
        return ""
    origin = start.origin
    changes = [_change(change, origin.step) for change in origin.changes]
    changed = f", with {', '.join(changes)}" if changes else ""
    return f"forked from {origin.recording} after step {origin.step}{changed}"


def _change(change: Change, step: int) -> str:
    text = change.set or change.answer or f"seed {change.seed}"
    return text if change.step == step else f"{text} after step {change.step}"


def _seed(start: Run | None) -> str:
    if start is None or not start.hash_seed:
        return ""
    seed = start.seed or "none is known"
    sets = "" if seed == start.hash_seed else f"; order of sets: {start.hash_seed}"
    return f"{seed}{sets}{start.order and f'; order of branches: {start.order}'}"


def _motion(start: Run | None) -> str:
    return start.environment if start is not None else ""


def _revision(start: Run | None) -> str:
    if start is None or not start.HasField("pycram"):
        return ""
    named = (("plan", start.plan), ("PyCRAM", start.pycram))
    return ", ".join(f"{name} {_version(revision)}" for name, revision in named if revision.sha256)


def _version(revision: Revision) -> str:
    if not revision.commit:
        return f"sha256 {revision.sha256[:_DIGITS]}"
    changed = f" with changes, sha256 {revision.sha256[:_DIGITS]}" if revision.modified else ""
    return f"{revision.commit[:_DIGITS]}{changed}"


def _computer(start: Run | None) -> str:
    return ", ".join(filter(None, (start.host, start.cpu))) if start is not None else ""


def _worlds(info: Summary) -> str:
    worlds = [
        f"{title(each.world, each.lifetime)}: {each.seconds:.3f} s simulated" for each in info.worlds[:_MAX_WORLDS]
    ]
    if len(info.worlds) > _MAX_WORLDS:
        worlds.append(f"{len(info.worlds) - _MAX_WORLDS} more")
    return ", ".join(worlds)


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count} bytes"
