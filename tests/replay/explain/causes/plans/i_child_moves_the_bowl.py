"""Knows that it reaches the bowl; a child plays with it."""

from household import kitchen, perform

from pycram import bullet_world_reasoning as btr
from pycram.language import seq

world = kitchen(bowl=[1.35, 0.6, 0.89], apple=[1.35, 0.9, 0.89])
bowl = world.get_object("bowl")


def child():
    bowl.set_position([1.7, 1.15, 0.89])  # @changed


reach = btr.reachable(bowl, world.robot, "r_gripper_tool_frame")  # @asked
with seq as s:
    s(child)
    s(perform, type="pick-up", object=world.get_object("apple"), arm="left")
    if reach:
        s(perform, type="pick-up", object=bowl, arm="right")  # @use
world.exit()
