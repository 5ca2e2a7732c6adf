"""The task tree as a graph for Graphviz, and as an SVG that shows beside the tree when each task ran.

The SVG's lines are those of the text, without the plan's output. Right of them is time by the clock; what ran side by
side lies one above the other. Hovering over a task shows all of it.
"""

from __future__ import annotations

from collections import defaultdict
from functools import partial
from html import escape as escape_quotes
from operator import attrgetter
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import format_failure
from recorder.tasks.node import State, walk
from recorder.tasks.tree_text import label, rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from recorder.tasks.node import Moment, Node
    from recorder.tasks.tree_text import Row

COLORS: Final = defaultdict(
    lambda: "#707070",  # of what a newer release knows
    {
        State.SUCCEEDED: "#2e9e5b",
        State.FAILED: "#d0342c",
        State.CANCELLED: "#9a9a9a",
        State.RUNNING: "#2f6fd0",
        State.CREATED: "#d9a400",
    },
)
_ROW: Final = 20  # height of a line, px
_INDENT: Final = 16
_NAMES: Final = 520  # width of the names' column
_BARS: Final = 560  # width of the times' column
_TOP: Final = 44
_LETTER: Final = 6.6  # width of a letter at the names' size
_Clock: TypeAlias = "Callable[[Moment], int]"
_escape = partial(escape_quotes, quote=False)


def dot(roots: Sequence[Node], failure_path: Sequence[Node]) -> str:
    """The tree for Graphviz: ``dot -Tsvg``; see :func:`recorder.tasks.tree_text.rows`."""
    failing = {node.id for node in failure_path}
    out = ["digraph tasks {", '  node [shape=box, style="rounded,filled", fontname="sans-serif", fontsize=10];']
    for _, node in walk(roots):
        text = f"{label(node)}\n{_outcome(node)}"
        width = 3 if node.id in failing else 1
        out.append(
            f"  t{node.id} [label={_quoted(text)}, color={_quoted(COLORS[node.status])}, penwidth={width}, "
            'fillcolor="white"];'
        )
        if node.parent is not None:
            out.append(f"  t{node.parent.id} -> t{node.id};")
    return "\n".join([*out, "}"]) + "\n"


def svg(roots: Sequence[Node], failure_path: Sequence[Node], depth: int | None = None, *, whole: bool = False) -> str:
    """The tree and its times as an SVG document; see :func:`recorder.tasks.tree_text.rows`."""
    shown = list(rows(roots, failure_path, depth, whole=whole))
    moments = [node.created for _, node in walk(roots)]
    moments += [node.end for _, node in walk(roots) if node.end is not None]
    steady = all(moment.monotonic_ns for moment in moments)  # the wall clock may be set while a plan runs
    clock: _Clock = attrgetter("monotonic_ns" if steady else "wall_ns")
    times = [clock(moment) for moment in moments]
    begin, end = (min(times), max(times)) if times else (0, 1)
    height = _TOP + _ROW * len(shown) + 12
    size = f'width="{_NAMES + _BARS + 30}" height="{height}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="DejaVu Sans, sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="white"/>',
        *_axis((end - begin) / 1e9, height),
    ]
    for number, row in enumerate(shown):
        parts += _drawn(row, _TOP + _ROW * number, clock, begin, max(end - begin, 1))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _axis(seconds: float, height: int) -> Iterator[str]:
    units = (1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9)  # times are 64 bits of nanoseconds: 9e9 s
    steps = (size * unit for unit in units for size in (1, 2, 5, 10, 20, 50, 100, 200, 500))
    step = next(length for length in steps if seconds / length <= 6)
    yield f'<text x="12" y="24" fill="#555">task</text><text x="{_NAMES}" y="16" fill="#555">time by the clock</text>'
    for number in range(int(seconds / step) + 1):
        x = _NAMES + _BARS * number * step / seconds if seconds else float(_NAMES)
        yield f'<line x1="{x:.1f}" y1="{_TOP - 8}" x2="{x:.1f}" y2="{height - 8}" stroke="#e4e4e4"/>'
        yield f'<text x="{x:.1f}" y="{_TOP - 12}" fill="#555" font-size="9">{number * step:g} s</text>'


def _drawn(row: Row, top: int, clock: _Clock, begin: int, length: int) -> Iterator[str]:
    x = 12 + _INDENT * row.depth
    room = max(8, int((_NAMES - x - 24) / _LETTER))
    text = row.text if len(row.text) <= room else row.text[: room - 1] + "\u2026"
    node = row.node
    if node is None:
        color = "#b02a24" if ": " in row.text else "#777"
        yield f'<text x="{x}" y="{top + 14}" fill="{color}" font-style="italic">{_escape(text)}</text>'
        return
    color = COLORS[node.status]
    yield f"<g><title>{_escape(_details(node))}</title>"
    if row.failing:
        yield f'<rect x="0" y="{top}" width="100%" height="{_ROW}" fill="#fdeceb"/>'
    yield f'<circle cx="{x + 4}" cy="{top + 10}" r="4" fill="{color}"/>'
    weight = ' font-weight="bold"' if row.failing else ""
    yield f'<text x="{x + 14}" y="{top + 14}" fill="#222"{weight}>{_escape(text)}</text>'
    start = node.start or node.created
    stop = clock(node.end) if node.end is not None else begin + length
    left = _NAMES + _BARS * (clock(start) - begin) / length
    wide = max(1.5, _BARS * (stop - clock(start)) / length)
    yield f'<rect x="{left:.1f}" y="{top + 4}" width="{wide:.1f}" height="{_ROW - 8}" rx="2" fill="{color}"/>'
    yield "</g>"


def _details(node: Node) -> str:
    details = [label(node), _outcome(node), *(f"{name} = {value}" for name, value in node.parameters.items())]
    return "\n".join([*details, node.source] if node.source else details)


def _outcome(node: Node) -> str:
    took = f" after {node.seconds * 1e3:.1f} ms" if node.seconds is not None else ""
    failed = f": {format_failure(node.failure)}" if node.failure is not None else ""
    return f"{node.status.word}{took}{failed}"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'
