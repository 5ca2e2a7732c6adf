"""Plans that fail, drawn by a seed, with the call that closed their last chance marked in the source.

A plan has a mistake on the line that ends with ``# closes``: it loads the arm that is needed later, puts something where
another object must go, puts an object out of reach, shuts a drawer in front of a spoon, closes a door, or carries an
object away. Before and after it, the plan makes innocent changes.
"""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

MARK: Final = "# closes"
SPOT: Final = "[-0.8, 1.3, 0.91]"  # the place of the cup in the first run
_BEGIN: Final = """from pycram import perform
from pycram.action_designators import closing, opening, placing
from pycram.bullet_world import BulletWorld, Object
from pycram.motion_designators import detecting, looking, move_arm_joints, moving, pick_up, place

world = BulletWorld()
world.set_gravity([0, 0, -9.8])
Object("floor", "environment", "plane.urdf")
kitchen = Object("kitchen", "environment", "kitchen.urdf")
apple = Object("apple", "apple", "apple.stl", [-1.0, 1.4, 0.95])
"""
_ROBOT: Final = """world.robot = Object("pr2", "robot", "pr2.urdf", {pose})
world.settle()
"""
_DRAWER: Final = "sink_area_left_upper_drawer_main_joint"
PARK: Final = 'perform(move_arm_joints(arms={"left": "park", "right": "park"}))\n'


def _innocent(dice: random.Random, least: int = 0, most: int = 4, ahead: float = 1.3) -> str:
    """A few changes that nothing depends on; ``ahead`` is the x of what the robot faces."""
    drawer = "kitchen_island_left_upper_drawer_main_joint"
    changes = [
        lambda: f"apple.set_position([{dice.uniform(-1.1, -0.9):.3f}, {dice.uniform(1.2, 1.6):.3f}, 0.95])",
        lambda: f'kitchen.set_joint_position("{drawer}", {dice.uniform(0, 0.2):.3f})',
        lambda: f"perform(looking(target=[{ahead}, {dice.uniform(0.5, 1.1):.3f}, 0.9]))",
    ]
    return "".join(f"{dice.choice(changes)()}\n" for _ in range(dice.randint(least, most)))


def loaded(dice: random.Random) -> str:
    """The arm that takes the cup is needed for the bowl, which the other arm can't reach."""
    y = dice.uniform(0.60, 0.68)
    return (
        _BEGIN
        + f'cup = Object("cup", "cup", "cup.stl", [{dice.uniform(1.28, 1.32):.3f}, {y:.3f}, 0.92])\n'
        + f'bowl = Object("bowl", "bowl", "bowl.stl", [1.3, {y - 0.3:.3f}, 0.9])\n'
        + _ROBOT.format(pose="[0.65, 0.7, 0]")
        + _innocent(dice)
        + f'perform(pick_up(object=cup, arm="right"))  {MARK}\n'
        + 'perform(move_arm_joints(arms={"right": "park"}))\n'
        + _innocent(dice)
        + 'perform(pick_up(object=bowl, arm="right"))\n'
        + "world.exit()\n"
    )


def occupied(dice: random.Random) -> str:
    """The place that the bowl gets is where the cup must go: SPOT, which the first run tells."""
    there = PARK + "perform(moving(target=[-0.3, 1, 0], orientation=[0, 0, 1, 0]))\n"
    return (
        _BEGIN
        + f'bowl = Object("bowl", "bowl", "bowl.stl", [1.3, {dice.uniform(0.45, 0.55):.3f}, 0.9])\n'
        + f'cup = Object("cup", "cup", "cup.stl", [1.3, {dice.uniform(0.75, 0.85):.3f}, 0.92])\n'
        + _ROBOT.format(pose="[0.65, 0.7, 0]")
        + 'perform(pick_up(object=bowl, arm="right"))\n'
        + there
        + _innocent(dice, ahead=-0.8)
        + f'perform(placing(object=bowl, target="island"))  {MARK}\n'
        + PARK
        + "perform(moving(target=[0.65, 0.7, 0], orientation=[0, 0, 0, 1]))\n"
        + _innocent(dice)
        + 'perform(pick_up(object=cup, arm="right"))\n'
        + there
        + f'perform(place(object=cup, target={SPOT}, arm="right"))\n'
        + "world.exit()\n"
    )


def drawer(dice: random.Random) -> str:
    """The drawer is shut before the spoon is taken out of it, by the robot or by somebody."""
    by_robot = dice.random() < 0.5
    shut = f'kitchen.set_joint_position("{_DRAWER}", {dice.uniform(0, 0.03):.3f})'
    if by_robot:
        shut = 'perform(closing(container="sink left upper drawer"))'
    y = dice.uniform(0.88, 0.9)
    return (
        _BEGIN
        + f'spoon = Object("spoon", "spoon", "spoon.stl", [{dice.uniform(1.38, 1.41):.3f}, {y:.3f}, 0.72])\n'
        + _ROBOT.format(pose="[0.5, 0.9, 0]")
        + 'perform(opening(container="sink left upper drawer"))\n'
        + _innocent(dice)
        + f"{shut}  {MARK}\n"
        + _innocent(dice, most=1 if by_robot else 4)  # a repair moves a call by two lines at most
        + 'perform(pick_up(object=spoon, arm="left"))\n'
        + "world.exit()\n"
    )


def away(dice: random.Random) -> str:
    """The cup is put where the robot, which doesn't move any more, can't reach it."""
    far = f"[{dice.uniform(1.62, 1.68):.3f}, {dice.uniform(0.6, 0.9):.3f}, 0.92]"
    return (
        _BEGIN
        + f'cup = Object("cup", "cup", "cup.stl", [1.3, {dice.uniform(0.6, 0.8):.3f}, 0.92])\n'
        + _ROBOT.format(pose="[0.65, 0.7, 0]")
        + _innocent(dice, 1)
        + f"cup.set_position({far})  {MARK}\n"
        + _innocent(dice, 1)
        + f'perform(pick_up(object=cup, arm="{dice.choice(("left", "right"))}"))\n'
        + "world.exit()\n"
    )


def door(dice: random.Random) -> str:
    """The fridge is closed in front of the bottle."""
    return (
        _BEGIN
        + f'bottle = Object("bottle", "bottle", "bottle.stl", [{dice.uniform(1.41, 1.43):.3f}, {dice.uniform(-1.06, -1.04):.3f}, 0.9])\n'
        + 'kitchen.set_joint_position("iai_fridge_door_joint", 1.5)\n'
        + _ROBOT.format(pose="[0.722, -0.544, 0], [0, 0, -0.279, 0.96]")
        + _innocent(dice)
        + f'kitchen.set_joint_position("iai_fridge_door_joint", {dice.uniform(0, 0.3):.3f})  {MARK}\n'
        + _innocent(dice)
        + 'perform(pick_up(object=bottle, arm="left"))\n'
        + "world.exit()\n"
    )


KINDS: Final[dict[str, Callable[[random.Random], str]]] = {
    "loaded": loaded,
    "occupied": occupied,
    "drawer": drawer,
    "away": away,
    "door": door,
}


def drawn(kind: str, seed: int) -> str:
    """The plan of a kind and a seed."""
    return KINDS[kind](random.Random(f"{kind} {seed}"))


def closing_line(plan: str) -> int:
    """The number of the line that closed the chance."""
    return next(number for number, line in enumerate(plan.splitlines(), 1) if line.endswith(MARK))
