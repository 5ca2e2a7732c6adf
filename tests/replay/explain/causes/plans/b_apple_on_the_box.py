"""Puts an apple onto the cereal box for a photograph, and takes it away afterwards."""

from household import kitchen, perform, put

from pycram import bullet_world_reasoning as btr

world = kitchen(cereal=[1.3, 0.7, 0.965])
apple = put("apple", [1.4, 0.95, 0.89])
world.settle()
perform(type="looking", object=apple)
assert btr.visible(apple, world.robot.description.camera.frame)
apple.set_position([1.218, 0.7, 1.12])  # @cause
world.simulate(2)
perform(type="pick-up", object=apple, arm="right")  # @use
world.exit()
