"""Sets up a laboratory of its own, with a UR5."""

from household import perform

from pycram.bullet_world import BulletWorld, Object

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
Object("table", "environment", "table.urdf")
Object("ur5", "robot", "ur5.urdf", [0, 0, 0.72])
cup = Object("cup", "cup", "cup.stl", [0.5, 0.6, 0.77])
world.settle()
perform(type="pick-up", object=cup)  # @cause
world.exit()
