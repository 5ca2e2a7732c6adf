"""The store of canonical models: a temporary folder of the process; files are named after the hash of their content.

The store is removed when the process ends. The store of a killed process is removed by the user's next process that
creates a store: each process holds a lock in its folder, which the kernel releases when the process ends.
"""

from __future__ import annotations

import atexit
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

from recorder import system
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
    made, owner = _make(), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # a fork uses its parent's store and leaves it
            with Uninterrupted():  # no traceback if Ctrl-C is pressed again
                shutil.rmtree(made, ignore_errors=True)
                drop_pending()

    atexit.register(remove)
    return made


def _make() -> Path:
    """Create and lock a folder; retry if another process removed it before it was locked."""
    while True:
        made = Path(tempfile.mkdtemp(prefix=_PREFIX))
        with suppress(FileNotFoundError):
            lock = os.open(made / _LOCK, os.O_RDWR | os.O_CREAT | system.OPENED, 0o600)
            if _holds(lock) and (made / _LOCK).exists():
                return made  # the lock is held until the process ends
            os.close(lock)


def _holds(lock: int) -> bool:
    """Return whether this process got a lock; on a file system without locks, no store counts as abandoned."""
    try:
        system.lock(lock)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _remove_abandoned(where: Path) -> None:
    """Remove the stores of this user's killed processes."""
    for found in where.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # another user owns it, or another process was faster
            of = found.lstat()
            if not stat.S_ISDIR(of.st_mode) or of.st_uid != system.user():
                continue
            lock = os.open(found / _LOCK, os.O_RDWR | system.OPENED | system.NO_LINK)
            try:
                system.lock(lock)
                shutil.rmtree(found, ignore_errors=True)
            finally:
                os.close(lock)


def write(name: str, content: bytes) -> Path:
    """Store a file atomically, even if other threads or forks store it as well; return its path."""
    target = folder() / name
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f"{target.name}.{os.getpid()}.{threading.get_ident()}")
        partial.write_bytes(content)
        partial.replace(target)
    return target


def document(path: Path) -> ET.Element:
    """Return the root element of a stored URDF, which must not be modified."""
    known = _known(path)
    if not known:
        known.append(ET.fromstring(path.read_bytes()))  # noqa: S314  written by PyCRAM
    return known[0]


@lru_cache(maxsize=_CACHED_DOCUMENTS)
def _known(_path: Path) -> list[ET.Element]:
    """Return the cache of a URDF's root element: a list, empty until the element is known."""
    return []


@lru_cache(maxsize=_CACHED_TREES)
def stored_tree(path: Path) -> Urdf:
    """Return the tree of links and joints of a stored URDF."""
    return Urdf.parse(path.read_bytes())


def write_mesh(name: str, content: bytes) -> AssetFile:
    """Store a mesh; stored URDFs refer to it by its key."""
    asset = AssetFile(name, content, MESH_TYPE)
    write(asset.key, content)
    return asset


def write_urdf(name: str, content: bytes, root: ET.Element | None = None) -> tuple[Path, AssetFile]:
    """Store a URDF next to the folders of its meshes, where PyBullet looks for them.

    Args:
        name: The file's name in recordings.
        content: The text.
        root: The root element if known; it must not be modified afterwards.
    """
    asset = AssetFile(name, content, URDF_TYPE)
    path = write(f"{asset.sha256}.urdf", content)
    if root is not None:
        _known(path)[:] = [root]
    return path, asset
