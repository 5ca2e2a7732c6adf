"""Reaches into the fridge as soon as its door is wide open."""

from household import kitchen, perform

from pycram.fluents.world import joint
from pycram.language import par, timeout

world = kitchen()
furniture = world.get_object("kitchen")


def open_fridge():
    for angle in (0.2, 0.4, 0.6):  # the chair stops it
        furniture.set_joint_position("iai_fridge_door_joint", angle)  # @stopped


def go_there():
    (joint(furniture, "iai_fridge_door_joint") > 1.2).wait_for()  # @wait
    perform(type="moving", target=[0.5, -1.0, 0])


with timeout(0.5), par as s:
    s(open_fridge)
    s(go_there)
