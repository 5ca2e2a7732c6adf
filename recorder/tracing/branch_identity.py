"""Identity of running code: a thread, or a branch of a plan, which shares its thread with other branches.

A branch has a call stack, a context and a name of its own; records have that in place of the thread's name.
"""

from __future__ import annotations

import itertools
import threading
from contextvars import ContextVar
from typing import Final, NamedTuple

from recorder.records import escaped


class BranchIdentity(NamedTuple):
    """Identity of a branch of a plan.

    Attributes:
        thread: Ident of the thread that it runs in; a thread that it starts may inherit its context.
        ident: Negative, as those of threads are positive.
        name: Its name in records.
    """

    thread: int
    ident: int
    name: str


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
