"""The task tree of the running plan: its actions, attempts and failures, with their places in the plan.

A plan may read the tree from any thread while it runs, or afterwards. The tree keeps the last 20,000 tasks.
"""

from __future__ import annotations

from recorder.tasks import Moment, Node, State, Tree
from recorder.tracing import span

__all__ = ["Moment", "Node", "State", "Tree", "current", "tree"]


def tree() -> Tree:
    """Return all tasks since the start of the latest recording or of the process. Tasks are added while a plan runs."""
    return span.tree()


def current() -> Node | None:
    """Return the innermost task around this code; None outside of all tasks."""
    task = span.current()
    return span.tree().nodes.get(task.id) if task is not None else None
