"""The task tree as a graph: what runs now and what it is part of, with what went before, and the way to a failure.

What ended well is folded: of the parts of a task only the last few are shown, and of these only the last one's parts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder.records import Task
from recorder.tasks import State, Tree
from recorder.viewer.marks import BLUE, GREEN, GREY, RED, YELLOW
from recorder.viewer.timeline import MARKS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from recorder.records import Run
    from recorder.tasks import Node
    from recorder.viewer.columns import Columns, Moment

GRAPH: Final = "graph"
_MARKS: Final = MARKS | {State.SUCCEEDED: " \u2713"}
_COLORS: Final = {
    State.SUCCEEDED: GREEN,
    State.FAILED: RED,
    State.CANCELLED: GREY,
    State.RUNNING: BLUE,
    State.CREATED: YELLOW,
}
_PLAN: Final = "plan"
_KEPT: Final = 300  # tasks that are remembered
_PARTS: Final = 7  # of a task that are shown
_EVERY: Final = 1000  # after so many pictures, only each second one is drawn, then each third, ...
_ACROSS: Final = 120.0  # px from a task to its parts
_DOWN: Final = 34.0
_LETTERS: Final = 24


class Graph:
    """The tree of all tasks.

    Args:
        columns: where it goes.
    """

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._path = columns.path("tasks", GRAPH)
        self._tree = Tree(limit=_KEPT)
        self._count = 0
        self._plan = ""

    def begin(self, record: Run) -> None:
        """Takes the plan's name: that of the outermost node."""
        self._plan = record.name

    def show(self, record: Task, now: Moment) -> None:
        """Shows the tree after a task's start or end."""
        self._tree.apply(record)
        if record.phase == Task.ASKED:
            return
        self._count += 1
        if self._count % (1 + self._count // _EVERY) and record.status != Task.FAILED:
            return
        ids, labels, colors, places = [_PLAN], [self._plan or "plan"], [_COLORS[State.RUNNING]], [(0.0, 0.0)]
        edges = []
        for row, (depth, node) in enumerate(_shown(self._tree), 1):
            ids.append(str(node.id))
            labels.append(_label(node))
            colors.append(_COLORS[node.status])
            places.append(((depth + 1) * _ACROSS, row * _DOWN))
            edges.append((str(node.parent.id) if node.parent is not None else _PLAN, ids[-1]))
        nodes = rr.GraphNodes(node_ids=ids, labels=labels, colors=colors, positions=places)
        self._columns.put(self._path, now, nodes, rr.GraphEdges(edges=edges, graph_type="directed"))


def _shown(tree: Tree) -> Iterator[tuple[int, Node]]:
    way = {node.id for node in tree.failure_path()}
    roots = _last(tree.roots, way)
    last = roots[-1] if roots else None
    stack = [(0, root) for root in reversed(roots)]
    while stack:
        depth, node = stack.pop()
        yield depth, node
        if node.finished is None or node.id in way or node is last:
            parts = _last(node.children, way)
            last = parts[-1] if node is last and parts else last
            stack += [(depth + 1, part) for part in reversed(parts)]


def _last(nodes: Sequence[Node], way: set[int]) -> list[Node]:
    """The last few, and all that still run or led to the failure."""
    first = len(nodes) - _PARTS
    return [
        node
        for number, node in enumerate(nodes)
        if number >= first or node.id in way or node.status in (State.RUNNING, State.CREATED)
    ]


def _label(node: Node) -> str:
    name = node.name if len(node.name) <= _LETTERS else f"{node.name[: _LETTERS - 1]}\u2026"
    return name + _MARKS.get(node.status, "")
