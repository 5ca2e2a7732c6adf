"""Reads TOML, with errors that name the file."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

from pycram.foundation.failures import AssetError

if TYPE_CHECKING:
    from pathlib import Path


def parse(text: str, source: str | Path) -> dict[str, object]:
    """Reads TOML.

    Args:
        text: the TOML.
        source: where it came from, for errors.

    Returns:
        Its tables.

    Raises:
        AssetError: it isn't TOML.
    """
    try:
        tables: dict[str, object] = tomllib.loads(text)
    except ValueError as error:
        raise AssetError(source, f"is not TOML: {error}") from error
    return tables


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
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AssetError(file, f"can't be read: {error}") from error
    return parse(text, file)
