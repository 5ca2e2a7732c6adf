"""Places: where a robot can stand, and where an object can be put down, found lazily and best first.

What can be known of all places at once is drawn as maps over a grid, which are multiplied
(:mod:`pycram.reasoning.places.maps`; CRAM's location costmaps, thesis 2.1). Places are drawn from the product with the
run's seed, and each is checked by the very rules that the motions apply to it, so that a place that is offered works.
"""

from pycram.reasoning.places.free import free_places
from pycram.reasoning.places.goals import Pull, PutDown
from pycram.reasoning.places.search import Place
from pycram.reasoning.places.standing import standing_places

__all__ = ["Place", "Pull", "PutDown", "free_places", "standing_places"]
