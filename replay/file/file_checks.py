"""The file of a recording: whether it is one, and whether a recorder is writing it."""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING, BinaryIO, Final

from recorder.mcap.shared_models import LIBRARY as SHARED
from replay.errors import NotALog, Unreadable
from replay.file.chunks import kinds_of
from replay.file.mcap_format import MAGIC

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from pathlib import Path

    from replay.file.index import Index

_MIN_MAGIC: Final = len(MAGIC) - 2  # bytes that must be right: a damaged file may have wrong ones


def open_file(path: Path) -> BinaryIO:
    """Open a file if it is MCAP's by its first bytes, or was before it was damaged.

    Raises:
        NotALog: it isn't there, or is something else.
        Unreadable: it is empty, or cut off within these bytes.
    """
    try:
        file = open(path, "rb", opener=_nonblocking)  # noqa: SIM115  the log closes it
        try:
            _check_start(path, file)
        except BaseException:
            file.close()
            raise
    except OSError as error:
        raise NotALog(path, error.strerror or str(error)) from error
    return file


def _nonblocking(path: str, flags: int) -> int:
    """Open a file without blocking: a pipe would wait for a writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check_start(path: Path, file: BinaryIO) -> None:
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        raise NotALog(path, "is no regular file; recordings are read at random positions: write it to a file first")
    start = file.read(len(MAGIC))
    if len(start) < len(MAGIC) and MAGIC.startswith(start):
        raise Unreadable(path, "is cut off within its first bytes" if start else "is empty")
    matching = sum(a == b for a, b in zip(start, MAGIC, strict=False))
    file.seek(-min(len(start), len(MAGIC)), os.SEEK_END)
    if matching < _MIN_MAGIC and file.read() != MAGIC:
        raise NotALog(path, "is no MCAP file")


def check_ours(path: Path, index: Index) -> None:
    """Raise the error for a file that has no channel of a recording.

    Raises:
        NotALog: it is another program's.
        Unreadable: it is of another release, or too damaged to be recognised.
    """
    if kinds_of(index):
        return
    names = sorted(name for name in index.schemas.values() if name.startswith("pycram."))
    if names:
        raise Unreadable(path, f"was recorded by a release that this one can't read ({names[0]}); use that release")
    if index.library == SHARED:
        raise NotALog(path, "has the models that recordings of a sweep share; it is no recording itself")
    if not index.library.startswith("pycram") and (index.channels or (index.closed and index.whole)):
        raise NotALog(path, "is an MCAP file, but no recording of PyCRAM")
    raise Unreadable(path, "has no record that can be read")


def is_locked(file: BinaryIO) -> bool:
    """Return whether a recorder holds its lock on the file."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    fcntl.flock(file.fileno(), fcntl.LOCK_UN)
    return False
