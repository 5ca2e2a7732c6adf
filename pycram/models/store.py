"""The store of canonical models: a folder of this process whose files are named after the hash of their content.

It is removed when the process ends. That of a process that was killed is removed by the next one of its user that makes
a store: each process holds a lock in its folder, which ends with it, whatever process gets its number later.
"""

from __future__ import annotations

import atexit
import fcntl
import os
import shutil
import stat
import tempfile
import threading
import xml.etree.ElementTree as ET
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Final

from recorder.records.values import AssetFile
from recorder.tracing.interrupts import Uninterrupted, drop_pending
from recorder.urdf import Urdf

MESH_TYPE: Final = "model/mesh"
URDF_TYPE: Final = "application/xml"
_CACHED_DOCUMENTS: Final = 64
_CACHED_TREES: Final = 128
_PREFIX: Final = "pycram-models-"
_LOCK: Final = "lock"  # a file in each store


@cache
def folder() -> Path:
    """Return the store's folder, which is removed at the end of the process."""
    _remove_abandoned(Path(tempfile.gettempdir()))
    made = _make()
    atexit.register(_remove, made, os.getpid())
    return made


def _make() -> Path:
    """Make a folder, and lock it; again if another process has taken it for an abandoned one in between."""
    while True:
        made = Path(tempfile.mkdtemp(prefix=_PREFIX))
        with suppress(FileNotFoundError):
            lock = os.open(made / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            if _holds(lock) and (made / _LOCK).exists():
                return made  # the lock is held until the process ends
            os.close(lock)


def _holds(lock: int) -> bool:
    """Whether this process gets a lock; a file system without locks gives none, and nothing is abandoned there."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _remove_abandoned(where: Path) -> None:
    """Remove the stores of this user's processes that have ended without removing them."""
    for found in where.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # it is somebody else's, or another process is faster
            of = found.lstat()
            if not stat.S_ISDIR(of.st_mode) or of.st_uid != os.getuid():
                continue
            lock = os.open(found / _LOCK, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(found, ignore_errors=True)
            finally:
                os.close(lock)


def _remove(made: Path, owner: int) -> None:
    """Remove the store at the end of the process; a fork has its parent's, and leaves it."""
    if os.getpid() == owner:
        with Uninterrupted():  # who presses Ctrl-C again is no reason for a traceback now
            shutil.rmtree(made, ignore_errors=True)
            drop_pending()


def write(name: str, content: bytes) -> Path:
    """Write a file into the store, whole or not at all, even if other threads write the same; return its path."""
    target = folder() / name
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f"{target.name}.{os.getpid()}.{threading.get_ident()}")  # also forks write here
        partial.write_bytes(content)
        partial.replace(target)
    return target


def document(path: Path) -> ET.Element:
    """Return the root element of a canonical URDF in the store; nobody may change it."""
    known = _known(path)
    if not known:
        known.append(ET.fromstring(path.read_bytes()))  # noqa: S314  written by PyCRAM
    return known[0]


@lru_cache(maxsize=_CACHED_DOCUMENTS)
def _known(_path: Path) -> list[ET.Element]:
    """Return where the root element of a URDF is kept; nowhere yet if it is empty."""
    return []


@lru_cache(maxsize=_CACHED_TREES)
def stored_tree(path: Path) -> Urdf:
    """Return the tree of links and joints of a canonical URDF in the store."""
    return Urdf.parse(path.read_bytes())


def write_mesh(name: str, content: bytes) -> AssetFile:
    """Write a mesh into the store; its key is the name by which a URDF in the store refers to it."""
    asset = AssetFile(name, content, MESH_TYPE)
    write(asset.key, content)
    return asset


def write_urdf(name: str, content: bytes, root: ET.Element | None = None) -> tuple[Path, AssetFile]:
    """Write a URDF into the store; it lies flat, beside the folders of its meshes, where PyBullet looks for them.

    Args:
        name: The file's name in recordings.
        content: Its text.
        root: Its root element if that is known, which nobody changes from now on.
    """
    asset = AssetFile(name, content, URDF_TYPE)
    path = write(f"{asset.sha256}.urdf", content)
    if root is not None:
        _known(path)[:] = [root]
    return path, asset
