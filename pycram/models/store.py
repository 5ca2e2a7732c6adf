"""The store of canonical models: a folder of this process whose files are named after the hash of their content."""

from __future__ import annotations

import atexit
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
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def write(name: str, content: bytes) -> Path:
    """Write a file into the store, whole or not at all, even if other threads write the same; return its path."""
    target = folder() / name
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f"{target.name}.{threading.get_ident()}")
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
