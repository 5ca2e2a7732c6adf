# holds: at end on(bottle, kitchen)
# holds: eventually holding(left) is bottle
# holds: at end bottle.x < 0
"""A helper waits until the robot has taken the bottle, then shuts the fridge; the robot carries the bottle away."""

from pycram import perform
from pycram.action_designators import closing, delivering, fetching, opening, parking_arms
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import LocationDesignator
from pycram.event import Event
from pycram.fluent import Fluent
from pycram.language import par

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
kitchen = Object("kitchen", "environment", "kitchen.urdf")
bottle = Object("bottle", "bottle", "bottle.stl", [1.42, -1.05, 0.9])
world.robot = Object("pr2", "robot", "pr2.urdf", [0.5, -0.6, 0])
world.settle()

taken = Fluent(False, name="taken")
shut = Event("shut")
log = []
shut += lambda: log.append("shut")


def robot():
    perform(opening(container="fridge"))
    perform(fetching(object=bottle, arm="left"))
    perform(parking_arms())
    taken.set_value(True)


def helper():
    (taken == True).wait_for()  # noqa: E712
    perform(closing(container="fridge", arm="right"))
    shut()


with par as branches:
    branches(robot)
    branches(helper)

if log != ["shut"]:
    raise RuntimeError(f"the fridge was shut {len(log)} times")
perform(delivering(object=bottle, target=LocationDesignator(on="island")))
world.exit()
