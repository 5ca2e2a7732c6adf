"""Actions of a robot (CRAM): designators of actions, objects and places, and functions that perform actions.

``perform(ActionDesignator(type="transporting", object=..., target=...))`` chooses an arm, a grasp and a place to stand.
If a choice fails, the action tries the next choice until its budget is spent; then its failure lists the tries. Each
action is a function in the plan language; ``@action("transporting")`` replaces the function.
"""

from pycram.actions import carrying, containers, hands, navigating, perceiving  # noqa: F401  the imports register the actions
from pycram.actions.action import ActionDesignator, ActionType, action, replaced
from pycram.actions.locations import LocationDesignator
from pycram.actions.objects import ObjectDesignator
from pycram.actions.perceiving import ObjectNotFound
from pycram.actions.performing import ActionFailed, Try, perform, projecting

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
