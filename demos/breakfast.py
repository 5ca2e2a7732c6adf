"""Sets a breakfast and clears it away. The plan names objects and goals; PyCRAM chooses poses, arms and grasps.

The robot takes the milk from the fridge, the spoon from a drawer, and bowl and cereal from the counter to the island.
The cereal goes from one hand to the other. Then the bowl goes to the counter, and the milk into the fridge. Arms that
are bolted down carry the objects from the right to the left side of a table. Run it with ``pycram demo breakfast``.
"""

from __future__ import annotations

import argparse

from pycram import perform
from pycram.action_designators import closing, delivering, fetching, handing_over, opening, parking_arms, transporting
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import LocationDesignator
from pycram.failures import MissingPart

ROBOTS = ("pr2", "tiago_pro", "panda", "ur5")
BOLTED_DOWN = ("panda", "ur5")
BASE, ARM = "base that drives", "second arm"
WITHOUT = {BASE: "breakfast is on a table, without fridge and drawer", ARM: "nothing is handed over"}


def build_kitchen(robot: str) -> None:
    """Loads a kitchen, a robot and the objects for breakfast."""
    Object("kitchen", "environment", "kitchen.urdf")
    BulletWorld.robot = Object(robot, "robot", f"{robot}.urdf")
    Object("milk", "milk", "milk.stl", [1.42, -1.05, 0.87])  # on the lowest shelf but one
    Object("spoon", "spoon", "spoon.stl", [1.4, 0.89, 0.72])
    Object("bowl", "bowl", "bowl.stl", [1.4, 0.9, 0.89])
    Object("cereal", "cereal", "breakfast_cereal.stl", [1.4, 0.6, 0.97])


def build_table(robot: str) -> None:
    """Loads a table, a robot that is bolted to the table, and the same objects."""
    Object("table", "environment", "table.urdf")
    BulletWorld.robot = body = Object(robot, "robot", f"{robot}.urdf", [0, 0, 0.72])
    for arm in body.description.arms.values():  # the unfolded arm would be in the way of the objects
        body.set_joint_positions(arm.posture("park"))
    Object("milk", "milk", "milk.stl", [0.6, -0.25, 0.83])
    Object("spoon", "spoon", "spoon.stl", [0.3, -0.45, 0.74])
    Object("bowl", "bowl", "bowl.stl", [0.4, -0.2, 0.76])
    Object("cereal", "cereal", "breakfast_cereal.stl", [0.45, -0.5, 0.85])


def missing() -> list[MissingPart]:
    """Returns the parts that a whole breakfast needs and the robot lacks."""
    robot = BulletWorld.robot
    lacks = []
    if not robot.description.drives:
        lacks.append(MissingPart(robot.name, BASE))
    if len(robot.description.arms) < 2:
        lacks.append(MissingPart(robot.name, ARM))
    return lacks


def bring(kind: str, target: LocationDesignator) -> None:
    """Carries the object of a type to a place, and prints its position."""
    body = perform(transporting(object=kind, target=target))
    print(f"{kind}: at", [round(x, 2) for x in body.get_position()])


def breakfast() -> None:
    """Sets all objects on the table, and clears bowl and milk away."""
    lacks = {failure.part for failure in missing()}
    there = LocationDesignator(on="island")
    away = LocationDesignator(on="counter")
    if BASE in lacks:
        there, away = LocationDesignator(on="table", side="left"), LocationDesignator(on="table", side="right")

    for kind in ("bowl", "milk", "spoon"):
        bring(kind, there)
    if ARM in lacks:
        bring("cereal", there)
    else:
        perform(fetching(object="cereal"))
        perform(handing_over(object="cereal"))
        print("cereal: in the other hand")
        perform(parking_arms())
        perform(delivering(object="cereal", target=there))
    print("breakfast is ready")

    bring("bowl", away)
    if BASE in lacks:
        bring("milk", away)
    else:
        perform(opening(container="fridge"))
        bring("milk", LocationDesignator(in_="fridge"))
        perform(closing(container="fridge"))
    print("and cleared away")


def main(robot: str = "pr2") -> None:
    world = BulletWorld()
    world.set_gravity([0, 0, -9.8])
    Object("floor", "environment", "plane.urdf")
    if robot in BOLTED_DOWN:
        build_table(robot)
    else:
        build_kitchen(robot)
    world.settle()  # the objects come to rest
    for failure in missing():
        print(f"{failure}: {WITHOUT[failure.part]}")
    breakfast()
    world.exit()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Sets a breakfast and clears it away.")
    parser.add_argument("--robot", choices=ROBOTS, default="pr2")
    main(parser.parse_args().robot)
