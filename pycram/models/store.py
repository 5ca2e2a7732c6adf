"""The store of canonical models: a folder of this process whose files are named after the hash of their content."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import threading
import xml.etree.ElementTree as ET
from functools import cache, lru_cache
from pathlib import Path
from typing import Final

from recorder.records.asset import AssetFile

MESH_TYPE: Final = "model/mesh"
URDF_TYPE: Final = "application/xml"
_CACHED_DOCUMENTS: Final = 64


@cache
def folder() -> Path:
    """Return the store's folder, which is removed at the end of the process."""
    made = Path(tempfile.mkdtemp(prefix="pycram-models-"))
    atexit.register(_remove, made, os.getpid())
    return made


def _remove(made: Path, process: int) -> None:
    if os.getpid() == process:  # a forked child that ends leaves its parent's models alone
        shutil.rmtree(made, ignore_errors=True)


def write(name: str, content: bytes) -> Path:
    """Write a file into the store, whole or not at all, even if other threads write the same; return its path."""
    target = folder() / name
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f"{target.name}.{threading.get_ident()}")
        partial.write_bytes(content)
        partial.replace(target)
    return target


@lru_cache(maxsize=_CACHED_DOCUMENTS)
def document(path: Path) -> ET.Element:
    """Return the root element of a canonical URDF in the store; nobody may change it."""
    return ET.fromstring(path.read_bytes())  # noqa: S314  written by PyCRAM


def write_mesh(name: str, content: bytes) -> AssetFile:
    """Write a mesh into the store; its key is the name by which a URDF in the store refers to it."""
    asset = AssetFile(name, content, MESH_TYPE)
    write(asset.key, content)
    return asset


def write_urdf(name: str, content: bytes) -> tuple[Path, AssetFile]:
    """Write a URDF into the store; it lies flat, beside the folders of its meshes, where PyBullet looks for them."""
    asset = AssetFile(name, content, URDF_TYPE)
    return write(f"{asset.sha256}.urdf", content), asset
