"""The task tree: the fold of task records, as objects, text, JSON and pictures."""

from recorder.tasks.node import Moment, Node, State, decisive
from recorder.tasks.tree import Tree

__all__ = ["Moment", "Node", "State", "Tree", "decisive"]
