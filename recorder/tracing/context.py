"""The context of running code: its branch or thread, the current world, and the room on its stack.

The current world is the world that was opened or made current last; when it closes, the previous world becomes current
again. If a thread chooses the current world, the choice applies to the thread, its branches, and all threads that
haven't chosen. If a branch chooses the current world, the choice applies only to the branch and its own branches.
"""

from __future__ import annotations

import itertools
import sys
import threading
import weakref
from collections.abc import Collection
from contextvars import ContextVar
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from recorder.records import escaped

if TYPE_CHECKING:
    from recorder.tracing.journal import Journal


class BranchIdentity(NamedTuple):
    """The identity of a branch of a plan."""

    thread: int  # ident of the branch's thread; a thread that the branch starts may have the branch's context
    ident: int  # a negative number, because idents of threads are positive
    name: str


_branch: ContextVar[BranchIdentity | None] = ContextVar("pycram_branch", default=None)
_idents: Final = itertools.count(-1, -1)


def new_branch(name: str) -> BranchIdentity:
    """Return the identity of a new branch of this thread."""
    return BranchIdentity(threading.get_ident(), next(_idents), escaped(name))


def current_branch() -> BranchIdentity | None:
    """Return the branch of the current context; None outside of branches."""
    return _branch.get()


def enter_branch(branch: BranchIdentity | None) -> None:
    """Mark the current context as part of a branch; with None, as outside of branches."""
    _branch.set(branch)


def current_name() -> str:
    """Return the name of the running branch; outside of branches, of the thread."""
    branch = _branch.get()
    if branch is None or branch.thread != threading.get_ident():
        return escaped(threading.current_thread().name)
    return branch.name


def current_ident() -> int:
    """Return the ident of the running branch; outside of branches, of the thread."""
    branch, thread = _branch.get(), threading.get_ident()
    return thread if branch is None or branch.thread != thread else branch.ident


class KnownWorld(Protocol):
    """A world with the name and clock that records have."""

    name: str
    sim_step: int

    def record_keyframe(self, journal: Journal) -> None:
        """Append the whole state to a journal, with the world's files."""


_lock = threading.Lock()
# Open worlds in the order in which they became current, each with the thread of the branch that chose the world; 0 if
# no branch chose it. A change replaces the dictionary.
_open: dict[KnownWorld, int] = {}
_chosen: ContextVar[tuple[weakref.ref[KnownWorld], ...]] = ContextVar("pycram_world", default=())


def make_current(world: KnownWorld) -> None:
    """Make an open or newly opened world current."""
    global _open  # noqa: PLW0603  the process has only one dictionary
    with _lock:
        earlier = [chosen for chosen in _chosen.get() if chosen() is not world and chosen() in _open]
        _open = {**_without(world), world: threading.get_ident() if current_ident() < 0 else 0}
        _chosen.set((*earlier, weakref.ref(world)))


def remove_world(world: KnownWorld) -> None:
    """Remove a closed world."""
    global _open  # noqa: PLW0603  the process has only one dictionary
    with _lock:
        _open = _without(world)


def _without(world: KnownWorld) -> dict[KnownWorld, int]:
    return {other: thread for other, thread in _open.items() if other is not world}


def open_worlds() -> tuple[KnownWorld, ...]:
    """Return the open worlds in the order in which they became current."""
    return tuple(_open)


def current_world(among: Collection[KnownWorld] | None = None) -> KnownWorld | None:
    """Return the current world of this branch or thread, among all open worlds or ``among``; None if there is none."""
    known = _open
    for chosen in reversed(_chosen.get()):
        if (world := chosen()) in known and (among is None or world in among):
            return world
    worlds = {world: thread for world, thread in known.items() if among is None or world in among}
    this_thread = threading.get_ident()
    return next((world for world, thread in reversed(worlds.items()) if thread != this_thread), None)


FOR_RECORD: Final = 40  # a record needs at most this many stack frames, with the compression of the file
FOR_TASK: Final = 120  # a task needs at most this many stack frames for its records, its block and its end

_COUNTED: Final = 4  # maximum number of times that Python counts a frame, because C functions count, too
_outside = 0  # maximum number of frames below a greenlet; Python counts these frames for the greenlet, too


def require_stack_room(frames: int) -> None:
    """Raise RecursionError if the stack has no room for this number of frames; fast on a shallow stack."""
    shallow = (sys.getrecursionlimit() - frames) // _COUNTED - _outside
    if shallow > 0:
        try:
            sys._getframe(shallow)  # noqa: SLF001  inspect.stack() would read source files
        except ValueError:  # the stack has fewer frames than that
            return
    try:
        _call(frames)
    except RecursionError as error:
        raise RecursionError(*error.args) from None  # the frames of the check itself don't count


def greenlets_begin() -> None:
    """Store the number of frames below a greenlet. Python counts the frames below a greenlet, but doesn't show them."""
    global _outside  # noqa: PLW0603  a number that is too large only makes checks slower
    below, frame = 0, sys._getframe()  # noqa: SLF001  as above
    while frame.f_back is not None:
        below, frame = below + 1, frame.f_back
    _outside = max(_outside, below)


def _call(frames: int) -> None:
    if frames:
        _call(frames - 1)
