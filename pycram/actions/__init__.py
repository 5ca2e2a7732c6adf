"""Actions: what a robot is to do, not how (CRAM): designators of actions, objects and places, and what does them.

``perform(ActionDesignator(type="transporting", object=..., target=...))`` chooses an arm, a grasp and where to stand,
carries on with the next choice when one fails, and says what was tried when its budget is spent. Each action is a
function in a module of its own, written in the plan language; ``@action("transporting")`` puts another in its place.
"""

from pycram.actions import (  # noqa: F401  that there are these
    closing,
    delivering,
    fetching,
    handing_over,
    looking,
    navigating,
    opening,
    parking_arms,
    perceiving,
    picking_up,
    placing,
    searching,
    transporting,
)
from pycram.actions.action import ActionDesignator, ActionType, action, replaced
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import ObjectDesignator
from pycram.actions.performing import ActionFailed, Try, perform
from pycram.actions.projecting import projecting
from pycram.actions.searching import ObjectNotFound

__all__ = [
    "ActionDesignator",
    "ActionFailed",
    "ActionType",
    "LocationDesignator",
    "ObjectDesignator",
    "ObjectNotFound",
    "Try",
    "action",
    "perform",
    "projecting",
    "replaced",
]
