"""Models from a recording, which a stranger may have written: checked as models from disk are; nothing else is read.

A recorded URDF was canonical when it was written. It names meshes as ``<sha256>/<file name>``, each a file that its
record lists; whatever names anything else was written by no recorder. What a file contains can't be told from its
name, so all of it is checked before the engine sees it: PyBullet ends the process over a mesh that makes no sense.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import AssetError
from pycram.models import canonical_urdf, corrections, mesh, store
from pycram.models.files import parse_urdf
from pycram.models.load import Model
from recorder.records.values import AssetFile

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from pycram.physics.loading import Loading
    from recorder.urdf import Urdf

_CACHED_MODELS: Final = 128
_CACHED_MESHES: Final = 1024
_START: Final = b"<robot "  # of canonical text: no declarations, no entities, no other encoding
_MATERIALS: Final = re.compile(rb"^[ \t]*(?:mtllib|usemtl)\b", re.MULTILINE)
_MAX_NAME: Final = 230  # bytes of a file's name; file systems take 255, and one is written under a longer name first
_MAX_LINE: Final = 8000  # bytes of a line of a URDF: PyBullet breaks longer ones, where it reads something else then
_ESCAPE: Final = re.compile(r"\\udc[89a-f][0-9a-f]")  # of a byte that isn't UTF-8, as recorders write it
_RESERVED: Final = ("", ".", "..")


def restore(files: Iterable[tuple[str, bytes]], loading: Loading) -> Model:
    """Load a model from a recording's attachments as they are.

    Args:
        files: Attachment names (``<sha256>/<file name>``) and contents of the model's files, the URDF first.
        loading: How the engine made a body of it.

    Raises:
        AssetError: A file's name isn't the hash of its content, the URDF is broken or names another file, a mesh is
            broken, or corrections of its furniture don't fit.
    """
    model, *others = [_file(key, content) for key, content in files]
    beside = [file for file in others if file.name.endswith(corrections.SUFFIX)]
    meshes = [file for file in others if file not in beside]
    path, _ = store.write_urdf(model.name, model.content)
    tree = _tree(path, model.key, frozenset(asset.key for asset in meshes))
    for asset in meshes:
        _check_mesh(store.write(asset.key, asset.content))
    for file in beside:
        corrections.check(corrections.read(_text(file), file.name), tree)
    return Model(path, tree, (model, *others), loading)


def _text(file: AssetFile) -> str:
    try:
        return file.content.decode()
    except UnicodeDecodeError as error:
        raise AssetError(file.key, f"is not UTF-8: {error}") from error


def _file(key: str, content: bytes) -> AssetFile:
    name = key.partition("/")[2]
    asset = AssetFile(name, content, store.URDF_TYPE if name.endswith(".urdf") else store.MESH_TYPE)
    if name.endswith(corrections.SUFFIX):
        asset = corrections.asset(name, content)
    forbidden = name in _RESERVED or not name.isprintable() or len(os.fsencode(name)) > _MAX_NAME
    if asset.key != key or forbidden or "/" in name or "\\" in _ESCAPE.sub("", name):
        raise AssetError(key, "is not the file that its name says")
    return asset


@lru_cache(maxsize=_CACHED_MODELS)
def _tree(path: Path, key: str, meshes: frozenset[str]) -> Urdf:
    """Return the tree of a model in the store, whose name changes with its content."""
    content = path.read_bytes()
    if not content.startswith(_START):
        raise AssetError(key, "is no URDF as recordings have them: these begin with <robot")
    if max(map(len, content.splitlines())) > _MAX_LINE:
        raise AssetError(key, f"has a line of more than {_MAX_LINE} bytes, which canonical URDF doesn't have")
    canonical_urdf.read(path, content)
    for element in ET.fromstring(content).iter():  # noqa: S314  without entities; also what isn't URDF: engines read more
        named = element.get("filename")
        if element.tag == "texture" or (named is not None and named not in meshes):
            raise AssetError(key, f"names the file {named!r}, which isn't one of the recording's for this body")
    tree = parse_urdf(content, key)
    canonical_urdf.check_size(path, tree)
    return tree


@lru_cache(maxsize=_CACHED_MESHES)
def _check_mesh(path: Path) -> None:
    """Refuse a mesh in the store that isn't as recordings have them: a binary STL, or an OBJ that is alone."""
    if path.suffix.lower() == ".obj" and _MATERIALS.search(path.read_bytes()):
        raise AssetError(path.name, "names materials in another file")
    mesh.check(path)
