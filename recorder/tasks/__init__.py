"""The task tree: tasks folded from their records, as objects, text, JSON and pictures."""

from recorder.tasks.tree import Moment, Node, State, Tree, decisive

__all__ = ["Moment", "Node", "State", "Tree", "decisive"]
