"""The task tree of the running plan: what it does, what it tried, what failed and where.

A plan may read it while it runs (from any thread), or after its end; ``replay.open(file).tree()`` rebuilds the same
from a recording, with the same classes. It keeps the last 20,000 tasks.
"""

from __future__ import annotations

from recorder.tasks import Moment, Node, State, Tree
from recorder.tracing import span

__all__ = ["Moment", "Node", "State", "Tree", "current", "tree"]


def tree() -> Tree:
    """Return all tasks since the latest recording began, else since the process began; later tasks are added to it."""
    return span.tree()


def current() -> Node | None:
    """Return the innermost task that runs here; None outside of all tasks."""
    task = span.current()
    return span.tree().nodes.get(task.id) if task is not None else None
