"""The user's folder for caches. Files in this folder are trusted, so only the user may write into it."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final

from recorder.system import HAS_OWNERS, user

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
    if not HAS_OWNERS:  # Windows protects folders of users in other ways
        return stat.S_ISDIR(of.st_mode)
    return stat.S_ISDIR(of.st_mode) and of.st_uid in (user(), _ROOT) and not of.st_mode & stat.S_IWOTH
