"""Identity of a process: a forked child is another one, unless it continues its parent, which then only waits.

So a recording knows whose it is: its process's and that of whoever continues it, but not other children's.
"""

from __future__ import annotations

import os

_identity: int | None = None  # of a process that continues another one
_continuing = False  # while one is forked


def process() -> int:
    """Return the identity of this process: its number, or that of the process that it continues."""
    return os.getpid() if _identity is None else _identity


def fork_continuation() -> int:
    """Fork a child that goes on as this process; this one must do nothing more that others see. Returns 0 in the child.

    :func:`recorder.tracing.forking.fork_continuation` is how it is called: no journal moves there.
    """
    global _identity, _continuing  # noqa: PLW0603  a process has one identity
    before, _identity, _continuing = _identity, process(), True
    child = -1
    try:
        child = os.fork()
    finally:
        _continuing = False
        if child:
            _identity = before
    return child


def _in_child() -> None:
    global _identity  # noqa: PLW0603  as above
    if not _continuing:
        _identity = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_child)
