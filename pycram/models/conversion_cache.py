"""A cache of converted meshes and of convex hulls in a folder of the user, shared by all processes.

Without this cache, some robots take 1 to 3 s to load each time. The name of an entry is the hash of the code and of all
data that the conversion reads, so entries are never out of date; users may delete entries at any time. If the folder
isn't writable, or if other users can write to the folder, each process converts the meshes itself.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.models.files import read_bytes
from pycram.models.texture import warn_of_missing
from recorder.system import cache_folder

if TYPE_CHECKING:
    Piece = tuple[str, bytes, Sequence[float] | None]

_WORTH: Final = 50_000  # a binary STL with fewer bytes is converted faster than its entry is found
_LARGEST: Final = 1_000_000_000  # maximum total size in bytes; the least recently used entries are deleted first
_CODE: Final = ("canonical_urdf.py", "load.py", "mesh.py", "shapes.py", "texture.py")
_LIBRARIES: Final = ("numpy", "pillow", "pybullet", "pycollada", "scipy", "trimesh")
_IMAGE: Final = re.compile(rb"<image\b(?:(?!</image>).)*?<init_from>\s*([^<]+?)\s*</init_from>", re.DOTALL)
_MATERIALS: Final = re.compile(rb"^\s*mtllib\s+(.+?)\s*$", re.MULTILINE)
_MAP: Final = re.compile(rb"^\s*map_kd\s+(.+?)\s*$", re.MULTILINE | re.IGNORECASE)


def get(
    kind: str, file: Path, convert: Callable[[], Sequence[Piece]], beside: Iterable[Path] | None = None
) -> Sequence[Piece]:
    """Return the pieces of a converted mesh: file name, content and colour RGBA 0..1 of each piece.

    The conversion also reads the files ``beside`` if they exist. AssetError is raised for a broken mesh.
    """
    content = read_bytes(file)
    textures = {name: file.parent / name for name in map(os.fsdecode, _textures(file, content))}
    for name, texture in textures.items():
        if not texture.is_file():
            warn_of_missing(file, name)
    if beside is None and file.suffix.lower() == ".stl" and len(content) < _WORTH:
        return convert()
    besides = [*_materials(file, content), *(_content(other) for other in (*textures.values(), *(beside or ())))]
    return kept(kind, (os.fsencode(file.name), content, *besides), convert)


def kept(kind: str, sources: Iterable[bytes], convert: Callable[[], Sequence[Piece]]) -> Sequence[Piece]:
    """Return the pieces of a conversion from the cache; otherwise convert the mesh, reading only ``sources``."""
    where = cache_folder()
    if where is None:
        return convert()
    digest = sha256(_code())
    for part in (kind.encode(), *sources):
        digest.update(b"%d:" % len(part) + part)
    entry = where / f"{digest.hexdigest()}.mesh"
    with suppress(OSError, ValueError, LookupError, TypeError):  # the entry is missing or damaged
        head, _, contents = entry.read_bytes().partition(b"\n")
        table = json.loads(head)
        if sha256(contents).hexdigest() != table["sha256"]:
            raise ValueError(table["sha256"])
        known: list[Piece] = []
        start = 0
        for name, size, rgba in table["pieces"]:
            known.append((name, contents[start : start + size], rgba))
            start += size
        os.utime(entry)
        return known
    pieces = convert()
    with suppress(OSError):
        _write(entry, pieces)
    return pieces


@cache
def _code() -> bytes:
    """Return a hash of the converting code and of the versions of its libraries."""
    sources = [(Path(__file__).parent / name).read_bytes() for name in _CODE]
    return sha256(b"".join(sources) + " ".join(map(_version, _LIBRARIES)).encode()).digest()


def _version(library: str) -> str:
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415  slow to import

    try:
        return version(library)
    except PackageNotFoundError:  # only some conversions need the library
        return "none"


def _materials(file: Path, content: bytes) -> list[bytes]:
    libraries = _MATERIALS.findall(content) if file.suffix.lower() == ".obj" else []
    return [_content(file.parent / os.fsdecode(library)) for library in libraries]


def _textures(file: Path, content: bytes) -> list[bytes]:
    """Return the file names of the textures that a mesh names."""
    if file.suffix.lower() == ".dae":
        if b"<texture" not in content:  # the file names images, but no material uses them
            return []
        return [name.removeprefix(b"file://").replace(b"%20", b" ") for name in _IMAGE.findall(content)]
    return [name for materials in _materials(file, content) for name in _MAP.findall(materials)]


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except (OSError, ValueError):
        return b""


def _write(entry: Path, pieces: Sequence[Piece]) -> None:
    """Write an entry atomically, and delete the oldest entries if the cache is too large."""
    contents = b"".join(content for _, content, _ in pieces)
    table = [(name, len(content), None if rgba is None else list(rgba)) for name, content, rgba in pieces]
    head = json.dumps({"sha256": sha256(contents).hexdigest(), "pieces": table}).encode()
    entry.parent.mkdir(parents=True, exist_ok=True)
    partial = entry.with_name(f"{entry.name}.{os.getpid()}")
    partial.write_bytes(head + b"\n" + contents)
    partial.replace(entry)
    found = [(of.st_mtime_ns, of.st_size, other) for other in entry.parent.glob("*.mesh") if (of := other.stat())]
    total = sum(size for _, size, _ in found)
    for _, size, oldest in sorted(found):
        if total <= _LARGEST:
            break
        oldest.unlink(missing_ok=True)
        total -= size
