"""Parts of operating systems that Windows lacks: locks on files, owners of files, and flags of ``os.open``."""

from __future__ import annotations

import errno
import os
from typing import Final

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

HAS_LOCKS: Final = fcntl is not None
HAS_OWNERS: Final = hasattr(os, "getuid")
#: Flags for opening files: children don't inherit the files, and Windows doesn't convert their bytes. Flags that a
#: system doesn't support are 0.
OPENED: Final = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0)  # flag for not following links


def lock(descriptor: int, *, shared: bool = False, wait: bool = False, by_process: bool = False) -> None:
    """Lock a file. The system releases the lock when the file is closed, or when the process ends.

    Args:
        shared: Other processes may hold shared locks at the same time.
        wait: Wait for the other holders of the lock.
        by_process: The lock belongs to the process, rather than to the open file. Forked processes share open files.

    Raises:
        BlockingIOError: Another process holds the lock.
        OSError: The operating system or the file system has no locks.
    """
    if fcntl is None:
        raise OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))
    kind = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
    try:
        (fcntl.lockf if by_process else fcntl.flock)(descriptor, kind)
    except PermissionError as error:  # some systems raise this error if another process holds the lock
        raise BlockingIOError(*error.args) from error


def unlock(descriptor: int) -> None:
    """Release a lock that :func:`lock` has acquired."""
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


def user() -> int:
    """Return the id of the user that owns this process; 0 on Windows, where files have no such owner."""
    return os.getuid() if HAS_OWNERS else 0
