"""The task tree as a graph: what runs now and what it is part of, with what went before, and the path to a failure.

What ended well is folded: of a task's children only the last few are shown, and of these only the last one's children.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rerun as rr

from recorder.records import Task
from recorder.tasks import State, Tree
from recorder.viewer.colors import BLUE, GREEN, GREY, RED, YELLOW
from recorder.viewer.task_timeline import STATUS_MARKS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from recorder.tasks import Node
    from recorder.viewer.columns import Columns, TimePoint

GRAPH: Final = "graph"
_MARKS: Final = STATUS_MARKS | {State.SUCCEEDED: " \u2713"}
_COLORS: Final = {
    State.SUCCEEDED: GREEN,
    State.FAILED: RED,
    State.CANCELLED: GREY,
    State.RUNNING: BLUE,
    State.CREATED: YELLOW,
}
_PLAN: Final = "plan"
_MAX_TASKS: Final = 300  # that are remembered
_MAX_CHILDREN: Final = 7  # of a task that are shown
_THINNING: Final = 1000  # after so many pictures only each second one is drawn, then each third, ...
_ACROSS: Final = 120.0  # px from a task to its children
_DOWN: Final = 34.0  # px
_MAX_LETTERS: Final = 24


class TaskGraph:
    """The tree of the latest tasks below one node for the plan.

    Attributes:
        plan: name of the outermost node.
    """

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._path = columns.path("tasks", GRAPH)
        self._tree = Tree(limit=_MAX_TASKS)
        self._count = 0
        self.plan = ""

    def show(self, record: Task, now: TimePoint) -> None:
        """Shows the tree after a task's start or end."""
        self._tree.apply(record)
        if record.phase == Task.ASKED:
            return
        self._count += 1
        if self._count % (1 + self._count // _THINNING) and record.status != Task.FAILED:
            return
        ids, labels, colors, positions = [_PLAN], [self.plan or "plan"], [_COLORS[State.RUNNING]], [(0.0, 0.0)]
        edges = []
        for row, (depth, node) in enumerate(_shown(self._tree), 1):
            ids.append(str(node.id))
            labels.append(_label(node))
            colors.append(_COLORS.get(node.status, _COLORS[State.CREATED]))
            positions.append(((depth + 1) * _ACROSS, row * _DOWN))
            edges.append((str(node.parent.id) if node.parent is not None else _PLAN, ids[-1]))
        nodes = rr.GraphNodes(node_ids=ids, labels=labels, colors=colors, positions=positions)
        self._columns.send(self._path, now, nodes, rr.GraphEdges(edges=edges, graph_type="directed"))


def _shown(tree: Tree) -> Iterator[tuple[int, Node]]:
    failing = {node.id for node in tree.failure_path()}
    roots = _latest(tree.roots, failing)
    last = roots[-1] if roots else None
    stack = [(0, root) for root in reversed(roots)]
    while stack:
        depth, node = stack.pop()
        yield depth, node
        if node.finished is None or node.id in failing or node is last:
            children = _latest(node.children, failing)
            last = children[-1] if node is last and children else last
            stack += [(depth + 1, child) for child in reversed(children)]


def _latest(nodes: Sequence[Node], failing: set[int]) -> list[Node]:
    """The last few, and all that still run or are on the path to the failure."""
    first = len(nodes) - _MAX_CHILDREN
    return [
        node
        for number, node in enumerate(nodes)
        if number >= first or node.id in failing or node.status in (State.RUNNING, State.CREATED)
    ]


def _label(node: Node) -> str:
    name = node.name if len(node.name) <= _MAX_LETTERS else f"{node.name[: _MAX_LETTERS - 1]}\u2026"
    return name + _MARKS.get(node.status, "")
