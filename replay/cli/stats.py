"""``stats``: how often the runs of a folder succeed, of what they fail, and what takes long."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from replay.cli import stats_text
from replay.cli.console import print_message, print_result
from replay.cli.main import FINE
from replay.errors import ReplayError
from replay.runs.statistics import plan_of, statistics

if TYPE_CHECKING:
    import argparse

    from replay.runs.runs import Runs


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
    data, lines = stats_text.data(stats), list(stats_text.lines(stats))
    if options.picture:
        from replay.cli.stats_picture import contact_sheet  # noqa: PLC0415  rendering is an extra

        _write(options.picture, contact_sheet(runs.path, stats))
        data["picture"] = options.picture
        lines += ["", options.picture]
    if options.html:
        from replay.cli.stats_report import report  # noqa: PLC0415  rendering is an extra
        from replay.runs.separation import separate  # noqa: PLC0415

        _write(options.html, report(runs.path, stats, separate(runs, stats.runs), Path(options.html)).encode())
        data["html"] = options.html
        lines += ["", options.html]
    for plan, count in others:
        print_message(f"left out: {count} of another plan, {plan}; stats --plan {plan} tells of them")
    print_result(lambda: data, lines, as_json=options.json)
    return FINE


def _write(file: str, content: bytes) -> None:
    try:
        Path(file).write_bytes(content)
    except OSError as error:
        raise ReplayError(f"{file}: can't be written: {error}") from error
