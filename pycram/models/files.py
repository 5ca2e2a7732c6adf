"""Text, TOML and URDF files of models; an invalid one raises an AssetError that names it."""

from __future__ import annotations

import tomllib
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import AssetError
from recorder.urdf import Urdf, UrdfError

if TYPE_CHECKING:
    from pathlib import Path

_CACHED_MODELS: Final = 128


def read_bytes(file: Path) -> bytes:
    """Return the content of a file.

    Raises:
        AssetError: It can't be read.
    """
    try:
        return file.read_bytes()
    except OSError as error:
        raise AssetError(file, f"can't be read: {error}") from error


def read_text(file: Path) -> str:
    """Return the content of a UTF-8 file.

    Raises:
        AssetError: It can't be read.
    """
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AssetError(file, f"can't be read: {error}") from error


def parse_toml(text: str, source: str | Path) -> dict[str, object]:
    """Return the tables of a TOML document; errors name its source.

    Raises:
        AssetError: It isn't TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise AssetError(source, f"is not TOML: {error}") from error


@lru_cache(maxsize=_CACHED_MODELS)
def stored_tree(path: Path) -> Urdf:
    """Return the tree of links and joints of a canonical URDF in the store, where files stay as they are."""
    return Urdf.parse(path.read_bytes())


def parse_urdf(text: str | bytes, source: str | Path, *, chains: bool = False) -> Urdf:
    """Return the tree of links and joints of a URDF; errors name its source.

    Args:
        text: The document.
        source: Its file.
        chains: Whether its planar and floating joints are yet to be made chains of others.

    Raises:
        AssetError: It isn't a URDF, or not one tree, or a joint mimics itself.
    """
    try:
        tree = Urdf.parse(text, chains=chains)
        tree.mimics  # noqa: B018  computed once, when first asked for
    except UrdfError as error:
        raise AssetError(source, str(error)) from error
    return tree
