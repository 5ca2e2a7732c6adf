from math import dist

from scene import build

from pycram import perform
from pycram.fluent import network
from pycram.fluents.world import position
from pycram.language import pursue
from pycram.motion_designators import moving
from pycram.process_module import execution_environment

with build() as world, execution_environment("continuous"):
    near = network(dist, position(world.robot), position(world.get_object("bowl"))) < 1.4
    with pursue as s:
        s(near.wait_for)
        perform(moving(target=[0.6, 0.7, 0], orientation=[0, 0, 0, 1]))
