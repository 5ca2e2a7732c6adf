"""The open worlds of this process by their names, and the current one (:mod:`recorder.tracing.context`).

Names are unique among open worlds, since records refer to worlds by name.
"""

from __future__ import annotations

import itertools
import threading
from typing import TYPE_CHECKING, cast

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld, WorldClosed
from pycram.foundation.refusals import refusing
from pycram.world.object import Object
from recorder.tracing import context

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

_lock = threading.Lock()
_numbers = itertools.count(1)
_names: set[str] = set()


def number_anew() -> None:
    """Name worlds from "world_1" on again: from here on this process runs a program from its start."""
    global _numbers  # noqa: PLW0603  the process's
    _numbers = itertools.count(1)


def reserve_name(name: str | None) -> str:
    """Reserve the name of a world that is going to open, until :func:`remove`; "world_1", "world_2", ... for None.

    Raises:
        BadArgument: It isn't a name, or an open world has it.
    """
    with _lock:
        if name is None:
            name = next(free for number in _numbers if (free := f"world_{number}") not in _names)
        elif checks.text("name", name) in _names:
            raise BadArgument("name", name, "a name that no open world has")
        _names.add(name)
        return name


def make_current(world: BulletWorld) -> None:
    """Make an open world current, also one that has just been opened.

    Raises:
        WorldClosed: It has ended.
    """
    with _lock:
        if world.closed:
            raise WorldClosed(world.name, "become current")
        context.make_current(world)


def remove(world: BulletWorld) -> None:
    """Remove a world that has ended or could not open."""
    with _lock:
        _names.discard(world.name)
        context.remove_world(world)


def open_worlds() -> tuple[BulletWorld, ...]:
    """Return the open worlds, the one that was made current last at the end."""
    return cast("tuple[BulletWorld, ...]", context.open_worlds())


def current() -> BulletWorld | None:
    """Return the current world of this branch or thread; None if it has none."""
    return cast("BulletWorld | None", context.current_world())


class CurrentWorld(type):
    """Makes the current world and its robot attributes of the class, as in the thesis' listings."""

    @property
    def current_bullet_world(cls) -> BulletWorld | None:
        """The current world, which is the default wherever one is needed; None if none is open."""
        return current()

    @current_bullet_world.setter
    @refusing(name="current_bullet_world = ...")
    def current_bullet_world(cls, world: BulletWorld) -> None:
        if not isinstance(world, cls):
            raise BadArgument("current_bullet_world", world, "a world")
        make_current(world)

    @property
    def robot(cls) -> Object | None:
        """The robot of the current world."""
        world = current()
        return world.robot if world is not None else None

    @robot.setter
    @refusing(name="robot = ...")
    def robot(cls, robot: Object | None) -> None:
        if robot is not None and not isinstance(robot, Object):
            raise BadArgument("robot", robot, 'an object of type "robot"')
        world = robot.world if robot is not None else current()
        if world is None:
            raise NoWorld
        world.set_robot(robot)
