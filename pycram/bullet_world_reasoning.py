"""The reasoning queries (thesis 4.4, table 4.3) about the present world and about possible ones.

Import it as ``btr``. Queries leave no trace in the world; each call is recorded with its answer and evidence. Answers
behave as the thesis' bool or list and have ``evidence``. A camera is given by its position, the name of its frame, or a
pair of position and orientation.
"""

from pycram.foundation.failures import ReasoningError
from pycram.reasoning.queries.contact import contact, supporting
from pycram.reasoning.queries.reachability import blocking, reachable, reachable_object, reachable_pose, reachable_poses
from pycram.reasoning.queries.stability import stable
from pycram.reasoning.queries.visibility import occluding, visible

reachable_position = reachable  # its name in table 4.3

__all__ = [
    "ReasoningError",
    "blocking",
    "contact",
    "occluding",
    "reachable",
    "reachable_object",
    "reachable_pose",
    "reachable_poses",
    "reachable_position",
    "stable",
    "supporting",
    "visible",
]
