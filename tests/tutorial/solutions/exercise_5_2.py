from pycram import perform
from pycram.action_designators import transporting
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import LocationDesignator

with BulletWorld() as world:
    world.set_gravity([0, 0, -9.81])
    Object("floor", "environment", "plane.urdf")
    Object("table", "environment", "table.urdf")
    world.robot = Object("panda", "robot", "panda.urdf", [0, 0, 0.72])
    world.robot.set_joint_positions(world.robot.description.arm("panda").posture("park"))
    bowl = Object("bowl", "bowl", "bowl.stl", [0.4, -0.2, 0.76])
    world.settle()
    perform(transporting(object=bowl, target=LocationDesignator(on="table", side="left")))
