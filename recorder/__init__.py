"""Records everything that happens to worlds and plans as typed records in one MCAP file.

Importing this package costs nothing: the file format and the viewer are loaded by :func:`record`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from recorder.errors import RecordingError

if TYPE_CHECKING:
    from recorder.recording import Recording, record

__all__ = ["Recording", "RecordingError", "record"]


def __getattr__(name: str) -> object:
    if name in ("record", "Recording"):
        from recorder import recording  # noqa: PLC0415  heavy: only when somebody records

        return getattr(recording, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
