"""The store of canonical models: a temporary folder of the process. The name of a file is the hash of its content.

The process removes its store when it ends. If a process was killed, the user's next process that creates a store
removes the abandoned store. A lock in the store shows whether its process is alive.
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
_LOCK: Final = "lock"  # name of a file in each store


@cache
def folder() -> Path:
    """Return the folder of the store, which is removed at the end of the process."""
    for found in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):  # abandoned stores are removed
        with suppress(OSError):  # another user owns the store, or another process was faster
            of = found.lstat()
            if not stat.S_ISDIR(of.st_mode) or of.st_uid != system.user():
                continue
            lock = os.open(found / _LOCK, os.O_RDWR | system.OPENED | system.NO_LINK)
            try:
                system.lock(lock)
                shutil.rmtree(found, ignore_errors=True)
            finally:
                os.close(lock)
    made, owner = _make(), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # a fork uses the store of its parent, and doesn't remove it
            with Uninterrupted():  # a second Ctrl-C must not print a traceback
                shutil.rmtree(made, ignore_errors=True)
                drop_pending()

    atexit.register(remove)
    return made


def _make() -> Path:
    """Create and lock a folder; retry if another process removes the folder before the lock."""
    while True:
        made = Path(tempfile.mkdtemp(prefix=_PREFIX))
        with suppress(FileNotFoundError):
            lock = os.open(made / _LOCK, os.O_RDWR | os.O_CREAT | system.OPENED, 0o600)
            if _holds(lock) and (made / _LOCK).exists():
                return made  # the process holds the lock until it ends
            os.close(lock)


def _holds(lock: int) -> bool:
    """Return whether this process got a lock; True on a file system without locks."""
    try:
        system.lock(lock)
    except OSError as error:
        return not isinstance(error, BlockingIOError)
    return True


def write(name: str, content: bytes) -> Path:
    """Store a file and return its path; atomic, even if other threads or forks store the same file."""
    target = folder() / name
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f"{target.name}.{os.getpid()}.{threading.get_ident()}")
        partial.write_bytes(content)
        partial.replace(target)
    return target


@lru_cache(maxsize=_CACHED_DOCUMENTS)
def document(path: Path) -> ET.Element:
    """Return the root element of a stored URDF. The caller must not modify the element."""
    return ET.fromstring(path.read_bytes())  # noqa: S314  written by PyCRAM


@lru_cache(maxsize=_CACHED_TREES)
def stored_tree(path: Path) -> Urdf:
    """Return the tree of links and joints of a stored URDF."""
    return Urdf.parse(path.read_bytes())


def write_mesh(name: str, content: bytes) -> AssetFile:
    """Store a mesh; stored URDFs contain the key of the mesh."""
    asset = AssetFile(name, content, MESH_TYPE)
    write(asset.key, content)
    return asset


def write_urdf(name: str, content: bytes) -> tuple[Path, AssetFile]:
    """Store a URDF next to the folders of its meshes, as PyBullet expects; recordings use the ``name``."""
    asset = AssetFile(name, content, URDF_TYPE)
    return write(f"{asset.sha256}.urdf", content), asset
