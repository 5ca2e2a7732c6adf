"""Folders of the user's own for what can be made again: nobody else may put anything there that would be believed."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

_ROOT: Final = 0  # who may do anything anyway


def cache_folder() -> Path | None:
    """The user's folder for caches: the environment's ``PYCRAM_CACHE``, else ``~/.cache/pycram``; it may not be there.

    None if that variable is set to nothing, and if the folder isn't the user's own.
    """
    named = os.environ.get("PYCRAM_CACHE")
    folder: Path | None = None
    with suppress(RuntimeError):  # a user without a home
        if named is not None:
            folder = Path(named).expanduser() if named else None
        else:
            users = os.environ.get("XDG_CACHE_HOME")
            folder = (Path(users) if users else Path.home() / ".cache") / "pycram"
    return folder if folder is None or is_own(folder) else None


def is_own(folder: Path) -> bool:
    """Whether nobody but this user, and the system's, can write into a folder; also if there is none."""
    try:
        of = folder.lstat()
        if stat.S_ISLNK(of.st_mode) and of.st_uid in (os.getuid(), _ROOT):
            of = folder.stat()
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return stat.S_ISDIR(of.st_mode) and of.st_uid in (os.getuid(), _ROOT) and not of.st_mode & stat.S_IWOTH
