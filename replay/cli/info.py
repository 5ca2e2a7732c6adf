"""``info``: a summary of a run, or of a folder of recordings."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from recorder.records import Revision, Run
from replay.cli.console import print_result, print_text
from replay.file.lifetimes import title
from replay.history.tasks import Summary, summary
from replay.recording import Recording
from replay.report.phrases import one_line
from replay.state.json_data import record_data

if TYPE_CHECKING:
    from replay.runs.folder import Runs

_MAX_WORLDS: Final = 8  # maximum number of worlds that are listed
_DIGITS: Final = 12  # number of digits of a commit or hash that are shown
_VERSIONS: Final = ("pycram", "pybullet", "python", "platform")


def add(parser: argparse.ArgumentParser) -> None:
    """Suggest no next commands. Only ``pycram-replay LOG`` suggests commands."""
    parser.set_defaults(next_steps=False)


def run(log: Recording, options: argparse.Namespace) -> None:
    info = summary(log)
    lines = (f"{name:12} {text}" for name, text in _rows(log, info) if text)
    print_result(lambda: _data(log, info), lines, as_json=options.json)
    if options.next_steps and not options.json:
        file = shlex.quote(str(log.path))
        verbs = (f"why {file}", f"tree {file}", f"view {file} --at failure")
        if not info.failure:
            verbs = (f"tree {file}", f"log {file}", f"view {file}")
        print_text("\n".join(["", "Next", *(f"  pycram-replay {verb}" for verb in verbs), "  pycram-replay cheat"]))


def run_folder(runs: Runs, options: argparse.Namespace) -> None:
    from replay.cli.stats import data, summary_lines  # noqa: PLC0415  need an extra
    from replay.runs.statistics import statistics  # noqa: PLC0415

    stats = statistics(runs)
    print_result(lambda: data(stats), summary_lines(stats), as_json=options.json)


def _data(log: Recording, info: Summary) -> dict[str, object]:
    data: dict[str, object] = dataclasses.asdict(info)
    data["start"] = info.start and record_data(info.start)
    worlds = [{"world": each.world, "life": each.lifetime, "seconds": each.seconds} for each in info.worlds]
    missing = data.pop("problems")
    return data | {"worlds": worlds, "missing": missing, "file": str(log.path), "started": info.started.isoformat()}


def _rows(log: Recording, info: Summary) -> Iterator[tuple[str, str]]:
    """Yield the names of facts, and their texts. The text of a fact that isn't recorded is empty."""
    start, metadata = info.start or Run(), info.metadata
    yield "file", f"{log.path} ({f'{info.size / 1e6:.1f} MB' if info.size >= 1e5 else f'{info.size} bytes'})"
    # recordings of older releases have a text of all arguments
    given = shlex.join(start.arguments) or metadata.get("plan_arguments", "")
    yield "plan", f"{info.plan} {given}".strip()
    yield "parameters", ", ".join(f"{each.name}={each.value_json}" for each in start.parameters)
    if start.HasField("sweep"):
        again = f", at attempt {start.sweep.attempt}" if start.sweep.attempt > 1 else ""
        yield "sweep", f"run {start.sweep.number} of a sweep with seed {start.sweep.seed}{again}"
    if start.HasField("origin"):
        yield "origin", _origin(start)
    yield "directory", start.directory
    if start.hash_seed:
        seed = start.seed or "unknown"
        sets = "" if seed == start.hash_seed else f"; order of sets: {start.hash_seed}"
        yield "seed", f"{seed}{sets}{start.order and f'; order of branches: {start.order}'}"
    yield "motion", start.environment
    if start.HasField("pycram"):
        named = (("plan", start.plan), ("PyCRAM", start.pycram))
        yield "revision", ", ".join(f"{name} {_version(revision)}" for name, revision in named if revision.sha256)
    yield "started", f"{info.started:%Y-%m-%d %H:%M:%S} UTC"
    yield "took", f"{info.seconds:.3f} s"
    yield "outcome", info.outcome
    yield "failure", one_line(info.failure)
    for thread, failure in info.threads:
        yield "", f"thread {thread} failed: {one_line(failure)}"
    yield "steps", f"0 to {info.records - 1}: {', '.join(f'{count} {kind}' for kind, count in info.counts.items())}"
    worlds = [f"{title(each.world, each.lifetime)}: {each.seconds:.3f} s simulated" for each in info.worlds]
    if len(worlds) > _MAX_WORLDS:
        worlds[_MAX_WORLDS:] = [f"{len(worlds) - _MAX_WORLDS} more"]
    yield "worlds", ", ".join(worlds)
    shared = log.assets.shared
    yield (
        "files",
        f"{info.attachments} attached" + (f", or in {shared.name} in the same folder" if shared is not None else ""),
    )
    yield "computer", ", ".join(filter(None, (start.host, start.cpu)))
    yield "versions", ", ".join(f"{key} {metadata[key]}" for key in _VERSIONS if key in metadata)
    if repaired_by := metadata.get("pycram.repair.by", ""):
        problems = metadata.get("pycram.repair.problems") or "none"
        yield "repaired", f"by PyCRAM {repaired_by}; problems before the repair: {problems}"
    complete = "yes" if info.checked else "yes, according to its index (the recording is too long to read completely)"
    yield "complete", f"no: {info.problems}" if info.problems else complete


def _origin(start: Run) -> str:
    origin, changes = start.origin, []
    for change in origin.changes:
        text = change.set or change.answer or f"seed {change.seed}"
        changes.append(text if change.step == origin.step else f"{text} after step {change.step}")
    changed = f", with {', '.join(changes)}" if changes else ""
    return f"forked from {origin.recording} after step {origin.step}{changed}"


def _version(revision: Revision) -> str:
    if not revision.commit:
        return f"sha256 {revision.sha256[:_DIGITS]}"
    changed = f" with changes, sha256 {revision.sha256[:_DIGITS]}" if revision.modified else ""
    return f"{revision.commit[:_DIGITS]}{changed}"
