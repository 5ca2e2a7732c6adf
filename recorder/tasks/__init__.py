"""The task tree: the fold of task records, as objects, text, JSON and pictures."""

from recorder.tasks.node import Failing, Moment, Node, State, decisive, is_dealt_with
from recorder.tasks.tree import Tree

__all__ = ["Failing", "Moment", "Node", "State", "Tree", "decisive", "is_dealt_with"]
