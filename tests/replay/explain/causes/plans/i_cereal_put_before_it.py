"""Sees the cup, then the shopping arrives."""

from household import kitchen, perform, put

from pycram import bullet_world_reasoning as btr

world = kitchen(cup=[1.5, 0.8, 0.9])
cup = world.get_object("cup")
perform(type="looking", object=cup)
camera = world.robot.description.camera.frame
if not btr.visible(cup, camera, robot=world.robot):  # @asked
    raise SystemExit("no cup")
put("cereal", [1.36, 0.8, 0.967])  # @changed
world.settle()
found = perform(type="detecting", object_type="cup")  # @use
perform(type="pick-up", object=found, arm="left")
world.exit()
