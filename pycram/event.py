"""Events, under the name of the thesis (section 4.2.3)."""

from pycram.world.event import Event

__all__ = ["Event"]
