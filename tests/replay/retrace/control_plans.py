"""Small plans, one for each sort of thing that plans do, and the demos; their forks are to be the runs themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Final

REPO: Final = Path(__file__).parents[3]

_HEAD: Final = """\
import random
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.event import Event
from pycram.failures import PlanFailure, UsageError
from pycram.fluent import Fluent, whenever
from pycram.fluents.world import contact, position
from pycram.language import *
from pycram.process_module import ProcessModule
from pycram.projection import project, project_all
world = BulletWorld(name="table")
world.set_gravity([0, 0, -9.8])
floor = Object("floor", "environment", "plane.urdf")
milk = Object("milk", "milk", "milk.stl", [0, 0, 0.3])
cup = Object("cup", "cup", "cup.stl", [0.5, 0, 0.3])
def move(body, *places):
    for place in places:
        body.set_position([place, random.random(), 0.5])
def fail(text="no"):
    raise PlanFailure(text)
"""
_PLANS: Final = {
    "par": """
with par as s:
    s(move, milk, 1, 2, 3)
    s(move, cup, 4, 5, 6)
    s(world.simulate, 0.1)
""",
    "blocks": """
with par as s:
    with try_all as t:
        t(fail)
        t(move, milk, 1)
    with pursue as t:
        t(move, cup, 2, 3, 4, 5)
        t(move, milk, 6, 7)
    with seq as t:
        t(world.simulate, 0.05)
        t(world.simulate, 0.05)
with try_in_order as t:
    t(fail)
    t(move, cup, 8)
""",
    "fluents": """
level, done = Fluent(0, "level"), Fluent(None, "done")
def count():
    for number in range(6):
        level.set_value(number)
    done.set_value(True)
def follow():
    for _ in whenever((level > 2).pulsed()):
        move(milk, level.get_value())
with pursue as s:
    s(done.wait_for)
    s(follow)
    s(count)
assert (level * 2 == 10).wait_for(60)
""",
    "fluents of a world": """
touching = contact(milk, floor)
def fall():
    for _ in range(8):
        world.simulate(0.05)
with par as s:
    s(touching.wait_for)
    s(fall)
height = position(cup)
cup.set_position([0, 0, 3])
assert height.get_value()[2] == 3
""",
    "physics": """
things = [Object(f"bowl {n}", "bowl", "bowl.stl", [0.02 * n, 0, 0.5 + 0.2 * n]) for n in range(5)]
for _ in range(5):
    world.simulate(0.15)
    things.pop().set_position([0.1, random.random() / 10, 1])
world.settle(1)
print(btr.contact(milk, floor), btr.supporting(floor, milk), btr.stable(cup))
""",
    "attachments": """
milk.attach(cup)
for turn in range(6):
    milk.set_position_and_orientation([turn, 0, 1], [0, 0, 0.6, 0.8])
    world.simulate(0.05)
milk.detach(cup)
cup.attach(milk)
world.simulate(0.2)
cup.remove()
""",
    "two worlds": """
other = BulletWorld(name="other")
other.set_gravity([0, 0, -1.6])
apple = Object("apple", "apple", "apple.stl", [0, 0, 3])
for _ in range(5):
    other.simulate(0.1)
    world.simulate(0.1)
    apple.set_position([0, random.random(), 2])
other.exit()
world.simulate(0.1)
""",
    "two worlds at once": """
other = BulletWorld(name="other")
apple = Object("apple", "apple", "apple.stl", [0, 0, 3])
with par as s:
    for each, body in ((world, milk), (other, apple)):
        s(each.simulate, 0.1)
        s(move, body, 1, 2)
        s(each.simulate, 0.1)
""",
    "failures that are handled": """
def try_it(number):
    move(milk, number)
    if number < 3:
        fail(f"not yet: {number}")
places = [2, 3]
for attempt in failure_handling(3, place=1).on(PlanFailure, lambda failure: {"place": places.pop(0)}):
    with attempt:
        try_it(attempt["place"])
try:
    with par as s:
        s(fail, "one")
        s(move, cup, 1, 2, 3)
except PlanFailure as failure:
    print(failure)
""",
    "a failure that isn't": """
with par as s:
    s(move, cup, 1, 2, 3)
    with seq as t:
        t(move, milk, 1)
        t(fail, "for good")
""",
    "an error": """
