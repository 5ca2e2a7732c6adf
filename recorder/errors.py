"""The error of recording, and what it shares with those of reading."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


class PortableError(Exception):
    """An error that pickles and copies with its fields: its message alone isn't what its class makes one of."""

    def __reduce__(self) -> tuple[object, ...]:
        """Return what makes it again, as another process does."""
        return _restored, (type(self), self.args, dict(vars(self)))


def _restored(kind: type[PortableError], args: tuple[object, ...], fields: Mapping[str, object]) -> PortableError:
    error = kind.__new__(kind, *args)
    error.args = args
    vars(error).update(fields)
    return error


class RecordingError(PortableError, OSError):
    """A recording can't be written (no such folder, read-only, disk full, ...).

    Attributes:
        path: the file.
        cause: the system's message.
    """

    def __init__(self, path: str | Path, cause: str, hint: str = "") -> None:
        super().__init__(f"can't record to {path}: {cause}{'; ' + hint if hint else ''}")
        self.path = str(path)
        self.cause = cause
