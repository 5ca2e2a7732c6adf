"""Positions in files: a forked child has them in common with its parent, unless it opens the files again."""

from __future__ import annotations

import os
import stat
from typing import Final

_OPEN: Final = "/proc/self/fd"  # only Linux has it
_OF_PATHS: Final = getattr(os, "O_NOFOLLOW", 0)  # the links there are to be followed


def have_own() -> None:
    """Give this process, a forked child, positions of its own in the files that are open for reading alone.

    So what it reads isn't missing when its parent reads on. Files that are written stay common, as logs are.
    """
    try:
        descriptors = os.listdir(_OPEN)  # noqa: PTH208  as little as can be: each page that this writes to is a copy's own
    except OSError:
        return
    for descriptor in descriptors:
        try:
            _reopen(int(descriptor))
        except OSError:  # it was closed meanwhile, or may not be opened any more
            continue


def _reopen(descriptor: int) -> None:
    import fcntl  # noqa: PLC0415  only systems that can fork have it

    flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
    if flags & os.O_ACCMODE != os.O_RDONLY or not stat.S_ISREG(os.fstat(descriptor).st_mode):
        return
    position = os.lseek(descriptor, 0, os.SEEK_CUR)
    again = os.open(f"{_OPEN}/{descriptor}", flags & ~_OF_PATHS)
    try:
        os.lseek(again, position, os.SEEK_SET)
        os.dup2(again, descriptor, inheritable=os.get_inheritable(descriptor))
    finally:
        os.close(again)
