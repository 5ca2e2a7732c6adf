"""The task tree as lines of text, as data for JSON, as a graph for Graphviz, and as an SVG.

Marks in the text: ``+`` succeeded, ``X`` failed, ``-`` cancelled, ``?`` not ended, ``.`` not begun. The mark ``>``
shows the path to the failure. The SVG has the same lines, without output of the plan, and bars of wall time.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape as escape_quotes
from itertools import groupby, islice
from operator import attrgetter
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Output, Query, Task, format_failure
from recorder.records.text import (
    chosen_name,
    decision_text,
    foreseen,
    is_timed_out,
    rejection_lines,
    text_of,
    timeout_text,
    values,
)

if TYPE_CHECKING:
    from recorder.tasks.tree import Moment, Node, Tree

_MARKS: Final[Mapping[int, str]] = {
    Task.SUCCEEDED: "+",
    Task.FAILED: "X",
    Task.CANCELLED: "-",
    Task.RUNNING: "?",
    Task.CREATED: ".",
}
_MAX_ALIKE: Final = 6  # maximum number of similar siblings that aren't folded
_MAX_WIDTH: Final = 100  # maximum number of characters of parameters in a line
#: Kinds of tasks whose lines show the parameters.
_WITH_PARAMETERS: Final = frozenset({"action", "projection", "motion", "attempt", "failure-handling", "handler"})
#: Kinds of tasks whose lines don't show the kind, because the names imply it.
_WITHOUT_KIND: Final = ("motion", "process-module", "attempt", "failure-handling")


@dataclass(frozen=True, slots=True)
class TreeRow:
    """A line of a tree."""

    depth: int  # depth of the task, from 0
    node: Node | None  # the task; None if the line shows details or output
    text: str  # text of the line, without indentation and marks
    failing: bool = False  # whether the task is on the path to the failure


def rows(tree: Tree, depth: int | None = None, *, whole: bool = False, output: bool = True) -> Iterator[TreeRow]:
    """Yield all tasks down to a depth; each task comes before its children.

    Similar siblings are folded, unless ``whole`` is true. With ``output``, printed lines appear among the children.
    """
    failing = {node.id for node in tree.failure_path()}
    said = tree.output if output else {}
    items = _parts(tree.roots, said.get(0, ()), whole=whole)
    stack: list[tuple[int, Node | str]] = [(0, item) for item in reversed(items)]
    while stack:
        level, item = stack.pop()
        if isinstance(item, str):
            yield TreeRow(level, None, item)
            continue
        yield TreeRow(level, item, label(item), item.id in failing)
        yield from (TreeRow(level + 2, None, text) for choice in item.choices for text in _choice_lines(choice))
        if item.is_origin and item.failure is not None:
            yield from (TreeRow(level + 2, None, text) for text in format_failure(item.failure).splitlines())
        if item.forgotten:
            stack.append((level + 1, f"... {item.forgotten} more, forgotten"))
        if depth is None or level + 1 < depth:
            parts = _parts(item.children, said.get(item.id, ()), whole=whole)
            stack += [(level + 1, part) for part in reversed(parts)]
        elif item.parts:
            stack.append((level + 1, f"... {sum(1 for _ in item.walk()) - 1} below"))


def depth_of(tree: Tree, limit: int) -> int | None:
    """Return the largest depth, at least 1, with at most ``limit`` rows. Return None if the whole tree fits."""
    deepest = max((depth for depth, _ in tree.walk()), default=0) + 1
    for depth in range(1, deepest + 1):
        if len(list(islice(rows(tree, depth, output=False), limit + 1))) > limit:
            return max(depth - 1, 1)
    return None


def lines(tree: Tree, depth: int | None = None, *, whole: bool = False) -> Iterator[str]:
    """Yield the tree as lines of text, with the rows of :func:`rows`."""
    for row in rows(tree, depth, whole=whole):
        mark = f"{_MARKS.get(row.node.status, '?')} " if row.node is not None else ""
        extent = f"  [{_extent(row.node)}]" if row.node is not None else ""
        yield f"{'> ' if row.failing else '  '}{'  ' * row.depth}{mark}{row.text}{extent}"


def label(node: Node) -> str:
    """Return the line for a task, with its name, parameters and kind."""
    if node.kind == "timeout":
        return timeout_text(node.name, node.parameters.get("clock"))
    parameters = values(node.started.parameters)
    if len(parameters) > _MAX_WIDTH:
        parameters = parameters[: _MAX_WIDTH - 3] + "..."
    shown = f"({parameters})" if parameters and node.kind in _WITH_PARAMETERS else ""
    if node.kind == "process-module" and node.decision is not None and (decided := decision_text(node.decision)):
        shown = f" ({decided})"
    outcome = ""
    if node.finished is not None and (text := "timed out" if is_timed_out(node.finished) else foreseen(node.finished)):
        outcome = f": {text}"
    return f"{node.name}{shown}{'' if node.kind in _WITHOUT_KIND else ' ' + node.kind}{outcome}"


def facts(tree: Tree, max_depth: int | None = None) -> Iterator[dict[str, object]]:
    """Yield each task as data for JSON; each task comes before its children."""
    failing = {node.id for node in tree.failure_path()}
    return (
        {
            "id": node.id,
            "parent": node.parent.id if node.parent is not None else None,
            "depth": depth,
            "kind": node.kind,
            "name": node.name,
            "path": node.path,
            "attempt": node.attempt or None,
            "status": node.status.word,
            "steps": [node.started.seq, node.finished.seq if node.finished is not None else None],
            "wall_ns": [moment.wall_ns if moment is not None else None for moment in (node.start, node.end)],
            "sim_seconds": [moment.sim_seconds if moment is not None else None for moment in (node.start, node.end)],
            "seconds": node.seconds,
            "parameters": dict(node.parameters),
            "failure": format_failure(node.failure) if node.failure is not None else "",
            "on_failure_path": node.id in failing,
            "source": node.source,
            "output": [text_of(record)[0] for record in tree.output.get(node.id, ())],
            "decision": {each.name: getattr(decision, each.name) for each in decision.DESCRIPTOR.fields}
            if (decision := node.decision) is not None
            else None,
            "choices": ["\n".join(_choice_lines(choice)) for choice in node.choices],
        }
        for depth, node in tree.walk()
        if max_depth is None or depth < max_depth
    )


def _choice_lines(query: Query) -> Iterator[str]:
    """Yield lines of a choice: the query and the chosen candidate, then indented lines of the rejected candidates."""
    yield f"{query.name}({values(query.arguments)}): {chosen_name(query) or 'none'}"
    yield from (f"    {line}" for line in rejection_lines(query))


def _extent(node: Node) -> str:
    if node.finished is None:
        took = "not finished" if node.start is not None else "not begun"
    else:
        took = f"{(node.seconds or 0.0) * 1e3:.1f} ms" if node.start is not None else "never begun"
    if node.started.began_ns:
        took += ", began before the recording"
    if not node.started.seq:
        return took
    return f"{node.started.seq}-{node.finished.seq if node.finished is not None else ''}, {took}"


def _parts(nodes: Sequence[Node], output: Sequence[Output], *, whole: bool) -> list[Node | str]:
    """Return siblings; the lines of their parent's output are between them. Siblings and output are folded."""
    shown: list[Node | str] = []
    printed = 0
    for item in _folded(nodes if whole else _lifted(nodes), whole=whole):
        if not isinstance(item, str) and printed < len(output):
            before = bisect_left(output, (item.asked or item.started).seq, printed, key=attrgetter("seq"))
            shown += _said(output[printed:before], whole=whole)
            printed = before
        shown.append(item)
    return shown + _said(output[printed:], whole=whole)


