"""``stats``: how often the runs of a folder succeed, why they fail, and what takes long."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.cli.console import print_message, print_result
from replay.cli.main import FINE
from replay.errors import ReplayError
from replay.report.phrases import one_line, percent, plural, short
from replay.runs.statistics import plan_of, statistics

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from replay.runs.runs import Runs
    from replay.runs.statistics import Slow, Statistics


_MAX_CAUSES: Final = 10
_MAX_SLOW: Final = 5


def add(parser: argparse.ArgumentParser) -> None:
    """Add the plan, and what else to write."""
    parser.add_argument("--plan", metavar="NAME", help="of this plan's runs (default: of the plan that most are of)")
    parser.add_argument("--html", metavar="FILE", help="write a report with plots and pictures, one file")
    parser.add_argument(
        "--picture", metavar="FILE", help="write the last moments of the failures of each cause, as PNG"
    )


def run_folder(runs: Runs, options: argparse.Namespace) -> int:
    """Print the statistics, and write the report and the picture."""
    chosen, others = plan_of(runs, options.plan)
    if options.plan and options.plan not in {each for (each,) in runs.sql("SELECT DISTINCT plan FROM runs").rows()}:
        raise ReplayError(f"{runs.path} has no run of {options.plan!r}; it has {', '.join(each for each, _ in others)}")
    stats = statistics(runs, chosen)
    facts, text = data(stats), list(lines(stats))
    if options.picture:
        from replay.cli.stats_report import contact_sheet  # noqa: PLC0415  rendering is an extra

        _write(options.picture, contact_sheet(runs.path, stats))
        facts["picture"] = options.picture
        text += ["", options.picture]
    if options.html:
        from replay.cli.stats_report import report  # noqa: PLC0415  rendering is an extra
        from replay.runs.separation import separate  # noqa: PLC0415

        _write(options.html, report(runs.path, stats, separate(runs, stats.runs), Path(options.html)).encode())
        facts["html"] = options.html
        text += ["", options.html]
    for plan, count in others:
        print_message(f"left out: {count} of another plan, {plan}; stats --plan {plan} tells of them")
    print_result(lambda: facts, text, as_json=options.json)
    return FINE


def _write(file: str, content: bytes) -> None:
    try:
        Path(file).write_bytes(content)
    except OSError as error:
        raise ReplayError(f"{file}: can't be written: {error}") from error


def data(stats: Statistics) -> dict[str, object]:
    """Return statistics as JSON data, with the intervals of rates."""
    facts = dataclasses.asdict(stats)
    facts["success"] |= {"interval": stats.success.interval}
    facts["parameters"] = {
        name: [dataclasses.asdict(share) | {"interval": share.interval} for share in shares]
        for name, shares in stats.parameters
    }
    facts["outcomes"], facts["others"] = dict(stats.outcomes), dict(stats.others)
    return facts


def summary_lines(stats: Statistics) -> Iterator[str]:
    """Yield the plan, the number of runs and their outcomes as text."""
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in stats.outcomes)
    median, longest = stats.seconds
    yield f"folder     {stats.folder} ({stats.size / 1e6:.1f} MB)"
    yield f"plan       {stats.plan or 'none'}"
    yield f"runs       {plural(len(stats.runs), 'run')}: {outcomes}" if stats.runs else "runs       none"
    yield f"success    {stats.success}"
    yield f"took       {median:.2f} s in the middle, {longest:.2f} s at most"
    yield f"records    {stats.records}"
    if stats.others:
        others = ", ".join(f"{plural(count, 'run')} of {plan}" for plan, count in stats.others)
        yield f"left out   {others}"
    if stats.skipped:
        yield f"left out   {plural(len(stats.skipped), 'file')}"


def lines(stats: Statistics) -> Iterator[str]:
    """Yield statistics as text."""
    yield from summary_lines(stats)
    for name, shares in stats.parameters:
        yield from ("", f"By {name}")
        width = max(len(share.what) for share in shares)
        yield from (f"  {share.what:{width}}  {share}" for share in shares)
    if stats.causes:
        yield from ("", "Failures by cause")
    for cause in stats.causes[:_MAX_CAUSES]:
        yield f"  {plural(cause.count, 'run')}, {percent(cause.share)}: {cause.cause}"
        yield f"    first: {one_line(short(cause.message))}"
        yield f"    pycram-replay why {shlex.quote(f'{stats.folder}/{cause.first}')}"
    if len(stats.causes) > _MAX_CAUSES:
        yield f"  {plural(len(stats.causes) - _MAX_CAUSES, 'more cause')}"
    yield from _slow("Queries that took longest", stats.queries)
    yield from _slow("Motions that took longest", stats.motions)
    yield from _slow("Other tasks that took longest", stats.tasks)


def _slow(title: str, slow: Sequence[Slow]) -> Iterator[str]:
    if not slow:
        return
    yield from ("", title)
    width = max(len(short(each.what)) for each in slow[:_MAX_SLOW])
    for each in slow[:_MAX_SLOW]:
        total = f"{each.total:.3f} s in {each.count}, {each.median * 1e3:.1f} ms in the middle"
        longest = f"at most {each.longest * 1e3:.1f} ms at step {each.step} of {each.run}"
        yield f"  {short(each.what):{width}}  {total}, {longest}"
