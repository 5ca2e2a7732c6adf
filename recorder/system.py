"""Parts of operating systems that Windows lacks: locks on files, owners of files, and flags of ``os.open``."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

HAS_LOCKS: Final = fcntl is not None
HAS_OWNERS: Final = hasattr(os, "getuid")
#: Flags for opening files: children don't inherit the files, and Windows doesn't convert bytes. Missing flags are 0.
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


_ROOT: Final = 0  # the superuser may write anywhere


def cache_folder() -> Path | None:
    """Return the user's folder for caches: ``PYCRAM_CACHE`` or ``~/.cache/pycram``. The folder may be missing.

    Return None if the variable is empty, or if other users may write into the folder.
    """
    named = os.environ.get("PYCRAM_CACHE")
    folder: Path | None = None
    with suppress(RuntimeError):  # the user may have no home folder
        if named is not None:
            folder = Path(named).expanduser() if named else None
        else:
            users = os.environ.get("XDG_CACHE_HOME")
            folder = (Path(users) if users else Path.home() / ".cache") / "pycram"
    return folder if folder is None or is_own(folder) else None


def is_own(folder: Path) -> bool:
    """Return whether only this user and the superuser can write into a folder; True for a missing folder."""
    try:
        of = folder.lstat()
        if stat.S_ISLNK(of.st_mode) and of.st_uid in (user(), _ROOT):
            of = folder.stat()
    except FileNotFoundError:
        return True
    except OSError:
        return False
    is_safe = of.st_uid in (user(), _ROOT) and not of.st_mode & stat.S_IWOTH
    return stat.S_ISDIR(of.st_mode) and (is_safe or not HAS_OWNERS)  # Windows protects folders of users in other ways
