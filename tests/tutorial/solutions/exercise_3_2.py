import random
from math import dist

from scene import build

from pycram import perform
from pycram.fluent import network, whenever
from pycram.fluents.world import position
from pycram.language import pursue
from pycram.motion_designators import move_arm_joints, moving

PLACES = [[1.3, 1.1, 0.89], [1.3, 0.3, 0.89], [-0.8, 0.8, 0.89]]


def cat(bowl, near):
    for place in random.sample(PLACES, 3):
        bowl.set_position(place)
        near.wait_for()


def follow(moves, bowl):
    for _ in whenever(moves):
        x, y, _ = bowl.get_position()
        side = -0.7 if x > 0 else 0.7
        perform(moving(target=[x + side, y, 0], orientation=[0, 0, 0, 1]))


with build() as world:
    bowl = world.get_object("bowl")
    perform(move_arm_joints(arms={"left": "park", "right": "park"}))
    moves = position(bowl).changed()
    with pursue as s:
        s(follow, moves, bowl)
        s(cat, bowl, network(dist, position(world.robot), position(bowl)) < 1.3)
