"""``tree``: the task tree with status and durations; failed tasks are marked."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from recorder.records import Task

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from replay.log import Log

HELP = "the task tree"
_MARKS = {Task.SUCCEEDED: "+", Task.FAILED: "X", Task.CANCELLED: "-", Task.RUNNING: "?"}


@dataclass(slots=True)
class Node:
    """A task of the tree.

    Attributes:
        started: the record of its start.
        finished: the record of its end; None if the recording ends before.
        children: tasks that are part of it.
    """

    started: Task
    finished: Task | None = None
    children: list[Node] = field(default_factory=list)

    @property
    def status(self) -> Task.Status:
        """How it ended."""
        return self.finished.status if self.finished else Task.RUNNING

    def facts(self) -> dict[str, object]:
        """For machines."""
        end = self.finished
        return {
            "id": self.started.task,
            "kind": self.started.kind,
            "name": self.started.name,
            "status": Task.Status.Name(self.status).lower(),
            "steps": [self.started.seq, end.seq if end else None],
            "milliseconds": end.duration_ns / 1e6 if end else None,
            "failure": f"{end.failure.type}: {end.failure.message}" if end and end.HasField("failure") else "",
            "line": f"{self.started.source_file}:{self.started.source_line}",
            "children": [child.facts() for child in self.children],
        }

    def lines(self, depth: int = 0) -> Iterator[str]:
        """For people."""
        end = self.finished
        took = f"{end.duration_ns / 1e6:.1f} ms" if end else "not finished"
        parameters = ", ".join(f"{argument.name}={argument.json}" for argument in self.started.parameters)
        shown = parameters if len(parameters) < 100 else parameters[:97] + "..."
        told = f"{'  ' * depth}{_MARKS[self.status]} {self.started.name}"
        if self.started.kind not in ("motion", "process-module"):
            told += f" ({self.started.kind})"
        if shown and self.started.kind == "motion":
            told += f"({shown})"
        yield f"{told}  [{self.started.seq}, {took}]"
        if self.status == Task.FAILED and end is not None and not any(c.status == Task.FAILED for c in self.children):
            yield f"{'  ' * depth}    {end.failure.type}: {end.failure.message}"
        for child in self.children:
            yield from child.lines(depth + 1)


def add(parser: argparse.ArgumentParser) -> None:
    """Takes nothing more."""


def tree(log: Log) -> list[Node]:
    """The tasks of a recording, the outermost ones with all that is part of them."""
    nodes: dict[int, Node] = {}
    roots: list[Node] = []
    for record in log.records(Task):
        if not isinstance(record, Task):
            continue
        if record.phase == Task.STARTED:
            node = nodes[record.task] = Node(record)
            parent = nodes.get(record.parent)
            (parent.children if parent else roots).append(node)
        elif record.task in nodes:
            nodes[record.task].finished = record
    return roots


def run(log: Log, _: argparse.Namespace) -> tuple[object, str]:
    """Draws it.

    Returns:
        The nodes, for machines and for people.
    """
    roots = tree(log)
    return [root.facts() for root in roots], "\n".join(line for root in roots for line in root.lines())
