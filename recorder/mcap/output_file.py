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
CHANGED_HINT: Final = "leave it alone while a plan is recorded, and run again"
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
    """Opens and locks a new file, or an older recording, which is emptied; or a pipe that somebody reads.

    Raises:
        RecordingError: it can't be written, another recording is writing it, or it is something else.
    """
    try:
        file = _open(path)
    except OSError as error:
        if error.errno == errno.ENXIO:
            raise RecordingError(path, "it is a pipe that nobody reads", "start its reader first") from error
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


def _open(path: Path) -> io.FileIO:
    try:
        is_pipe = stat.S_ISFIFO(path.stat().st_mode)
    except OSError:
        is_pipe = False
    if not is_pipe:
        return io.FileIO(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666), "r+")
    pipe = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # else it would wait for a reader
    os.set_blocking(pipe, True)
    return io.FileIO(pipe, "w")


class Changed(OSError):
    """Others have deleted, replaced or changed a file while it was written."""


class Watched:
    """A file that nobody but this process may change: a change by others is an error.

    Pipes and devices have no content that could change.

    Args:
        path: where it was opened.
        file: the open file.
    """

    def __init__(self, path: Path, file: io.FileIO) -> None:
        self._path = path.absolute()  # a plan may change the working directory
        self._number = file.fileno()
        self.is_regular = stat.S_ISREG(os.fstat(self._number).st_mode)

    def check(self, size: int) -> None:
        """Checks that it is where it was, and as it was.

        Args:
            size: what was written so far, in bytes.

        Raises:
            Changed: it isn't.
        """
        if not self.is_regular:
            return
        ours = os.fstat(self._number)
        try:
            there = self._path.stat()
        except OSError as error:
            done = "moved the file away" if ours.st_nlink else "deleted the file"
            raise Changed(f"somebody has {done} ({reason(error)})") from error
        if (there.st_dev, there.st_ino) != (ours.st_dev, ours.st_ino):
            raise Changed("somebody has replaced the file")
        if ours.st_size != size:
            done = "truncated the file" if ours.st_size < size else "written to the file"
            raise Changed(f"somebody has {done}: it has {ours.st_size} bytes instead of {size}")

    def sync(self) -> None:
        """Waits until all that was written is on the disk."""
        if self.is_regular:
            getattr(os, "fdatasync", os.fsync)(self._number)

    def sync_name(self) -> None:
        """Waits until its folder is on the disk, so that a new file is found in it."""
        if self.is_regular:
            folder = os.open(self._path.parent, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


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
