"""Parks the arms while it checks the milk."""

from household import kitchen, park

from pycram.failures import PlanFailure
from pycram.language import par

world = kitchen(milk=[1.35, 0.9, 0.95])
BEST_BEFORE = {"milk": 12}
TODAY = 17


def check(kind):
    if BEST_BEFORE[kind] < TODAY:
        raise PlanFailure(f"the {kind} is {TODAY - BEST_BEFORE[kind]} days over its date")  # @cause


with par as s:
    park()
    s(check, "milk")
