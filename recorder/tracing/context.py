"""The context of running code: its branch or thread, the current world, and the room on its stack.

A branch of a plan shares its thread with other branches. It has a call stack, a context and a name of its own; records
have that name in place of the thread's.

The world that was opened, or made current, last is current; when it ends, the one before it is current again. A thread
chooses for itself and its branches, and for all threads that haven't chosen themselves. A branch chooses for itself and
its own branches, not for the rest of its thread.

A record that has to be complete isn't begun where a RecursionError would break it off.
"""

from __future__ import annotations

import itertools
import sys
import threading
import weakref
from contextvars import ContextVar
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from recorder.records import escaped

if TYPE_CHECKING:
    from collections.abc import Collection


class BranchIdentity(NamedTuple):
    """Identity of a branch of a plan."""

    thread: int  # ident of the thread that it runs in; a thread that it starts may inherit its context
    ident: int  # negative, as those of threads are positive
    name: str  # in records


_branch: ContextVar[BranchIdentity | None] = ContextVar("pycram_branch", default=None)
_idents: Final = itertools.count(-1, -1)


def new_branch(name: str) -> BranchIdentity:
    """Return the identity of a new branch of this thread."""
    return BranchIdentity(threading.get_ident(), next(_idents), escaped(name))


def current_branch() -> BranchIdentity | None:
    """Return the branch whose context this is; None outside of branches."""
    return _branch.get()


def enter_branch(branch: BranchIdentity | None) -> None:
    """Make this context that of a branch, for good; None for outside of branches."""
    _branch.set(branch)


def current_name() -> str:
    """Return the name of the running branch; outside of branches that of the thread."""
    branch = _branch.get()
    if branch is None or branch.thread != threading.get_ident():
        return escaped(threading.current_thread().name)
    return branch.name


def current_ident() -> int:
    """Return the ident of the running branch; outside of branches the thread's."""
    branch, thread = _branch.get(), threading.get_ident()
    return thread if branch is None or branch.thread != thread else branch.ident


class KnownWorld(Protocol):
    """A world, as far as records name it."""

    name: str
    sim_step: int


_lock = threading.Lock()
# As they became current, each with the thread of the branch that made it so, or 0; replaced, never changed.
_open: dict[KnownWorld, int] = {}
_chosen: ContextVar[tuple[weakref.ref[KnownWorld], ...]] = ContextVar("pycram_world", default=())


def make_current(world: KnownWorld) -> None:
    """Make a world current, also one that has just been opened."""
    global _open  # noqa: PLW0603  there is one process
    with _lock:
        earlier = [chosen for chosen in _chosen.get() if chosen() is not world and chosen() in _open]
        _open = {**_without(world), world: threading.get_ident() if current_ident() < 0 else 0}
        _chosen.set((*earlier, weakref.ref(world)))


def remove_world(world: KnownWorld) -> None:
    """Remove a world that has ended."""
    global _open  # noqa: PLW0603  there is one process
    with _lock:
        _open = _without(world)


def _without(world: KnownWorld) -> dict[KnownWorld, int]:
    return {other: thread for other, thread in _open.items() if other is not world}


def open_worlds() -> tuple[KnownWorld, ...]:
    """The open worlds, the one that was made current last at the end."""
    return tuple(_open)


def current_world(among: Collection[KnownWorld] | None = None) -> KnownWorld | None:
    """The current world of this branch or thread, of all or of some that are open; None if it has none."""
    known = _open
    for chosen in reversed(_chosen.get()):
        if (world := chosen()) in known and (among is None or world in among):
            return world
    worlds = {world: thread for world, thread in known.items() if among is None or world in among}
    this_thread = threading.get_ident()
    return next((world for world, thread in reversed(worlds.items()) if thread != this_thread), None)


#: Frames that recording takes at most, down to the file's compression.
FOR_RECORD: Final = 40
#: Frames that a task takes for its records, its block and its end.
FOR_TASK: Final = 120

_COUNTED: Final = 4  # what a frame may count in Python's limit, with the functions in C that called it
_outside = 0  # most frames below the first one of a greenlet so far; Python counts them for the greenlet too


def require_stack_room(frames: int) -> None:
    """Raise RecursionError unless there is room for that many frames.

    Where the stack is shallow, as it mostly is, it takes as long as 6 calls; elsewhere as long as calls that deep.
    """
    shallow = (sys.getrecursionlimit() - frames) // _COUNTED - _outside
    if shallow > 0:
        try:
            sys._getframe(shallow)  # noqa: SLF001  inspect.stack() reads source files
        except ValueError:  # there are fewer
            return
    try:
        _call(frames)
    except RecursionError as error:
        raise RecursionError(*error.args) from None  # without the frames that were tried


def greenlets_begin() -> None:
    """Take note that greenlets begin here: Python counts the frames below for them, too, but doesn't show them."""
    global _outside  # noqa: PLW0603  too many frames do no harm: other threads look closer then
    below, frame = 0, sys._getframe()  # noqa: SLF001  as above
    while frame.f_back is not None:
        below, frame = below + 1, frame.f_back
    _outside = max(_outside, below)


def _call(frames: int) -> None:
    if frames:
        _call(frames - 1)
