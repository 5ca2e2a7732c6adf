"""The task tree for people and machines: as lines of text, as facts for JSON.

``+`` succeeded, ``X`` failed, ``-`` cancelled, ``?`` has not ended, ``.`` has not begun; ``>`` leads to the failure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from recorder.records import format_failure
from recorder.records.text import values
from recorder.tasks import Node, State

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.tasks import Tree

_MARKS: Final = {
    State.SUCCEEDED: "+",
    State.FAILED: "X",
    State.CANCELLED: "-",
    State.RUNNING: "?",
    State.CREATED: ".",
}
_ALIKE: Final = 6  # so many siblings alike are told one by one
_WIDTH: Final = 100  # characters of parameters
_TELLING_KINDS: Final = ("motion", "attempt", "failure-handling")  # whose parameters aren't told elsewhere
_PLAIN_KINDS: Final = ("motion", "process-module", "attempt", "failure-handling")  # their names say what they are


@dataclass(frozen=True, slots=True)
class Row:
    """A line of a tree.

    Attributes:
        depth: from 0.
        node: the task; None for a remark.
        text: what to say.
        failing: whether it is on the way down to the failure.
    """

    depth: int
    node: Node | None
    text: str
    failing: bool = False


def rows(tree: Tree, depth: int | None = None, *, whole: bool = False) -> Iterator[Row]:
    """The tree's tasks, each before its parts; rows of siblings alike that went well are folded.

    Args:
        tree: the tree.
        depth: only so many levels.
        whole: whether to tell one by one what repeats itself.
    """
    failing = tree.failure_path()
    way = {node.id for node in failing}
    stack: list[tuple[int, Node | str]] = [(0, item) for item in reversed(_folded(list(tree.roots), whole=whole))]
    while stack:
        level, item = stack.pop()
        if isinstance(item, str):
            yield Row(level, None, item)
            continue
        yield Row(level, item, label(item), item.id in way)
        if item.is_origin and item.failure is not None:
            yield from (Row(level + 2, None, text) for text in format_failure(item.failure).splitlines())
        if item.forgotten:
            stack.append((level + 1, f"... {item.forgotten} more, forgotten"))
        parts = item.children
        if depth is not None and level + 1 >= depth:
            if parts:
                stack.append((level + 1, f"... {sum(1 for _ in item.walk()) - 1} below"))
        else:
            stack += [(level + 1, part) for part in reversed(_folded(parts, whole=whole))]


def lines(tree: Tree, depth: int | None = None, *, whole: bool = False) -> Iterator[str]:
    """The tree as lines of text.

    Args:
        tree: the tree.
        depth: only so many levels.
        whole: whether to tell one by one what repeats itself.
    """
    for row in rows(tree, depth, whole=whole):
        mark = f"{_MARKS[row.node.status]} " if row.node is not None else ""
        extent = f"  [{_extent(row.node)}]" if row.node is not None else ""
        yield f"{'> ' if row.failing else '  '}{'  ' * row.depth}{mark}{row.text}{extent}"


def label(node: Node) -> str:
    """Name, parameters and kind of a task in a line.

    Args:
        node: the task.
    """
    parameters = values(node.started.parameters)
    if len(parameters) > _WIDTH:
        parameters = parameters[: _WIDTH - 3] + "..."
    # a process module is told what its motion was, a timeout says it in its name
    shown = f"({parameters})" if parameters and node.kind in _TELLING_KINDS else ""
    return f"{node.name}{shown}{'' if node.kind in _PLAIN_KINDS else ' ' + node.kind}"


def facts(tree: Tree, most: int | None = None) -> list[dict[str, object]]:
    """All tasks for machines, each before its parts.

    Args:
        tree: the tree.
        most: only so many levels.
    """
    way = {node.id for node in tree.failure_path()}
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
            "on_failure_path": node.id in way,
            "source": node.source,
        }
        for depth, node in tree.walk()
        if most is None or depth < most
    ]


def _extent(node: Node) -> str:
    if node.finished is None:
        took = "not finished" if node.start is not None else "not begun"
    else:
        took = f"{(node.seconds or 0.0) * 1e3:.1f} ms" if node.start is not None else "never begun"
    if not node.started.seq:  # not recorded
        return took
    return f"{node.started.seq}-{node.finished.seq if node.finished is not None else ''}, {took}"


def _folded(nodes: list[Node], *, whole: bool) -> list[Node | str]:
    """Siblings, with one line for those of a longer row that went well and differ in their parameters only."""
    shown: list[Node | str] = []
    at = 0
    while at < len(nodes):
        end = at
        while end < len(nodes) and _looks(nodes[end]) == _looks(nodes[at]):
            end += 1
        if not whole and end - at > _ALIKE and nodes[at].status is State.SUCCEEDED:
            took = sum(node.seconds or 0.0 for node in nodes[at + 2 : end - 1]) * 1e3
            name = nodes[at].name
            shown += [*nodes[at : at + 2], f"... {end - at - 3} more {name} succeeded  [{took:.1f} ms]", nodes[end - 1]]
        else:
            shown += nodes[at:end]
        at = end
    return shown


def _looks(node: Node) -> tuple[object, ...]:
    return node.kind, node.name, node.status
