"""Designators, under the names of the thesis (sections 3.5.1, 4.5 and 4.6)."""

from pycram.actions import ActionDesignator, LocationDesignator, ObjectDesignator
from pycram.motions.designator import Designator, MotionDesignator, Solution
from pycram.motions.slots import DesignatorError

__all__ = [
    "ActionDesignator",
    "Designator",
    "DesignatorError",
    "LocationDesignator",
    "MotionDesignator",
    "ObjectDesignator",
    "Solution",
]
