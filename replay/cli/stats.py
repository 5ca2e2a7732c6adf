"""``stats``: success rates of the runs of a folder, causes of failures, and slow queries, motions and tasks.

``--html`` writes a report as a single file: pictures are embedded, plots are SVG, and a short script sorts the tables.
A picture shows the scene at the step at which a failure began.
"""

from __future__ import annotations

import base64
import dataclasses
import io
import os
import shlex
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

from replay.cli.console import print_message, print_result
from replay.cli.main import FINE
from replay.errors import ReplayError
from replay.recording import Recording
from replay.report.phrases import one_line, percent, plural, short
from replay.runs.statistics import plan_of, statistics

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator, Sequence

    from PIL import Image

    from replay.runs.folder import Runs
    from replay.runs.separation import Separation
    from replay.runs.statistics import FailureCause, Share, Slow, Statistics


_MAX_CAUSES: Final = 10
_MAX_SLOW: Final = 5
_SIZE: Final = (320, 240)
_COLUMNS: Final = 4
_MAX_PICTURES: Final = 12
_CAPTION: Final = 34  # height in pixels below a picture
_LETTERS: Final = 52  # largest number of letters in a line of a caption
_PICTURES: Final = 8  # largest number of causes with a picture
_LABEL: Final = 22  # largest number of characters of a label next to a bar
_CLAIMS: Final = 10
_WIDE, _BAR = 420, 22  # sizes of a bar in pixels

