"""The ten process modules of the thesis (table 4.15), for simulated robots with a description.

The modules serve two execution environments, with different executions of motions (:mod:`pycram.motions.execution`).
"""

from __future__ import annotations

from collections.abc import Mapping

from pycram.motions.execution import INSTANT, Execution
from pycram.motions.modules.container import Accessing
from pycram.motions.modules.perception import Detecting, WorldStateDetecting
from pycram.motions.modules.pick_up import PickUp
from pycram.motions.modules.place import Place
from pycram.motions.modules.robot_parts import MoveGripper, MoveHead, MoveJoints, MoveTCP, Navigation
from pycram.motions.process_module import ProcessModule

__all__ = [
    "Accessing",
    "Detecting",
    "MoveGripper",
    "MoveHead",
    "MoveJoints",
    "MoveTCP",
    "Navigation",
    "PickUp",
    "Place",
    "WorldStateDetecting",
    "default_modules",
]


def default_modules(execution: Execution = INSTANT) -> Mapping[str, ProcessModule]:
    """Return new process modules by the ``cmd`` of their motions; each robot needs its own set."""
    return {
        "navigate": Navigation(execution),
        "pick": PickUp(execution),
        "place": Place(execution),
        "access": Accessing(execution),
        "looking": MoveHead(execution),
        "move-gripper": MoveGripper(execution),
        "detecting": Detecting(),
        "move-tcp": MoveTCP(execution),
        "move-joints": MoveJoints(execution),
        "world-state-detecting": WorldStateDetecting(),
    }
