"""Records everything that happens to worlds and plans as typed records in one MCAP file.

Importing this package costs nothing: the file format and the viewer are loaded by :func:`record`.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from recorder.errors import RecordingError

if TYPE_CHECKING:
    from recorder.recording import Recording, record

# Before numpy is loaded, and unless it is set. Matrices here are small: threads save nothing on them, but spin for some
# 20 ms after each product that they share, which took a third of the processor time of a plan that thinks.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__all__ = ["Recording", "RecordingError", "record"]


def __getattr__(name: str) -> object:
    if name in ("record", "Recording"):
        from recorder import recording  # noqa: PLC0415  heavy: only when somebody records

        return getattr(recording, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