move(milk, 1, 2)
numbers = {}
with par as s:
    s(move, cup, 1, 2)
    s(lambda: numbers["none"])
""",
    "refusals": """
for wrong in (lambda: milk.set_position([float("nan"), 0, 0]), lambda: milk.attach(milk), lambda: milk.joint,
              lambda: world.simulate(-1), lambda: world.get_object("nothing"), lambda: btr.contact(milk, 3)):
    try:
        wrong()
    except (UsageError, PlanFailure, AttributeError) as error:
        print(type(error).__name__)
    world.simulate(0.01)
""",
    "events": """
bell = Event("bell", "door")
def deliver(customer):
    move(milk, len(customer))
    if customer == "Anna":
        bell.fire("Bo")
bell += deliver
attached = world.get_attachment_event()
attached += lambda *_: cup.set_color([random.random(), 0, 0, 1])
bell.fire("Anna")
milk.attach(cup)
bell -= deliver
bell.fire("nobody")
""",
    "timeouts and cleanups": """
def long():
    with finally_(lambda: move(milk, 9)):
        for _ in range(20):
            world.simulate(0.05)
for seconds in (0.2, 5):
    try:
        with timeout(seconds, simulated=True):
            long()
    except PlanFailure as failure:
        print(failure)
""",
    "projections": """
def drop(x):
    milk.set_position([x, random.random(), 0.4])
    world.simulate(0.2)
    if x == 1:
        fail("there not")
    return milk.get_position()
imagined = project(drop, 2)
assert drop(2) == imagined.result
with par as s:
    s(project_all, [(drop, 1), (drop, 3), (drop, 4)])
    s(move, cup, 1, 2)
drop(3)
""",
    "saved states": """
saved = world.save()
for turn in range(4):
    move(milk, turn)
    milk.attach(cup)
    world.simulate(0.1)
    world.restore(saved)
world.reset()
""",
    "motions": """
robot = Object("ur5", "robot", "ur5.urdf", [3, 0, 0])
world.robot = robot
def perform(**slots):
    return ProcessModule.perform(MotionDesignator([(name.replace("_", "-"), slot) for name, slot in slots.items()]))
arm, = robot.description.arms
with par as s:
    s(perform, type="opening-gripper", gripper=arm)
    s(move, milk, 1, 2)
try:
    perform(type="pick-up", object=milk, arm=arm)
except PlanFailure as failure:
    print(type(failure).__name__)
perform(type="move-arm-joints", **{f"{arm}_arm": "park"})
""",
    "trajectories": """
from types import SimpleNamespace
from pycram.fluents.world import joint
from pycram.world.driving import follow
from pycram.world.trajectory import Trajectory
robot = Object("ur5", "robot", "ur5.urdf", [3, 0, 0.5])
def turn(name, angle, seconds):
    start, rest = robot.get_joint_position(name), (0.0,)
    way = Trajectory((name,), (0.0, seconds), ((start,), (start + angle,)), (rest, rest))
    follow(world, [(robot, SimpleNamespace(trajectory=way, search=None))])
with par as s:
    s(turn, "shoulder_pan_joint", 0.5, 0.3)
    with pursue as t:
        t((joint(robot, "elbow_joint") > 0.2 + 0.1 * random.random()).wait_for)
        t(turn, "elbow_joint", 1.0, 0.8)
    s(turn, "wrist_1_joint", 0.4, 0.15)
    s(world.simulate, 0.05)
print(project(turn, "shoulder_pan_joint", -0.2, 0.2).duration)
try:
    with timeout(0.2, simulated=True):
        turn("shoulder_pan_joint", -0.5, 1.0)
except PlanFailure as failure:
    print(failure)
""",
    "what chance decides": """
import numpy
for name in {"milk", "cup", "bowl", "spoon"}:
    if name in {body.name for body in world.objects}:
        move(world.get_object(name), numpy.random.rand())
random.shuffle(order := [move] * 3 + [fail])
with try_all as s:
    for number, action in enumerate(order):
        s(action, *((milk, number) if action is move else ()))
""",
}
#: The plans by name: the demos last, as they take longest.
PLANS: Final[dict[str, str]] = {name: _HEAD + text for name, text in _PLANS.items()} | {
    demo: (REPO / "demos" / f"{demo}.py").read_text() for demo in ("fails_to_reach", "set_the_table")
}