_STYLE: Final = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem; color: #1c2430; }
h1 { font-size: 1.5rem; }
h2 { font-size: 1.15rem; margin-top: 2.2rem; border-bottom: 1px solid #d5dbe3; }
table { border-collapse: collapse; margin: .6rem 0; width: 100%; }
td, th { padding: .25rem .6rem; text-align: left; vertical-align: top; }
tr:nth-child(even) td { background: #f5f7fa; }
th { cursor: pointer; background: #e8edf3; user-select: none; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
code { font-size: .85em; overflow-wrap: anywhere; }
.big { font-size: 2rem; font-weight: 600; }
.gray { color: #66707f; }
figure { display: inline-block; margin: .4rem .6rem .4rem 0; width: 320px; vertical-align: top; }
figure img { width: 320px; border: 1px solid #d5dbe3; }
figcaption { font-size: .8rem; overflow-wrap: anywhere; }
"""
_SCRIPT: Final = """
document.querySelectorAll("th").forEach(head => head.addEventListener("click", () => {
  const table = head.closest("table"), at = [...head.parentNode.children].indexOf(head);
  const down = head.dataset.sorted !== "down";
  const key = row => row.children[at].dataset.value ?? row.children[at].textContent;
  const rows = [...table.tBodies[0].rows].sort((a, b) => {
    const x = key(a), y = key(b), n = Number(x) - Number(y);
    return (Number.isNaN(n) ? x.localeCompare(y) : n) * (down ? -1 : 1);
  });
  table.querySelectorAll("th").forEach(each => delete each.dataset.sorted);
  head.dataset.sorted = down ? "down" : "up";
  table.tBodies[0].append(...rows);
}));
"""


def add(parser: argparse.ArgumentParser) -> None:
    """Add the plan, the report and the picture."""
    parser.add_argument("--plan", metavar="NAME", help="only runs of this plan (default: the plan with the most runs)")
    parser.add_argument("--html", metavar="FILE", help="write a report with plots and pictures, as a single file")
    parser.add_argument("--picture", metavar="FILE", help="write a picture for each cause of failures into a PNG file")


def run_folder(runs: Runs, options: argparse.Namespace) -> int:
    """Print the statistics, and write the report and the picture."""
    chosen, others = plan_of(runs, options.plan)
    if options.plan and options.plan not in {each for (each,) in runs.sql("SELECT DISTINCT plan FROM runs").rows()}:
        raise ReplayError(f"{runs.path} has no run of {options.plan!r}; it has {', '.join(each for each, _ in others)}")
    stats = statistics(runs, chosen)
    facts, text = data(stats), list(lines(stats))
    if options.picture:
        _write(options.picture, contact_sheet(runs.path, stats))
        facts["picture"] = options.picture
        text += ["", options.picture]
    if options.html:
        from replay.runs.separation import separate  # noqa: PLC0415

        _write(options.html, html_report(runs.path, stats, separate(runs, stats.runs), Path(options.html)).encode())
        facts["html"] = options.html
        text += ["", options.html]
    for plan, count in others:
        print_message(f"left out: {count} runs of another plan, {plan}; see stats --plan {plan}")
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
    """Return the page; its links are relative to ``file``, where the page will be written."""
    links = quote(os.path.relpath(folder.resolve(), file.resolve().parent))
    parts = [
        f"<h1>{escape(stats.plan)}: {len(stats.runs)} runs</h1>",
        _summary(stats),
        *(f"<h2>Success by {escape(name)}</h2>{_shares(shares)}" for name, shares in stats.parameters),
        "<h2>What separates failures from successes</h2>",
        _claims(folder, found),
        "<h2>Failures by cause</h2>",
        _cause_table(folder, stats.causes, links),
        "<h2>Pictures of failures</h2>",
        "".join(_figure(folder, cause, links) for cause in stats.causes[:_PICTURES]) or "<p>No run failed.</p>",
        *(
            f"<h2>Slowest {title}</h2>{_slow_table(folder, slow)}"
            for title, slow in (("queries", stats.queries), ("motions", stats.motions), ("other tasks", stats.tasks))
            if slow
        ),
    ]
    title = escape(f"{stats.plan}: {len(stats.runs)} runs")
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head>"
        f"<body>{''.join(parts)}<script>{_SCRIPT}</script></body></html>\n"
    )


def _summary(stats: Statistics) -> str:
    low, high = stats.success.interval
    rate = f"{stats.success.succeeded / stats.success.of:.1%}" if stats.success.of else "no run ended"
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in stats.outcomes)
    left_out = [f"{count} of plan {plan}" for plan, count in stats.others]
    left_out += [f"{each.name} ({each.reason})" for each in stats.skipped]
    count = f"{stats.success.succeeded} of {stats.success.of}"
    size = f"{stats.size / 1e6:.1f} MB, {stats.records} records"
    took = f"a run took {stats.seconds[0]:.2f} s (median), at most {stats.seconds[1]:.2f} s"
    lines = [
        f'<p><span class="big">{rate}</span> succeeded, {count} (95 %: {low:.1%} to {high:.1%})</p>',
        f'<p class="gray">{escape(stats.folder)}: {escape(outcomes)}; {size}; {took}</p>',
    ]
    if left_out:
        lines.append(f'<p class="gray">Left out: {escape(", ".join(left_out))}</p>')
    return "".join(lines)


def _shares(shares: Sequence[Share]) -> str:
    """Return a plot with a bar and an interval for each share of successes."""
    rows = []
    for at, share in enumerate(shares):
        low, high = share.interval
        y, rate = at * (_BAR + 8), share.succeeded / share.of if share.of else 0.0
        middle = y + _BAR / 2
        rows.append(
            f'<text x="150" y="{middle + 5}" text-anchor="end">{_short(share.what)}</text>'
            f'<rect x="160" y="{y}" width="{_WIDE}" height="{_BAR}" fill="#e8edf3"/>'
            f'<rect x="160" y="{y}" width="{rate * _WIDE:.1f}" height="{_BAR}" fill="#4f8f6b"/>'
            f'<line x1="{160 + low * _WIDE:.1f}" x2="{160 + high * _WIDE:.1f}" y1="{middle}" y2="{middle}" '
            'stroke="#1c2430" stroke-width="2"/>'
            f'<text x="{170 + _WIDE}" y="{middle + 5}">{rate:.0%}, {share.succeeded} of {share.of}</text>'
        )
    height = len(shares) * (_BAR + 8)
    # the scale of the bars, and the meaning of the lines
    rows.append(f'<text x="160" y="{height + 10}" fill="#667" font-size="11">0 to 100 %; lines: 95 % intervals</text>')
    height += 14
    return (
        f'<svg viewBox="0 0 780 {height}" width="780" height="{height}" font-size="13" role="img">{"".join(rows)}</svg>'
    )


def _short(text: str) -> str:
    """Return a text, shortened to the label's width; the whole text is its tooltip."""
    if len(text) <= _LABEL:
        return escape(text)
    return f"{escape(text[: _LABEL - 1])}…<title>{escape(text)}</title>"


def _claims(folder: Path, found: Separation) -> str:
    from replay.cli.separate import HOW_FAR  # noqa: PLC0415

    if not found.claims:
        return "<p>No recorded fact separates them.</p>"
    rows = []
    for claim in found.claims[:_CLAIMS]:
        fact = claim.fact
        low, high = fact.interval
        remarks = [HOW_FAR] if fact.how_far else []
        remarks += [f"true of the same runs: {'; '.join(claim.also)}"] if claim.also else []
        also = "".join(f'<br><span class="gray">{escape(each)}</span>' for each in remarks)
        compare = _command("diff", folder / claim.failure, folder / claim.success) if claim.success else ""
        rows.append(
            (
                f"{escape(fact.text)}{also}",
                (fact.failed, f"{fact.failed} of {found.failures}"),
                (fact.succeeded, f"{fact.succeeded} of {found.successes}"),
                (fact.effect, f"+{fact.effect:.0%} ({low:.0%} to {high:.0%})"),
                (claim.ochiai, f"{claim.ochiai:.2f}"),
                (fact.tarantula, f"{fact.tarantula:.2f}"),
                compare,
            )
        )
    heads = ("fact", "#failures", "#successes", "#effect (95 %)", "#Ochiai", "#Tarantula", "compare")
    return _table(heads, rows)


def _cause_table(folder: Path, causes: Sequence[FailureCause], links: str) -> str:
    if not causes:
        return "<p>No run failed.</p>"
    most = causes[0].count
    rows: list[Sequence[str | tuple[float, str]]] = []
    for cause in causes:
        commands = (_command(verb, folder / cause.first) for verb in ("why", "view"))
        first = "<br>".join((_link(links, cause.first), escape(cause.message[:300]), *commands))
        bar = f'<rect width="{cause.count / most * _WIDE:.1f}" height="8" fill="#b5534a"/>'
        what = f'{escape(cause.cause)}<br><svg width="{_WIDE}" height="8">{bar}</svg>'
        rows.append((what, (cause.count, str(cause.count)), (cause.share, f"{cause.share:.0%}"), first))
    return _table(("cause", "#runs", "#share", "first"), rows)


def _figure(folder: Path, cause: FailureCause, links: str) -> str:
    drawn = picture(folder, cause.first, cause.step)
    if drawn is None:
        return ""
    data = base64.b64encode(png(drawn)).decode()
    step = f" --at {cause.step}" if cause.step is not None else ""
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{escape(cause.cause)}">'
        f"<figcaption>{_link(links, cause.first)}: "
        f"{escape(cause.cause)}<br>{_command('view', folder / cause.first, step)}</figcaption></figure>"
    )


def _slow_table(folder: Path, slow: Sequence[Slow]) -> str:
    rows = [
        (
            escape(each.what),
            (each.count, str(each.count)),
            (each.total, f"{each.total:.3f}"),
            (each.median, f"{each.median * 1e3:.1f}"),
            (each.longest, f"{each.longest * 1e3:.1f}"),
            _command("view", folder / each.run, f" --at {each.step}"),
        )
        for each in slow
    ]
    return _table(("task", "#calls", "#total, s", "#median, ms", "#maximum, ms", "slowest call"), rows)


def _table(heads: Iterable[str], rows: Iterable[Sequence[str | tuple[float, str]]]) -> str:
    """Return a table. If a column's head begins with #, the column contains numbers, by which it is sorted."""
    head = "".join(f'<th class="n">{name[1:]}</th>' if name.startswith("#") else f"<th>{name}</th>" for name in heads)
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(cell: str | tuple[float, str]) -> str:
    return f"<td>{cell}</td>" if isinstance(cell, str) else f'<td class="n" data-value="{cell[0]!r}">{cell[1]}</td>'


def _link(links: str, run: str) -> str:
    return f'<a href="{links}/{quote(run)}">{escape(run)}</a>'


def _command(verb: str, *rest: Path | str) -> str:
    words = "".join(f" {shlex.quote(str(each))}" if not isinstance(each, str) else each for each in rest)
    return f"<code>pycram-replay {verb}{escape(words)}</code>"


def picture(folder: Path, run: str, step: int | None) -> Image.Image | None:
    """Return a picture of a run at a step, by default at the run's end; None if it can't be drawn."""
    with Recording(folder / run) as log:
        try:
            return log.render(log.final_step() if step is None else step, size=_SIZE)
        except ReplayError:  # no world was open, or a model is lost: the other pictures matter more
            return None


def contact_sheet(folder: Path, stats: Statistics) -> bytes:
    """Return a sheet (PNG) with pictures of the first failures of each cause."""
    from PIL import Image, ImageDraw  # noqa: PLC0415  an extra

    chosen = list(_pictured(stats.causes))
    rows = max(1, -(-len(chosen) // _COLUMNS))
    width, height = _SIZE[0], _SIZE[1] + _CAPTION
    sheet = Image.new("RGB", (min(_COLUMNS, max(1, len(chosen))) * width, rows * height), "white")
    draw = ImageDraw.Draw(sheet)
    for at, (cause, run, step) in enumerate(chosen):
        left, top = at % _COLUMNS * width, at // _COLUMNS * height
        drawn = picture(folder, run, step)
        if drawn is not None:
            sheet.paste(drawn.convert("RGB"), (left, top))
        draw.text((left + 4, top + _SIZE[1] + 2), run[:_LETTERS], fill="black")
        draw.text((left + 4, top + _SIZE[1] + 16), cause.cause[:_LETTERS], fill="black")
    if not chosen:
        draw.text((4, 4), "no run failed", fill="black")
    return png(sheet)


def png(image: Image.Image) -> bytes:
    """Return a picture as PNG."""
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


def _pictured(causes: tuple[FailureCause, ...]) -> Iterator[tuple[FailureCause, str, int | None]]:
    """Yield the failures with a picture: the first failure of each cause, then the second failures, and so on."""
    shown = 0
    for at in range(_MAX_PICTURES):
        for cause in causes:
            if at < len(cause.runs) and shown < _MAX_PICTURES:
                shown += 1
                yield cause, cause.runs[at], cause.steps[at]
