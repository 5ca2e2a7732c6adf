"""Where a URDF's meshes are: relative to it, absolute, ``file://``, or in a ROS package, ``package://NAME/PATH``.

A package is a folder of its name, or one with a ``package.xml`` that says so. It is looked for, in this order:

1. in the folders that a caller gives, and below them;
2. in those of the environment variable ``PYCRAM_PACKAGES``, and below them;
3. in all folders above the URDF;
4. in those of ``ROS_PACKAGE_PATH``, and below them, as ROS does;
5. last, its path alone in the folders above the URDF that aren't other packages: a package may lie in a folder of
   another name.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import AssetError, BadArgument
from pycram.models import store

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_PACKAGE: Final = "package://"
_VARIABLE: Final = "PYCRAM_PACKAGES"
_ROS_VARIABLE: Final = "ROS_PACKAGE_PATH"
_NAME: Final = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
_MANIFEST: Final = "package.xml"


def check_folders(packages: Sequence[str | Path]) -> tuple[Path, ...]:
    """Return a caller's folders of packages.

    Raises:
        BadArgument: It isn't a list of existing folders.
    """
    expected = "a list of folders that exist"
    if isinstance(packages, str | bytes) or not all(isinstance(folder, str | Path) for folder in packages):
        raise BadArgument("packages", packages, expected)
    folders = tuple(Path(folder).expanduser().resolve() for folder in packages)
    if not all(folder.is_dir() for folder in folders):
        raise BadArgument("packages", packages, expected)
    return folders


def find_mesh(source: Path, name: str, packages: Sequence[Path] = ()) -> Path:
    """Return the file of a mesh or texture as a URDF names it.

    Args:
        source: The URDF.
        name: As it is written there.
        packages: Folders to look for packages in before all others.

    Raises:
        AssetError: There is none; it says where it was looked for.
    """
    if not name:
        raise AssetError(source, "has a <mesh> without filename")
    if name.startswith(_PACKAGE):
        return _in_package(source, name, packages)
    relative = name.removeprefix("file://")
    for folder in (source.parent, store.folder()):
        if (folder / relative).is_file():
            return folder / relative
    raise AssetError(source, f"its mesh {name} doesn't exist")


def _in_package(source: Path, name: str, packages: Sequence[Path]) -> Path:
    package, _, path = name.removeprefix(_PACKAGE).partition("/")
    found = None
    for folder in _candidates(source, package, packages):
        if (folder / path).is_file():
            return folder / path
        if found is None and (folder.name == package or _is(folder, package)) and folder.is_dir():
            found = folder
    if found is not None:
        raise AssetError(source, f"its mesh {name} doesn't exist: the package is {found}, which has no {path}")
    ways = f"Object(..., packages=[FOLDER]), or the environment's {_VARIABLE} or {_ROS_VARIABLE}"
    raise AssetError(
        source, f"its mesh {name} doesn't exist: no package {package!r} is known; name its folder by {ways}"
    )


def _candidates(source: Path, package: str, packages: Sequence[Path]) -> Iterator[Path]:
    """Yield folders that may be a package, likely ones first: only who asks on has folders searched."""
    for root in (*packages, *_variable(_VARIABLE)):
        yield from _below(root, package)
    for folder in source.parents:
        yield folder / package
        if folder.name == package or _is(folder, package):
            yield folder
    for root in _variable(_ROS_VARIABLE):
        yield from _below(root, package)
    yield from (folder for folder in source.parents if not (folder / _MANIFEST).is_file())


def _variable(name: str) -> list[Path]:
    return [Path(folder).expanduser() for folder in os.environ.get(name, "").split(os.pathsep) if folder]


def _below(root: Path, package: str) -> Iterator[Path]:
    if root.name == package:
        yield root
    yield root / package
    for folder, inside, files in os.walk(root):
        if _MANIFEST in files:
            if _is(Path(folder), package):
                yield Path(folder)
            inside.clear()  # packages don't contain others
        else:
            inside[:] = sorted(name for name in inside if not name.startswith("."))
            if package in inside:
                yield Path(folder, package)


def _is(folder: Path, package: str) -> bool:
    """Whether a folder's manifest has the package's name."""
    try:
        found = _NAME.search((folder / _MANIFEST).read_bytes())
    except OSError:
        return False
    return found is not None and found[1].decode("utf-8", "replace") == package
