"""Where code runs: in a thread, or in a branch of a plan, which shares its thread with other branches.

A branch has a call stack, a context and a name of its own, which records have as their thread's name.
"""

from __future__ import annotations

import itertools
import threading
from contextvars import ContextVar
from typing import Final, NamedTuple


class Branch(NamedTuple):
    """A branch of a plan.

    Attributes:
        thread: identifies the thread that it runs in. Another one that it starts may inherit its context.
        ident: its own number; threads have positive ones.
        name: what people call it.
    """

    thread: int
    ident: int
    name: str


_branch: ContextVar[Branch | None] = ContextVar("pycram_branch", default=None)
_idents: Final = itertools.count(-1, -1)


def new_branch(name: str) -> Branch:
    """A branch that runs in this thread, by its name in records."""
    return Branch(threading.get_ident(), next(_idents), name)


def current_branch() -> Branch | None:
    """The branch whose context this is; None outside of branches."""
    return _branch.get()


def enter_branch(branch: Branch | None) -> None:
    """Makes this context that of a branch from here on; None for outside of branches."""
    _branch.set(branch)


def name() -> str:
    """The name of the branch that runs here; outside of branches that of the thread."""
    branch = _branch.get()
    if branch is None or branch.thread != threading.get_ident():
        return threading.current_thread().name
    return branch.name


def ident() -> int:
    """A number that identifies the branch that runs here; outside of branches the thread's."""
    branch, thread = _branch.get(), threading.get_ident()
    return thread if branch is None or branch.thread != thread else branch.ident