def _lifted(nodes: Sequence[Node]) -> list[Node]:
    """Return siblings; an action's attempts, or its only attempt's parts, replace its successful failure handling."""
    shown: list[Node] = []
    for node in nodes:
        tries = node.children if node.kind == "failure-handling" and "action" in node.parameters else []
        if not tries or node.failed:
            shown.append(node)
        elif len(tries) == 1 and not tries[0].parameters and not tries[0].failed:
            shown += _lifted(tries[0].children)
        else:
            shown += tries
    return shown


def _said(output: Sequence[Output], *, whole: bool) -> list[Node | str]:
    texts: list[Node | str] = [text_of(record)[0] for record in output]
    if not whole and len(texts) > _MAX_ALIKE:
        texts[2:-2] = [f"... {len(texts) - 4} more lines"]
    return texts


def _folded(nodes: Sequence[Node], *, whole: bool) -> list[Node | str]:
    """Return siblings; a line replaces the middle of many succeeded tasks with the same name."""
    shown: list[Node | str] = []
    for (_, name, status), run in groupby(nodes, lambda node: (node.kind, node.name, node.status)):
        alike = list(run)
        if not whole and len(alike) > _MAX_ALIKE and status == Task.SUCCEEDED:
            took = sum(node.seconds or 0.0 for node in alike[2:-1]) * 1e3
            shown += [*alike[:2], f"... {len(alike) - 3} more {name} succeeded  [{took:.1f} ms]", alike[-1]]
        else:
            shown += alike
    return shown


