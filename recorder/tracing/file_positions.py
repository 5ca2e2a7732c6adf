"""Positions in files: a forked child has them in common with its parent, unless it opens the files again."""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path
from typing import Final

_OPEN: Final = Path("/proc/self/fd")  # only Linux has it
_OF_PATHS: Final = getattr(os, "O_NOFOLLOW", 0)  # the links there are to be followed


def have_own() -> None:
    """Give this process, a forked child, positions of its own in the files that are open for reading alone.

    So what it reads isn't missing when its parent reads on. Files that are written stay common, as logs are.
    """
    if not _OPEN.is_dir():
        return
    for entry in list(_OPEN.iterdir()):  # before others are opened
        with contextlib.suppress(OSError):  # one that was closed meanwhile, or may not be opened any more
            _reopen(int(entry.name))


def _reopen(descriptor: int) -> None:
    import fcntl  # noqa: PLC0415  only systems that can fork have it

    flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
    if flags & os.O_ACCMODE != os.O_RDONLY or not stat.S_ISREG(os.fstat(descriptor).st_mode):
        return
    position = os.lseek(descriptor, 0, os.SEEK_CUR)
    again = os.open(_OPEN / str(descriptor), flags & ~_OF_PATHS)
    try:
        os.lseek(again, position, os.SEEK_SET)
        os.dup2(again, descriptor, inheritable=os.get_inheritable(descriptor))
    finally:
        os.close(again)
