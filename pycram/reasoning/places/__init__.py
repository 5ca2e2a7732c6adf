"""Places where a robot can stand, and where an object can be put down: searched lazily, best first.

Constraints that can be scored for all places together are maps over a grid, which are multiplied
(:mod:`pycram.reasoning.places.maps`; CRAM's location costmaps, thesis 2.1). Places are drawn from the product with the
run's seed. Each place is checked by the rules of the motion that would use it, so every offered place works.
"""

from pycram.reasoning.places.free import free_places
from pycram.reasoning.places.goals import Pull, PutDown
from pycram.reasoning.places.search import FoundPlace
from pycram.reasoning.places.standing import standing_places

__all__ = ["FoundPlace", "Pull", "PutDown", "free_places", "standing_places"]
