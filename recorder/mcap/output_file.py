"""Opens the file of a recording, if it may be written."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import re
import stat
import sys
from typing import TYPE_CHECKING, Final

from recorder.errors import RecordingError
from recorder.mcap.writer import MAGIC

if TYPE_CHECKING:
    from pathlib import Path

HINT: Final = "free space or choose another path, and run again"
_WITHOUT_LOCKS: Final = (errno.ENOTSUP, errno.EINVAL, errno.ENOLCK)  # errors of file systems that have none


def free_path(path: Path) -> Path:
    """Returns a path that no recording has: this one, else RUN.2.mcap or a later number, which is printed on stderr.

    Whatever else there is at the path, a device or an empty file, can be written to, or is refused when it is opened.
    """
    try:
        if not path.is_file():  # a pipe would wait
            return path
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return path
    except OSError:  # opening it says what is wrong
        return path
    pattern = re.compile(rf"{re.escape(path.stem)}\.(\d+){re.escape(path.suffix)}")
    numbers = [int(match[1]) for each in path.parent.iterdir() if (match := pattern.fullmatch(each.name))]
    free = path.with_name(f"{path.stem}.{max(numbers, default=1) + 1}{path.suffix}")
    print(f"recorder: {path} is there already; recording to {free}", file=sys.stderr, flush=True)
    return free


def open_output(path: Path) -> io.FileIO:
    """Opens and locks a new file, or an older recording, which is emptied.

    Raises:
        RecordingError: it can't be written, another recording is writing it, or it is something else.
    """
    try:
        file = io.FileIO(os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666), "r+")
    except OSError as error:
        hint = "make the folder first" if not path.parent.exists() else "choose a path that you may write to"
        raise RecordingError(path, reason(error), hint) from error
    try:
        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RecordingError(path, "another recording is writing it", "choose another path") from error
        except OSError as error:
            if error.errno not in _WITHOUT_LOCKS:
                raise RecordingError(path, reason(error), HINT) from error
        _empty(path, file)
    except BaseException:
        file.close()
        raise
    return file


def _empty(path: Path, file: io.FileIO) -> None:
    """Empties an older recording; refuses any other file that has content."""
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        start = file.read(len(MAGIC)) or b""
        if start and start != MAGIC:
            raise RecordingError(path, "there is a file that is no recording", "move it away or choose another path")
        file.seek(0)
        file.truncate()


def reason(error: OSError) -> str:
    """The system's message."""
    return error.strerror or str(error)
