"""Fluents, under the names of the thesis (section 3.5.3)."""

from pycram.fluents.expressions import Behavior
from pycram.fluents.fluent import FalseEndsWait, Fluent, NotSettable, NotTrueOrFalse, network, whenever

__all__ = ["Behavior", "FalseEndsWait", "Fluent", "NotSettable", "NotTrueOrFalse", "network", "whenever"]
