"""The open worlds of this process, and the current one.

The one that was opened last is current; when it ends, the one before it is current again. A thread that opens a world
or makes one current does so for itself and its branches, and for all threads that haven't done so themselves: each
thread keeps its own world. A branch does so for itself and its own branches, not for the rest of its thread. Names are
unique among open worlds, since records refer to worlds by name.
"""

from __future__ import annotations

import itertools
import threading
import weakref
from contextvars import ContextVar
from typing import TYPE_CHECKING

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld, WorldClosed
from pycram.foundation.refusals import refusing
from pycram.world.object import Object
from recorder.tracing import journal
from recorder.tracing.branch_identity import current_ident

if TYPE_CHECKING:
    from pycram.world.world import BulletWorld

_lock = threading.Lock()
_numbers = itertools.count(1)
_names: set[str] = set()
_open: tuple[BulletWorld, ...] = ()
_branch_threads: dict[str, int] = {}  # the threads of the branches that made worlds current, by the worlds' names
_chosen: ContextVar[tuple[weakref.ref[BulletWorld], ...]] = ContextVar("pycram_world", default=())


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
    global _open  # noqa: PLW0603  there is one process
    with _lock:
        if world.closed:
            raise WorldClosed(world.name, "become current")
        _open = (*(known for known in _open if known is not world), world)
        _branch_threads[world.name] = threading.get_ident() if current_ident() < 0 else 0
    _chosen.set((*(chosen for chosen in _chosen.get() if chosen() in _open[:-1]), weakref.ref(world)))
    journal.make_current(world)


def remove(name: str) -> None:
    """Remove a world that has ended or could not open, by its name."""
    global _open  # noqa: PLW0603  there is one process
    with _lock:
        _names.discard(name)
        _open = tuple(world for world in _open if world.name != name)
        _branch_threads.pop(name, None)


def open_worlds() -> tuple[BulletWorld, ...]:
    """Return the open worlds, the one that was made current last at the end."""
    return _open


def current() -> BulletWorld | None:
    """Return the current world of this branch or thread; None if it has none."""
    for chosen in reversed(_chosen.get()):
        world = chosen()
        if world is not None and not world.closed:
            return world
    thread = threading.get_ident()
    return next((world for world in reversed(_open) if _branch_threads.get(world.name) != thread), None)


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
