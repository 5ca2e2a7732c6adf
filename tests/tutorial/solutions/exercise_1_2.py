from pycram.bullet_world import BulletWorld, Object

with BulletWorld() as world:
    world.set_gravity([0, 0, -9.81])
    Object("floor", "environment", "plane.urdf")
    Object("kitchen", "environment", "kitchen.urdf")
    Object("milk", "milk", "milk.stl", [1.3, 0.9, 0.9], [0.7071, 0, 0, 0.7071])
    world.settle()
