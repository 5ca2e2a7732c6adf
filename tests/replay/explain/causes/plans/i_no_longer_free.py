"""Nothing blocks the bottle when the plan asks; then the other hand sets the pot down before it."""

from household import kitchen, perform, put

from pycram import bullet_world_reasoning as btr

world = kitchen(bottle=[1.55, 0.8, 0.98])
bottle, robot = world.get_object("bottle"), world.robot
in_the_way = btr.blocking(bottle, robot, "l_gripper_tool_frame")  # @asked
print("in the way:", [body.name for body in in_the_way])
cereal = put("cereal", [1.4, 0.8, 0.967], [0, 0, 0.7071068, 0.7071068])  # @changed
world.settle()
if not in_the_way:
    perform(type="pick-up", object=bottle, arm="left", grasp="front")  # @use
world.exit()
