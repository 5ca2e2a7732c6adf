"""The open worlds of this process, and which one is current.

The one that was opened, or made current, last is current; when it ends, the one before it is current again. A thread
does so for itself and its branches, and for all threads that haven't done so themselves: each thread keeps its own
world. A branch does so for itself and its own branches, not for the rest of its thread.
"""

from __future__ import annotations

import threading
import weakref
from contextvars import ContextVar
from typing import TYPE_CHECKING, Protocol

from recorder.tracing.branch_identity import current_ident

if TYPE_CHECKING:
    from collections.abc import Collection


class World(Protocol):
    """A world, as far as records name it."""

    name: str
    sim_step: int


_lock = threading.Lock()
# As they became current, each with the thread of the branch that made it so, or 0; replaced, never changed.
_open: dict[World, int] = {}
_chosen: ContextVar[tuple[weakref.ref[World], ...]] = ContextVar("pycram_world", default=())


def make_current(world: World) -> None:
    """Make a world current, also one that has just been opened."""
    global _open  # noqa: PLW0603  there is one process
    with _lock:
        earlier = [chosen for chosen in _chosen.get() if chosen() is not world and chosen() in _open]
        _open = {**_without(world), world: threading.get_ident() if current_ident() < 0 else 0}
        _chosen.set((*earlier, weakref.ref(world)))


def remove(world: World) -> None:
    """Remove a world that has ended."""
    global _open  # noqa: PLW0603  there is one process
    with _lock:
        _open = _without(world)


def _without(world: World) -> dict[World, int]:
    return {other: thread for other, thread in _open.items() if other is not world}


def open_worlds() -> tuple[World, ...]:
    """The open worlds, the one that was made current last at the end."""
    return tuple(_open)


def current(among: Collection[World] | None = None) -> World | None:
    """The current world of this branch or thread, of all or of some that are open; None if it has none."""
    known = _open
    for chosen in reversed(_chosen.get()):
        if (world := chosen()) in known and (among is None or world in among):
            return world
    worlds = {world: thread for world, thread in known.items() if among is None or world in among}
    this_thread = threading.get_ident()
    return next((world for world, thread in reversed(worlds.items()) if thread != this_thread), None)
