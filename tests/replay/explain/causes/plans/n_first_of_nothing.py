"""Takes the first apple that it sees."""

from household import kitchen, perform

from pycram.failures import PlanFailure

world = kitchen(apple=[1.35, 0.9, 0.89])


def visible_things(*kinds):
    found = []
    for kind in kinds:
        try:
            found.append(perform(type="detecting", object_type=kind))  # @swallowed
        except PlanFailure:
            continue
    return found


perform(type="looking", target=[1.35, -3, 0.89])
apples = visible_things("apple")
perform(type="pick-up", object=apples[0], arm="left")  # @use
world.exit()
