"""The task tree as lines of text, and as data for JSON.

``+`` succeeded, ``X`` failed, ``-`` cancelled, ``?`` has not ended, ``.`` has not begun; ``>`` leads to the failure.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Final

from recorder.records import format_failure
from recorder.records.text import values
from recorder.tasks.node import Node, State, walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_MARKS: Final = {State.SUCCEEDED: "+", State.FAILED: "X", State.CANCELLED: "-", State.RUNNING: "?", State.CREATED: "."}
_MAX_ALIKE: Final = 6  # siblings that are shown one by one
_MAX_WIDTH: Final = 100  # characters of parameters
_WITH_PARAMETERS: Final = ("motion", "attempt", "failure-handling", "handler")  # whose parameters nothing else shows
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
    roots: Sequence[Node], failure_path: Sequence[Node], depth: int | None = None, *, whole: bool = False
) -> Iterator[Row]:
    """All tasks down to a depth, each before its children; siblings alike are folded unless ``whole``."""
    failing = {node.id for node in failure_path}
    stack: list[tuple[int, Node | str]] = [(0, item) for item in reversed(_folded(roots, whole=whole))]
    while stack:
        level, item = stack.pop()
        if isinstance(item, str):
            yield Row(level, None, item)
            continue
        yield Row(level, item, label(item), item.id in failing)
        if item.is_origin and item.failure is not None:
            yield from (Row(level + 2, None, text) for text in format_failure(item.failure).splitlines())
        if item.forgotten:
            stack.append((level + 1, f"... {item.forgotten} more, forgotten"))
        if depth is None or level + 1 < depth:
            stack += [(level + 1, child) for child in reversed(_folded(item.children, whole=whole))]
        elif item.parts:
            stack.append((level + 1, f"... {sum(1 for _ in item.walk()) - 1} below"))


def lines(
    roots: Sequence[Node], failure_path: Sequence[Node], depth: int | None = None, *, whole: bool = False
) -> Iterator[str]:
    """The tree as lines of text; see :func:`rows`."""
    for row in rows(roots, failure_path, depth, whole=whole):
        mark = f"{_MARKS[row.node.status]} " if row.node is not None else ""
        extent = f"  [{_extent(row.node)}]" if row.node is not None else ""
        yield f"{'> ' if row.failing else '  '}{'  ' * row.depth}{mark}{row.text}{extent}"


def label(node: Node) -> str:
    """Name, parameters and kind of a task in a line."""
    parameters = values(node.started.parameters)
    if len(parameters) > _MAX_WIDTH:
        parameters = parameters[: _MAX_WIDTH - 3] + "..."
    shown = f"({parameters})" if parameters and node.kind in _WITH_PARAMETERS else ""
    return f"{node.name}{shown}{'' if node.kind in _WITHOUT_KIND else ' ' + node.kind}"


def facts(roots: Sequence[Node], failure_path: Sequence[Node], max_depth: int | None = None) -> list[dict[str, object]]:
    """All tasks as data for JSON, each before its children; see :func:`rows`."""
    failing = {node.id for node in failure_path}
    return [
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
        }
        for depth, node in walk(roots)
        if max_depth is None or depth < max_depth
    ]


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
