"""Record everything that happens to worlds and plans as typed records in one MCAP file.

Importing this package costs nothing: the file format and the viewer are loaded by :func:`record`.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from recorder.errors import RecordingError

if TYPE_CHECKING:
    from recorder.recording import Recording, record, start, stop

# numpy reads the variable when it is imported. Threads don't speed up products of our small matrices, but each thread
# spins for 20 ms after a product. This took a third of the processor time of a plan with reasoning.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__all__ = ["Recording", "RecordingError", "record", "start", "stop"]


def __getattr__(name: str) -> object:
    if name in __all__:
        from recorder import recording  # noqa: PLC0415  slow to load

        return getattr(recording, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