COLORS: Final[Mapping[int, str]] = defaultdict(
    lambda: "#707070",  # colour for a status that only a newer release knows
    {
        Task.SUCCEEDED: "#2e9e5b",
        Task.FAILED: "#d0342c",
        Task.CANCELLED: "#9a9a9a",
        Task.RUNNING: "#2f6fd0",
        Task.CREATED: "#d9a400",
    },
)
_ROW: Final = 20  # height of a line in pixels
_INDENT: Final = 16
_NAMES: Final = 520  # width of the column of names in pixels
_BARS: Final = 560  # width of the column of times in pixels
_TOP: Final = 44
_LETTER: Final = 6.6  # width of a letter in pixels
_Clock: TypeAlias = "Callable[[Moment], int]"
_escape = partial(escape_quotes, quote=False)


def dot(tree: Tree) -> str:
    """Return the tree for Graphviz: ``dot -Tsvg``."""
    failing = {node.id for node in tree.failure_path()}
    out = ["digraph tasks {", '  node [shape=box, style="rounded,filled", fontname="sans-serif", fontsize=10];']
    for _, node in tree.walk():
        text = f"{label(node)}\n{_outcome(node)}"
        width = 3 if node.id in failing else 1
        out.append(
            f"  t{node.id} [label={_quoted(text)}, color={_quoted(COLORS[node.status])}, penwidth={width}, "
            'fillcolor="white"];'
        )
        if node.parent is not None:
            out.append(f"  t{node.parent.id} -> t{node.id};")
    return "\n".join([*out, "}"]) + "\n"


def svg(tree: Tree, depth: int | None = None, *, whole: bool = False) -> str:
    """Return the tree and its times as an SVG document, with the rows of :func:`rows`."""
    shown = list(rows(tree, depth, whole=whole, output=False))
    moments = [node.created for _, node in tree.walk()]
    moments += [node.end for _, node in tree.walk() if node.end is not None]
    steady = all(moment.monotonic_ns for moment in moments)  # the wall clock may jump while a plan runs
    clock: _Clock = attrgetter("monotonic_ns" if steady else "wall_ns")
    times = [clock(moment) for moment in moments]
    begin, end = (min(times), max(times)) if times else (0, 1)
    height = _TOP + _ROW * len(shown) + 12
    width = _NAMES + _BARS + 30
    size = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="DejaVu Sans, sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="white"/>',
        *_axis((end - begin) / 1e9, height),
    ]
    for number, row in enumerate(shown):
        parts += _drawn(row, _TOP + _ROW * number, clock, begin, max(end - begin, 1))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _axis(seconds: float, height: int) -> Iterator[str]:
    units = (1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9)  # units of the scale in s; 64 bits of nanoseconds are at most 9e9 s
    steps = (size * unit for unit in units for size in (1, 2, 5, 10, 20, 50, 100, 200, 500))
    step = next(length for length in steps if seconds / length <= 6)
    yield f'<text x="12" y="24" fill="#555">task</text><text x="{_NAMES}" y="16" fill="#555">time by the clock</text>'
    for number in range(int(seconds / step) + 1):
        x = _NAMES + _BARS * number * step / seconds if seconds else float(_NAMES)
        yield f'<line x1="{x:.1f}" y1="{_TOP - 8}" x2="{x:.1f}" y2="{height - 8}" stroke="#e4e4e4"/>'
        yield f'<text x="{x:.1f}" y="{_TOP - 12}" fill="#555" font-size="9">{number * step:g} s</text>'


def _drawn(row: TreeRow, top: int, clock: _Clock, begin: int, length: int) -> Iterator[str]:
    x = 12 + _INDENT * row.depth
    room = max(8, int((_NAMES - x - 24) / _LETTER))
    text = row.text if len(row.text) <= room else row.text[: room - 1] + "\u2026"
    node = row.node
    if node is None:
        color = "#b02a24" if ": " in row.text else "#777"
        yield f'<text x="{x}" y="{top + 14}" fill="{color}" font-style="italic">{_escape(text)}</text>'
        return
    color = COLORS[node.status]
    details = [label(node), _outcome(node), *(f"{name} = {value}" for name, value in node.parameters.items())]
    details += [node.source] if node.source else []
    title = "\n".join(details)
    yield f"<g><title>{_escape(title)}</title>"
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


def _outcome(node: Node) -> str:
    took = f" after {node.seconds * 1e3:.1f} ms" if node.seconds is not None else ""
    failed = f": {format_failure(node.failure)}" if node.failure is not None else ""
    return f"{node.status.word}{took}{failed}"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'
