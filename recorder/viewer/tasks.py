"""Tasks in the viewer: lanes over time, and the task tree as a graph.

When a task ends, its beginning is sent again with the outcome, and replaces the earlier row. The graph shows the
running tasks, the tasks around them, the latest tasks, and the path to a failure. Only the last few children of a task
are shown; among succeeded tasks, only the last one has its children.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import rerun as rr

from recorder.records import Task
from recorder.records.text import is_timed_out
from recorder.tasks import Node, State, Tree
from recorder.tasks.rendering import COLORS
from recorder.tasks.tree import Lane, Lanes
from recorder.viewer.rerun_stream import BLUE, GREEN, GREY, RED, YELLOW, Color, Columns, Series, TimePoint

LANES: Final = "level"  # name that titles of lanes contain
_MARKS: Final = {State.FAILED: " \u2717", State.CANCELLED: " \u2013", State.SUCCEEDED: " \u2713"}
_TIMED_OUT: Final = " timed out"
_MAX_NAMES: Final = 300  # number of task names that have colours in a lane; others are named by kind


@dataclass(slots=True)
class _Lane:
    path: str
    states: Series
    labels: dict[str, tuple[str, Color]] = field(default_factory=dict)  # labels and colours by the viewer's state


class TaskTimeline:
    """Lanes of all tasks."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._started: dict[int, tuple[Task, TimePoint]] = {}  # the starts of running tasks
        self._tasks = Lanes()
        self.lanes: dict[Lane, _Lane] = {}

    def show(self, record: Task, now: TimePoint) -> None:
        """Show a task's start or end."""
        place = self._tasks.follow(record)
        if place is None:
            return
        if place not in self.lanes:
            depth, slot = place
            path = self._columns.path(LANES, f"{depth}.{slot + 1}" if slot else str(depth))
            states = self._columns.series(path, lambda rows: rr.StateChange.columns(state=[state for (state,) in rows]))
            self.lanes[place] = _Lane(path, states)
        lane = self.lanes[place]
        if record.phase == Task.STARTED:
            self._started[record.task] = record, now
            self._label(lane, record, now, State.RUNNING)
        else:
            self._label(lane, *self._started.pop(record.task), State(record.status), timed_out=is_timed_out(record))
            lane.states.add(now, ("",))

    def show_parting(self, other: str, first: TimePoint, now: TimePoint) -> None:
        """Show in a lane of its own where the run begins to differ from another run."""
        path = self._columns.path(LANES, "0", other)
        labels = [f"as in {other}", f"differs from {other}"]
        self._columns.send_static(path, rr.StateConfiguration(values=labels, labels=labels, colors=[GREY, YELLOW]))
        for label, time in zip(labels, (first, now), strict=True):
            self._columns.send(path, time, rr.StateChange(state=label))

    def _label(self, lane: _Lane, record: Task, since: TimePoint, status: State, *, timed_out: bool = False) -> None:
        name = record.name if len(lane.labels) < _MAX_NAMES else record.kind
        state = f"{name}{_TIMED_OUT if timed_out else ' ' + status.word}"
        if state not in lane.labels:
            red, green, blue = bytes.fromhex(COLORS[status].removeprefix("#"))
            mark = "" if status == State.SUCCEEDED else _MARKS.get(status, "")
            lane.labels[state] = (state, YELLOW) if timed_out else (name + mark, (red, green, blue))
            labels, colors = zip(*lane.labels.values(), strict=True)
            configuration = rr.StateConfiguration(values=list(lane.labels), labels=labels, colors=colors)
            self._columns.send_static(lane.path, configuration)
        lane.states.add(since, (state,))


GRAPH: Final = "graph"
_COLORS: Final = {
    State.SUCCEEDED: GREEN,
    State.FAILED: RED,
    State.CANCELLED: GREY,
    State.RUNNING: BLUE,
    State.CREATED: YELLOW,
}
_PLAN: Final = "plan"
_MAX_TASKS: Final = 300  # maximum number of tasks in the tree
_MAX_CHILDREN: Final = 7  # maximum number of children of a task that are shown
_THINNING: Final = 1000  # after 1,000 updates, every second update is drawn, after 2,000 every third, ...
_ACROSS: Final = 120.0  # distance in pixels from a task to its children, to the right
_DOWN: Final = 34.0  # distance in pixels between neighbours, downwards
_MAX_LETTERS: Final = 24


class TaskGraph:
    """The tree of the latest tasks below a node for the plan."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._path = columns.path("tasks", GRAPH)
        self._tree = Tree(limit=_MAX_TASKS)
        self._count = 0
        self.plan = ""  # name of the node for the plan

    def show(self, record: Task, now: TimePoint) -> None:
        """Show the tree after a task's start or end."""
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
            name = node.name if len(node.name) <= _MAX_LETTERS else f"{node.name[: _MAX_LETTERS - 1]}\u2026"
            timed_out = node.finished is not None and is_timed_out(node.finished)
            labels.append(name + (_TIMED_OUT if timed_out else _MARKS.get(node.status, "")))
            colors.append(YELLOW if timed_out else _COLORS.get(node.status, _COLORS[State.CREATED]))
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
    """Return the last few nodes, all running nodes, and all nodes on the path to the failure."""
    first = len(nodes) - _MAX_CHILDREN
    return [
        node
        for number, node in enumerate(nodes)
        if number >= first or node.id in failing or node.status in (State.RUNNING, State.CREATED)
    ]
