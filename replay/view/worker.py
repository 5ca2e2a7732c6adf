"""The process that translates what is told of a long recording, while this one translates what is seen of it.

It writes a file of its own, of which the rows go, as they are, to where the others went. It ends with the block that it
was started for, however that ends, and with its process if that is killed; its file goes with it.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.errors import Damaged, ReplayError
from replay.file.log import Log

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self

    import rerun as rr


_ROOT: Final = str(Path(__file__).parent.parent.parent)
_CODE: Final = """
import sys
sys.path = sys.argv[6:]  # the other process' own, for the same software: another one may be installed
from replay.view.worker import main
main(*sys.argv[1:6])
"""
_ON_THE_WAY: Final = 50  # chunks of rows that memory holds at once


class Worker:
    """The process; to be used in a ``with``.

    Args:
        log: the recording, as far as it is known to go.
        root: the entity that all others are below; "" for none.
        folder: where its file is; by default that for temporary files.

    Raises:
        OSError: there can't be such a file, or such a process.
    """

    def __init__(self, log: Log, root: str, folder: Path | None) -> None:
        self._log = log
        self._folder = tempfile.TemporaryDirectory(prefix=".told.", dir=folder, ignore_cleanup_errors=True)
        self._file = Path(self._folder.name) / "told.rrd"
        told = [str(log.path.absolute()), log.identity, str(len(log)), root, str(self._file.absolute())]
        try:
            self._process = subprocess.Popen(  # noqa: S603  our own code
                [sys.executable, "-c", _CODE, *told, *_path()],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for this one
            )
        except BaseException:
            self._folder.cleanup()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._folder, self._process:  # waits for it, and closes the pipes
            self._process.kill()

    def hand_over(self, stream: rr.RecordingStream) -> None:
        """Waits for what it has translated, and sends it.

        Args:
            stream: where it goes.

        Raises:
            Damaged: a record makes no sense.
            ReplayError: the recording can't be read any more, or the process was ended.
            OSError: its file can't be written, or read again.
        """
        from rerun.chunk import RrdReader  # noqa: PLC0415  the process itself begins without

        from recorder.viewer.windows import WRITING  # noqa: PLC0415

        said = self._process.stdout.read() if self._process.stdout is not None else b""
        if self._process.wait():
            raise self._failure(said)
        try:
            for number, chunk in enumerate(RrdReader(self._file).stream(), 1):
                stream.send_chunks(chunk)
                if number % _ON_THE_WAY == 0:
                    stream.flush(timeout_sec=WRITING)
        except (RuntimeError, ValueError) as error:  # the library's types for all that can be, and for no such file
            raise OSError(str(error)) from error

    def _failure(self, said: bytes) -> Exception:
        """What has ended the process."""
        try:
            kind, *told = json.loads(said)
        except ValueError:
            code = self._process.returncode
            return ReplayError(f"{self._log.path}: the process that translates half of it was ended (status {code})")
        if kind == Damaged.__name__:
            return Damaged(self._log.path, *told)
        return ReplayError(*told) if kind == ReplayError.__name__ else OSError(*told)


def _path() -> list[str]:
    """Where this process looks for modules; not in the folder that one works in, unless we are there."""
    known = [(entry, str(Path(entry).absolute())) for entry in sys.path if isinstance(entry, str)]
    path = [whole for entry, whole in known if entry or whole == _ROOT]
    return path if _ROOT in path else [_ROOT, *path]  # it goes by another name there


def main(path: str, identity: str, stop: str, root: str, file: str) -> None:
    """Translates what is told of a recording; what goes wrong is said as JSON.

    Args:
        path: the recording.
        identity: of its file; see :class:`~replay.file.log.Log`.
        stop: the step before which to end.
        root: the entity that all others are below; "" for none.
        file: where it goes.
    """
    threading.Thread(target=_end_with_parent, args=[Path(file).parent], name="parent", daemon=True).start()
    gc.disable()  # rows live until they are sent, and it would walk over them in vain
    try:
        _tell(path, identity, int(stop), root, file)
    except Damaged as error:
        told = [Damaged.__name__, error.where, error.cause]
    except ReplayError as error:
        told = [ReplayError.__name__, str(error)]
    except (OSError, RuntimeError) as error:  # the latter is the viewer's library's type for all
        told = [OSError.__name__, str(error)]
    else:
        return
    print(json.dumps(told), flush=True)
    sys.exit(1)


def _end_with_parent(folder: Path) -> None:
    """Ends when the other process does, however that ends: this pipe closes with it."""
    os.read(sys.stdin.fileno(), 1)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _tell(path: str, identity: str, stop: int, root: str, file: str) -> None:
    from recorder.viewer.translator import Half, Translator  # noqa: PLC0415  the one that waits has them already
    from recorder.viewer.windows import stream_to_file  # noqa: PLC0415
    from replay.view.translation import show  # noqa: PLC0415

    with Log(path) as log:
        if log.identity != identity:
            raise ReplayError(f"{path}: another file stands there since it was opened; begin again")
        with stream_to_file(Path(file), part=True) as stream:
            show(log, Translator(stream, root, Half.TOLD), stop)
