"""The task tree as lines of text, and as data for JSON.

``+`` succeeded, ``X`` failed, ``-`` cancelled, ``?`` has not ended, ``.`` has not begun; ``>`` leads to the failure.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Final

from recorder.records import format_failure
from recorder.records.choices import chosen_name, decision_text, rejection_lines
from recorder.records.projections import foreseen
from recorder.records.text import text_of, values
from recorder.tasks.node import Node, State, walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from recorder.records import Decision, Output, Query

_MARKS: Final = {State.SUCCEEDED: "+", State.FAILED: "X", State.CANCELLED: "-", State.RUNNING: "?", State.CREATED: "."}
_MAX_ALIKE: Final = 6  # siblings that are shown one by one
_MAX_WIDTH: Final = 100  # characters of parameters
_WITH_PARAMETERS: Final = (
    "action",
    "projection",
    "motion",
    "attempt",
    "failure-handling",
    "handler",
)  # whose parameters nothing else shows
_WITHOUT_KIND: Final = ("motion", "process-module", "attempt", "failure-handling")  # whose names imply it


@dataclass(frozen=True, slots=True)
class Row:
    """A line of a tree.

    Attributes:
        depth: from 0.
        node: the task; None for a remark.
        text: without indentation and marks.
        failing: whether it is on the path down to the failure.
    """

    depth: int
    node: Node | None
    text: str
    failing: bool = False


def rows(
    roots: Sequence[Node],
    failure_path: Sequence[Node],
    depth: int | None = None,
    *,
    whole: bool = False,
    output: Mapping[int, Sequence[Output]] | None = None,
) -> Iterator[Row]:
    """All tasks down to a depth, each before its children; siblings alike are folded unless ``whole``.

    Lines that the plan printed or logged, if they are given by their tasks' ids, stand among the children.
    """
    failing = {node.id for node in failure_path}
    said = output or {}
    stack: list[tuple[int, Node | str]] = [(0, item) for item in reversed(_parts(roots, said.get(0, ()), whole=whole))]
    while stack:
        level, item = stack.pop()
        if isinstance(item, str):
            yield Row(level, None, item)
            continue
        yield Row(level, item, label(item), item.id in failing)
        yield from (Row(level + 2, None, text) for choice in item.choices for text in _choice_lines(choice))
        if item.is_origin and item.failure is not None:
            yield from (Row(level + 2, None, text) for text in format_failure(item.failure).splitlines())
        if item.forgotten:
            stack.append((level + 1, f"... {item.forgotten} more, forgotten"))
        if depth is None or level + 1 < depth:
            parts = _parts(item.children, said.get(item.id, ()), whole=whole)
            stack += [(level + 1, part) for part in reversed(parts)]
        elif item.parts:
            stack.append((level + 1, f"... {sum(1 for _ in item.walk()) - 1} below"))


def lines(
    roots: Sequence[Node],
    failure_path: Sequence[Node],
    depth: int | None = None,
    *,
    whole: bool = False,
    output: Mapping[int, Sequence[Output]] | None = None,
) -> Iterator[str]:
    """The tree as lines of text; see :func:`rows`."""
    for row in rows(roots, failure_path, depth, whole=whole, output=output):
        mark = f"{_MARKS.get(row.node.status, '?')} " if row.node is not None else ""
        extent = f"  [{_extent(row.node)}]" if row.node is not None else ""
        yield f"{'> ' if row.failing else '  '}{'  ' * row.depth}{mark}{row.text}{extent}"


def timeout_text(name: str, clock: object) -> str:
    """A timeout in words; its name is its limit."""
    return f"timeout of {name}{' of simulated time' if clock == 'simulated' else ''}"


def label(node: Node) -> str:
    """Name, parameters and kind of a task in a line."""
    if node.kind == "timeout":
        return timeout_text(node.name, node.parameters.get("clock"))
    parameters = values(node.started.parameters)
    if len(parameters) > _MAX_WIDTH:
        parameters = parameters[: _MAX_WIDTH - 3] + "..."
    shown = f"({parameters})" if parameters and node.kind in _WITH_PARAMETERS else ""
    if node.kind == "process-module" and node.decision is not None and (decided := decision_text(node.decision)):
        shown = f" ({decided})"
    foreseen_text = f": {text}" if node.finished is not None and (text := foreseen(node.finished)) else ""
    return f"{node.name}{shown}{'' if node.kind in _WITHOUT_KIND else ' ' + node.kind}{foreseen_text}"


def facts(
    roots: Sequence[Node],
    failure_path: Sequence[Node],
    max_depth: int | None = None,
    output: Mapping[int, Sequence[Output]] | None = None,
) -> Iterator[dict[str, object]]:
    """All tasks as data for JSON, each before its children; see :func:`rows`."""
    failing = {node.id for node in failure_path}
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
            "output": [text_of(record)[0] for record in (output or {}).get(node.id, ())],
            "decision": _fields(node.decision) if node.decision is not None else None,
            "choices": ["\n".join(_choice_lines(choice)) for choice in node.choices],
        }
        for depth, node in walk(roots)
        if max_depth is None or depth < max_depth
    )


def _choice_lines(query: Query) -> Iterator[str]:
    """A choice: what was asked and chosen, then why others were rejected, indented."""
    yield f"{query.name}({values(query.arguments)}): {chosen_name(query) or 'none'}"
    yield from (f"    {line}" for line in rejection_lines(query))


def _fields(decision: Decision) -> dict[str, object]:
    return {each.name: getattr(decision, each.name) for each in decision.DESCRIPTOR.fields}


def _extent(node: Node) -> str:
    if node.finished is None:
        took = "not finished" if node.start is not None else "not begun"
    else:
        took = f"{(node.seconds or 0.0) * 1e3:.1f} ms" if node.start is not None else "never begun"
    if node.started.began_ns:
        took += ", began before the recording"
    if not node.started.seq:  # not recorded
        return took
    return f"{node.started.seq}-{node.finished.seq if node.finished is not None else ''}, {took}"


def _parts(nodes: Sequence[Node], output: Sequence[Output], *, whole: bool) -> list[Node | str]:
    """Siblings, folded, and between them the lines of their parent's output, which are folded likewise."""
    shown: list[Node | str] = []
    printed = 0  # lines that are shown
    for item in _folded(nodes if whole else _lifted(nodes), whole=whole):
        if not isinstance(item, str) and printed < len(output):
            before = bisect_left(output, (item.asked or item.started).seq, printed, key=attrgetter("seq"))
            shown += _said(output[printed:before], whole=whole)
            printed = before
        shown.append(item)
    return shown + _said(output[printed:], whole=whole)


def _lifted(nodes: Sequence[Node]) -> list[Node]:
    """Siblings, with an action's attempts in place of what counts them; of the only one, its parts in place of it."""
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
    """Siblings, with one line for those of a longer run that succeeded and differ in their parameters only."""
    shown: list[Node | str] = []
    for (_, name, status), run in groupby(nodes, lambda node: (node.kind, node.name, node.status)):
        alike = list(run)
        if not whole and len(alike) > _MAX_ALIKE and status is State.SUCCEEDED:
            took = sum(node.seconds or 0.0 for node in alike[2:-1]) * 1e3
            shown += [*alike[:2], f"... {len(alike) - 3} more {name} succeeded  [{took:.1f} ms]", alike[-1]]
        else:
            shown += alike
    return shown
