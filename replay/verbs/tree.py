"""``tree``: the task tree with status and durations; the way down to the failure is marked."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

from recorder.records import Task
from replay.plain import plain_record
from replay.steps import HINT
from replay.tree import Node, State, tree

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from replay.log import Log
    from replay.tree import Tree

_MARKS: Final[dict[int, str]] = {Task.SUCCEEDED: "+", Task.FAILED: "X", Task.CANCELLED: "-", Task.RUNNING: "?"}
_ALIKE: Final = 6  # so many siblings alike are told one by one
_WIDTH: Final = 100  # characters of parameters


def add(parser: argparse.ArgumentParser) -> None:
    """Takes how much to show."""
    parser.add_argument("--at", metavar="STEP", help=f"as it was after a step: {HINT}")
    parser.add_argument("--depth", type=int, metavar="N", help="only so many levels")
    parser.add_argument("--all", action="store_true", help="also what repeats itself")


def run(log: Log, options: argparse.Namespace) -> int:
    """Prints the tree."""
    found = tree(log, None if options.at is None else log.step(options.at) + 1)
    if options.json:
        print(json.dumps(facts(found), ensure_ascii=False))
        return 0
    if not found.roots:
        print("no tasks")
        return 0
    for line in lines(found, options.depth, whole=options.all):
        print(line)
    return 0


def facts(found: Tree) -> list[dict[str, object]]:
    """All tasks for machines, each before its parts.

    Args:
        found: the tree.
    """
    failing = found.failure_path()
    return [
        {
            "id": node.started.task,
            "parent": node.parent.started.task if node.parent else None,
            "depth": depth,
            "kind": node.started.kind,
            "name": node.started.name,
            "path": node.path,
            "status": node.status.word,
            "steps": [node.started.seq, node.finished.seq if node.finished else None],
            "seconds": node.finished.duration_ns / 1e9 if node.finished else None,
            "parameters": plain_record(node.started).get("parameters", {}),
            "failure": _failure(node),
            "on_failure_path": node in failing,
            "source": f"{node.started.source_file}:{node.started.source_line}" if node.started.source_file else "",
        }
        for depth, node in found.walk()
    ]


def lines(found: Tree, depth: int | None = None, *, whole: bool = False) -> Iterator[str]:
    """The tree as text: ``+`` succeeded, ``X`` failed, ``-`` cancelled, ``?`` not finished; ``>`` leads to the failure.

    Args:
        found: the tree.
        depth: only so many levels.
        whole: whether to tell one by one what repeats itself.
    """
    failing = found.failure_path()
    stack: list[tuple[int, Node | str]] = [(0, item) for item in reversed(_folded(list(found.roots), whole=whole))]
    while stack:
        level, item = stack.pop()
        indent = "  " * level
        if isinstance(item, str):
            yield f"  {indent}{item}"
            continue
        marked = "> " if item in failing else "  "
        yield f"{marked}{indent}{_text(item)}"
        if item.failed and (not failing or item is failing[-1] or item not in failing) and item.culprit is None:
            yield f"  {indent}    {_failure(item)}"
        if depth is not None and level + 1 >= depth:
            if item.children:
                stack.append((level + 1, f"... {_count(item)} below"))
        else:
            stack += [(level + 1, part) for part in reversed(_folded(item.children, whole=whole))]


def _folded(nodes: list[Node], *, whole: bool) -> list[Node | str]:
    """Siblings, with one line for those of a longer row that went well and differ in their parameters only."""
    shown: list[Node | str] = []
    at = 0
    while at < len(nodes):
        end = at
        while end < len(nodes) and _looks(nodes[end]) == _looks(nodes[at]):
            end += 1
        if not whole and end - at > _ALIKE and nodes[at].status is State.SUCCEEDED:
            took = sum(node.finished.duration_ns for node in nodes[at + 2 : end - 1] if node.finished) / 1e6
            name = nodes[at].started.name
            shown += [*nodes[at : at + 2], f"... {end - at - 3} more {name} succeeded  [{took:.1f} ms]", nodes[end - 1]]
        else:
            shown += nodes[at:end]
        at = end
    return shown


def _looks(node: Node) -> tuple[object, ...]:
    return node.started.kind, node.started.name, node.status


def _count(node: Node) -> int:
    count, stack = 0, list(node.children)
    while stack:
        child = stack.pop()
        count += 1
        stack += child.children
    return count


def _text(node: Node) -> str:
    start, end = node.started, node.finished
    parameters = ", ".join(f"{argument.name}={argument.json}" for argument in start.parameters)
    if len(parameters) > _WIDTH:
        parameters = parameters[: _WIDTH - 3] + "..."
    # a process module is told what its motion was
    shown = f"({parameters})" if parameters and start.kind != "process-module" else ""
    kind = "" if start.kind in ("motion", "process-module") else f" {start.kind}"
    steps = f"{start.seq}-{end.seq}" if end is not None else f"{start.seq}-"
    took = f"{end.duration_ns / 1e6:.1f} ms" if end is not None else "not finished"
    return f"{_MARKS.get(node.status, '?')} {start.name}{shown}{kind}  [{steps}, {took}]"


def _failure(node: Node) -> str:
    end = node.finished
    return f"{end.failure.type}: {end.failure.message}" if end is not None and end.HasField("failure") else ""
