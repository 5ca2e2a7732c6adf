"""``stats``: success rates of the runs of a folder, causes of failures, and slow queries, motions and tasks.

``--html`` writes a report as a single file. A picture shows the scene at the step at which a failure began.
"""

from __future__ import annotations

import argparse
import io
import os
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

from replay.cli.console import print_message, print_result
from replay.errors import ReplayError
from replay.recording import Recording
from replay.report import report
from replay.report.phrases import one_line, percent, plural, short
from replay.report.report import embedded, page, write
from replay.runs.statistics import FailureCause, Slow, Statistics, plan_of, statistics

if TYPE_CHECKING:
    from PIL import Image

    from replay.runs.folder import Runs
    from replay.runs.separation import Separation

_MAX_CAUSES: Final = 10
_MAX_SLOW: Final = 5
_SIZE: Final = (320, 240)
_COLUMNS: Final = 4
_MAX_PICTURES: Final = 12
_CAPTION: Final = 34  # height in pixels of a caption
_LETTERS: Final = 52  # maximum number of letters in a line of a caption
_PICTURES: Final = 8  # maximum number of causes that have a picture
_CLAIMS: Final = 10


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--plan", metavar="NAME", help="only runs of this plan (default: the plan with the most runs)")
    parser.add_argument("--html", metavar="FILE", help="write a report with plots and pictures into a single file")
    parser.add_argument("--picture", metavar="FILE", help="write a picture for each cause of failures into a PNG file")


def run_folder(runs: Runs, options: argparse.Namespace) -> None:
    chosen, others = plan_of(runs, options.plan)
    if options.plan and options.plan not in {each for (each,) in runs.sql("SELECT DISTINCT plan FROM runs").rows()}:
        raise ReplayError(f"{runs.path} has no run of {options.plan!r}; it has {', '.join(each for each, _ in others)}")
    stats = statistics(runs, chosen)
    facts, text = data(stats), list(lines(stats))
    if options.picture:
        write(options.picture, contact_sheet(runs.path, stats))
        facts["picture"] = options.picture
        text += ["", options.picture]
    if options.html:
        from replay.runs.separation import separate  # noqa: PLC0415

        write(options.html, html_report(runs.path, stats, separate(runs, stats.runs), Path(options.html)).encode())
        facts["html"] = options.html
        text += ["", options.html]
    for plan, count in others:
        print_message(f"left out: {count} runs of another plan, {plan}; see stats --plan {plan}")
    print_result(lambda: facts, text, as_json=options.json)


def data(stats: Statistics) -> dict[str, object]:
    """Return statistics as JSON data, with the intervals of rates."""
    pairs = {"parameters": stats.parameters, "outcomes": stats.outcomes, "others": stats.others}
    return report.fields_data(stats) | {name: report.data(dict(each)) for name, each in pairs.items()}


def summary_lines(stats: Statistics) -> Iterator[str]:
    """Yield the plan, the number of runs and their outcomes as text."""
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in stats.outcomes)
    median, longest = stats.seconds
    yield f"folder     {stats.folder} ({stats.size / 1e6:.1f} MB)"
    yield f"plan       {stats.plan or 'none'}"
    yield f"runs       {plural(len(stats.runs), 'run')}: {outcomes}" if stats.runs else "runs       none"
    yield f"success    {stats.success}"
    yield f"took       median {median:.2f} s, at most {longest:.2f} s"
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
    yield from _slow("Slowest queries", stats.queries)
    yield from _slow("Slowest motions", stats.motions)
    yield from _slow("Slowest other tasks", stats.tasks)


def _slow(title: str, slow: Sequence[Slow]) -> Iterator[str]:
    if not slow:
        return
    yield from ("", title)
    width = max(len(short(each.what)) for each in slow[:_MAX_SLOW])
    for each in slow[:_MAX_SLOW]:
        total = f"{each.total:.3f} s in {each.count} calls, median {each.median * 1e3:.1f} ms"
        longest = f"at most {each.longest * 1e3:.1f} ms at step {each.step} of {each.run}"
        yield f"  {short(each.what):{width}}  {total}, {longest}"


def html_report(folder: Path, stats: Statistics, found: Separation, file: Path) -> str:
    """Return the page of the report. Links in the page are relative to the report's path ``file``."""
    links = quote(os.path.relpath(folder.resolve(), file.resolve().parent))
    success, left_out = stats.success, [f"{count} of plan {plan}" for plan, count in stats.others]
    left_out += [f"{each.name} ({each.reason})" for each in stats.skipped]
    low, high = success.interval
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in stats.outcomes)
    took = f"a run took {stats.seconds[0]:.2f} s (median), at most {stats.seconds[1]:.2f} s"
    return page(
        "runs.html",
        title=f"{stats.plan}: {len(stats.runs)} runs",
        rate=f"{success.succeeded / success.of:.1%}" if success.of else "no run ended",
        success=f"succeeded, {success.succeeded} of {success.of} (95 %: {low:.1%} to {high:.1%})",
        facts=f"{stats.folder}: {outcomes}; {stats.size / 1e6:.1f} MB, {stats.records} records; {took}",
        left_out=", ".join(left_out),
        parameters=stats.parameters,
        claims=[*_claims(folder, found)],
        causes=[
            (cause.cause, _cell(cause.count), _cell(f"{cause.share:.0%}", cause.share), _first(folder, cause, links))
            for cause in stats.causes
        ],
        figures=[figure for cause in stats.causes[:_PICTURES] for figure in _figures(folder, cause, links)],
        slow=[
            (name, [*_slow_rows(folder, slow)])
            for name, slow in (("queries", stats.queries), ("motions", stats.motions), ("other tasks", stats.tasks))
            if slow
        ],
    )


