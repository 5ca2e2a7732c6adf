"""The task tree of the running plan: what it does, what it tried, what failed and where.

A plan may look at it while it runs (from any thread), or after its end; ``replay.open(file).tree()`` rebuilds the same
from a recording, with the same classes. A plan that runs for days keeps its last 20,000 tasks.
"""

from __future__ import annotations

from recorder.tasks import Moment, Node, State, Tree
from recorder.tracing import span

__all__ = ["Moment", "Node", "State", "Tree", "current", "tree"]


def tree() -> Tree:
    """All tasks since the latest recording began; of the whole process where nothing is recorded. It grows on."""
    return span.tree()


def current() -> Node | None:
    """The innermost task that runs here; None outside of all."""
    task = span.current()
    return span.tree().nodes.get(task.id) if task is not None else None
