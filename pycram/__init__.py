"""High-level robot plans, run in a physics world, with everything that happens on record."""

# General layout, from the bottom up; each room imports only rooms above it in this list:
#
# foundation/  failures, checks of arguments, names. Imports nothing of pycram.
# scheduling/  branches of a plan as greenlets that take turns: cancellation, futures, locks.
# physics/     the only room that knows PyBullet.     models/  from a model's file to a checked URDF; robots as data.
# world/       worlds and objects. Every change is a world transaction: validate, act, read back, record, fire events.
# vision/      what a camera sees.     language/  par, seq, pursue, try_all, retries, timeouts, cleanup.
# reasoning/   queries that leave no trace: collision, kinematics, grasping, visibility, stability.
# motions/     motion designators, their resolvers, the resources they move, and the process modules that execute them.
# fluents/     values that branches wait for and react to, also those that follow a world.
# projection/  actions tried in a copy of the process.     actions/  what a robot is to do, not how, on top of these.
#
# bullet_world, bullet_world_reasoning, designator, motion_designators, process_module, fluent, event, failures, tasks:
# the names of the thesis, from which plans import. cli: the commands "pycram demo" and "pycram run".
