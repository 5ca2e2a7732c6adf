"""The open worlds of this process, and which of them is current.

The one that was opened last is current; when it ends, the one before it is current again. A thread that opens a world
or makes one current does so for itself and its branches, so that threads with a world each don't take each other's; and
for all that have not chosen. Names are unique among open worlds, since records know worlds by their names.
"""

from __future__ import annotations

import itertools
import threading
import weakref
from contextvars import ContextVar
from typing import TYPE_CHECKING

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld, WorldClosed
from pycram.world.object import Object
from recorder.tracing import journal

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

_lock = threading.Lock()
_numbers = itertools.count(1)
_names: set[str] = set()
_open: tuple[BulletWorld, ...] = ()
_chosen: ContextVar[weakref.ref[BulletWorld] | None] = ContextVar("pycram_world", default=None)


def take_name(name: str | None) -> str:
    """Takes a name for a world that is going to open.

    Args:
        name: the name that is wanted; "world_1", "world_2", ... for None.

    Returns:
        The name, which nothing else gets until :func:`leave` gives it back.

    Raises:
        BadArgument: not a name, or an open world has it.
    """
    with _lock:
        if name is None:
            name = next(free for number in _numbers if (free := f"world_{number}") not in _names)
        elif checks.text("name", name) in _names:
            raise BadArgument("name", name, "a name that no open world has")
        _names.add(name)
        return name


def enter(world: BulletWorld) -> None:
    """Makes a world current, one that just opened or another one.

    Args:
        world: an open world.

    Raises:
        WorldClosed: it has ended.
    """
    global _open  # noqa: PLW0603  there is one process
    with _lock:
        if world.closed:
            raise WorldClosed(world.name, "become current")
        _open = (*(other for other in _open if other is not world), world)
    _chosen.set(weakref.ref(world))
    journal.make_current(world)


def leave(name: str) -> None:
    """Forgets a world that has ended or could not open.

    Args:
        name: its name.
    """
    global _open  # noqa: PLW0603  there is one process
    with _lock:
        _names.discard(name)
        _open = tuple(world for world in _open if world.name != name)


def opened() -> tuple[BulletWorld, ...]:
    """The open worlds; the last one is current."""
    return _open


def current() -> BulletWorld | None:
    """The world that is current here; None if none is open."""
    chosen = _chosen.get()
    world = chosen() if chosen is not None else None
    if world is not None and not world.closed:
        return world
    return _open[-1] if _open else None


class CurrentWorld(type):
    """Makes the current world and its robot readable and settable on the class, as in the thesis' listings."""

    @property
    def current_bullet_world(cls) -> BulletWorld | None:
        """The default world of all that needs one: the one opened last that is still open."""
        return current()

    @current_bullet_world.setter
    def current_bullet_world(cls, world: BulletWorld) -> None:
        if not isinstance(world, cls):
            raise BadArgument("current_bullet_world", world, "a world")
        enter(world)

    @property
    def robot(cls) -> Object | None:
        """The robot of the current world."""
        world = current()
        return world.robot if world is not None else None

    @robot.setter
    def robot(cls, robot: Object | None) -> None:
        if robot is not None and not isinstance(robot, Object):
            raise BadArgument("robot", robot, 'an object of type "robot"')
        world = robot.world if robot is not None else current()
        if world is None:
            raise NoWorld
        world.set_robot(robot)
