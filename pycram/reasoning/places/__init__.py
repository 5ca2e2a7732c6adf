"""Places where a robot can stand, or where an object can be put down; searches yield the best places first.

Maps score all cells of a grid for a constraint (:mod:`pycram.reasoning.places.maps`; CRAM's location costmaps, thesis
2.1). Places are drawn from the product of all maps, and then checked by the rules of the motion that would use them.
"""

from pycram.reasoning.places.free import free_places
from pycram.reasoning.places.goals import Pull, PutDown
from pycram.reasoning.places.search import FoundPlace
from pycram.reasoning.places.standing import standing_places

__all__ = ["FoundPlace", "Pull", "PutDown", "free_places", "standing_places"]
