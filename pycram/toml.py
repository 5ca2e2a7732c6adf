"""Reads TOML, with the standard library where it can (Python 3.11) and its forerunner on 3.10."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from pycram.failures import AssetError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from pathlib import Path


def read(file: Path) -> dict[str, object]:
    """Reads a TOML file.

    Args:
        file: the file.

    Returns:
        Its tables.

    Raises:
        AssetError: it can't be read or parsed.
    """
    try:
        tables: dict[str, object] = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise AssetError(file, f"can't be read as TOML: {error}") from error
    return tables