def _claims(folder: Path, found: Separation) -> Iterator[Sequence[object]]:
    from replay.cli.separate import HOW_FAR  # noqa: PLC0415

    for claim in found.claims[:_CLAIMS]:
        fact = claim.fact
        low, high = fact.interval
        remarks = [HOW_FAR] if fact.how_far else []
        remarks += [f"true of the same runs: {'; '.join(claim.also)}"] if claim.also else []
        yield (
            f"{fact.text} ({'; '.join(remarks)})" if remarks else fact.text,
            _cell(f"{fact.failed} of {found.failures}", fact.failed),
            _cell(f"{fact.succeeded} of {found.successes}", fact.succeeded),
            _cell(f"+{fact.effect:.0%} ({low:.0%} to {high:.0%})", fact.effect),
            _cell(f"{claim.ochiai:.2f}", claim.ochiai),
            _cell(f"{fact.tarantula:.2f}", fact.tarantula),
            _command("diff", folder / claim.failure, folder / claim.success) if claim.success else "",
        )


def _first(folder: Path, cause: FailureCause, links: str) -> dict[str, object]:
    return {
        "link": f"{links}/{quote(cause.first)}",
        "text": cause.first,
        "more": cause.message[:300],
        "commands": [_command(verb, folder / cause.first) for verb in ("why", "view")],
    }


def _figures(folder: Path, cause: FailureCause, links: str) -> Iterator[dict[str, str]]:
    drawn = picture(folder, cause.first, cause.step)
    if drawn is not None:
        at = f" --at {cause.step}" if cause.step is not None else ""
        yield {
            "picture": embedded(drawn),
            "cause": cause.cause,
            "run": cause.first,
            "link": f"{links}/{quote(cause.first)}",
            "command": _command("view", folder / cause.first) + at,
        }


def _slow_rows(folder: Path, slow: Sequence[Slow]) -> Iterator[Sequence[object]]:
    for each in slow:
        yield (
            each.what,
            _cell(each.count),
            _cell(f"{each.total:.3f}", each.total),
            _cell(f"{each.median * 1e3:.1f}", each.median),
            _cell(f"{each.longest * 1e3:.1f}", each.longest),
            _command("view", folder / each.run) + f" --at {each.step}",
        )


def _cell(text: object, value: float | None = None) -> dict[str, object]:
    """Return a table's cell; its column is sorted by the values of the cells, which are numbers."""
    return {"text": text, "value": text if value is None else value}


def _command(verb: str, *files: Path) -> str:
    return " ".join(("pycram-replay", verb, *(shlex.quote(str(file)) for file in files)))


def picture(folder: Path, run: str, step: int | None) -> Image.Image | None:
    """Return a picture of a run at a step, by default at the end. If no picture can be drawn, return None."""
    with Recording(folder / run) as log:
        try:
            return log.render(log.final_step() if step is None else step, size=_SIZE)
        except ReplayError:  # no world is open at the step, or the recording lacks a model
            return None


def contact_sheet(folder: Path, stats: Statistics) -> bytes:
    """Return a PNG sheet with pictures of the first failures of each cause."""
    from PIL import Image, ImageDraw  # noqa: PLC0415  an extra

    # the first failure of each cause, then the second failures, and so on
    turns = [(each, at) for at in range(_MAX_PICTURES) for each in stats.causes if at < len(each.runs)]
    chosen = turns[:_MAX_PICTURES]
    rows = max(1, -(-len(chosen) // _COLUMNS))
    width, height = _SIZE[0], _SIZE[1] + _CAPTION
    sheet = Image.new("RGB", (min(_COLUMNS, max(1, len(chosen))) * width, rows * height), "white")
    draw = ImageDraw.Draw(sheet)
    for place, (cause, at) in enumerate(chosen):
        left, top = place % _COLUMNS * width, place // _COLUMNS * height
        drawn = picture(folder, cause.runs[at], cause.steps[at])
        if drawn is not None:
            sheet.paste(drawn.convert("RGB"), (left, top))
        draw.text((left + 4, top + _SIZE[1] + 2), cause.runs[at][:_LETTERS], fill="black")
        draw.text((left + 4, top + _SIZE[1] + 16), cause.cause[:_LETTERS], fill="black")
    if not chosen:
        draw.text((4, 4), "no run failed", fill="black")
    file = io.BytesIO()
    sheet.save(file, "PNG", optimize=True)
    return file.getvalue()
