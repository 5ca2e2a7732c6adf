"""The error of recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


class RecordingError(OSError):
    """A recording can't be written (no such folder, read-only, disk full, ...).

    Attributes:
        path: the file.
        cause: the system's message.
    """

    def __init__(self, path: str | Path, cause: str, hint: str = "") -> None:
        super().__init__(f"can't record to {path}: {cause}{'; ' + hint if hint else ''}")
        self.path = str(path)
        self.cause = cause
