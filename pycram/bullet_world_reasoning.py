"""The reasoning queries (thesis 4.4, table 4.3): what is so, and what would be.

Import it as ``btr``. Queries leave no trace in the world; each call is on record with its answer and what it rests on.
Answers behave as the thesis' bool or list and carry their ``evidence``. Where a position of a camera is asked for, the
name of a camera's frame or a pair of position and orientation will do as well.
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
