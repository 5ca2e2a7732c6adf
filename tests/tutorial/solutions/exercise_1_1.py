from pycram.bullet_world import BulletWorld, Object

with BulletWorld() as world:
    world.set_gravity([0, 0, -9.81])
    Object("floor", "environment", "plane.urdf")
    Object("kitchen", "environment", "kitchen.urdf")
    Object("cup", "cup", "cup.stl", [-0.8, 1.0, 0.92])
    Object("bowl", "bowl", "bowl.stl", [-0.8, 0.6, 0.9])
    world.settle()
