"""The glass stands safely on the box; then the box is taken away, and the plan relies on it."""

from household import kitchen, perform, put

from pycram import bullet_world_reasoning as btr

world = kitchen(cereal=[1.35, 0.8, 0.965])
glass, cereal = put("glass", [1.35, 0.8, 1.145]), world.get_object("cereal")
world.settle()
if btr.stable(glass):  # @asked
    cereal.set_position([1.35, 0.3, 0.965])  # @changed
    world.simulate(0.15)
    perform(type="pick-up", object=glass, arm="left")  # @use
world.exit()
