"""Runs verbs of ``pycram-replay`` in a fork of the process, with limits, and tells how they end."""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from replay.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Sequence

SECONDS: Final = 10
MEMORY: Final = 500 << 20  # bytes
_LIMITS: Final = (signal.SIGXCPU, signal.SIGKILL, signal.SIGALRM)
#: What Python itself opens, and PyCRAM of its own, wherever these are installed.
_OWN: Final = tuple({str(Path(each).resolve()) for each in (sys.prefix, sys.base_prefix, *sys.path) if each})
_SYSTEM: Final = ("/dev/null", "/proc/", "/sys/", "/etc/localtime", "/usr/share/zoneinfo", "/etc/ld.so")


@dataclass(frozen=True, slots=True)
class Ended:
    """How a verb ended.

    Attributes:
        code: its exit code; -1 if it was ended.
        signal: name of the signal that ended it, or "".
        output: what it printed, on stdout first.
        opened: files that it opened though they are neither the recording nor PyCRAM's own.
    """

    code: int
    signal: str
    output: str
    opened: tuple[str, ...]

    @property
    def well(self) -> bool:
        """Whether it neither crashed, nor hung, nor opened what it shouldn't, nor made an error of PyCRAM's own."""
        return self.code in (0, 1, 2, 3) and not self.opened


def run(arguments: Sequence[str], folder: Path) -> Ended:
    """Run a verb in a fork, which may write to a folder."""
    outputs = [folder / "stdout", folder / "stderr", folder / "opened"]
    child = os.fork()
    if not child:
        try:
            _become(arguments, folder, outputs)
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
            raise
        finally:
            os._exit(70)
    _, status = os.waitpid(child, 0)
    ended = os.waitstatus_to_exitcode(status)
    texts = [file.read_text(errors="replace") for file in outputs]
    return Ended(
        max(ended, -1),
        signal.Signals(-ended).name if ended < 0 else "",
        texts[0] + texts[1],
        tuple(dict.fromkeys(texts[2].splitlines())),
    )


def _become(arguments: Sequence[str], folder: Path, outputs: Sequence[Path]) -> None:
    out, error, opened = (os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC) for file in outputs)
    os.dup2(out, 1)
    os.dup2(error, 2)
    sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(12 * SECONDS)  # of a busy machine: what waits for something else
    temporary = os.path.realpath(tempfile.gettempdir())
    allowed = (str(folder.resolve()), *_OWN, *_SYSTEM)

    def audit(event: str, values: tuple[object, ...]) -> None:
        if event == "open" and isinstance(values[0], str | bytes | os.PathLike):
            path = os.path.realpath(os.fsdecode(values[0]))
            known = path.startswith(allowed) or "/pycram-models-" in path  # made by this test, or by one before it
            if not known and path != temporary:  # in which a file without a name is made
                os.write(opened, f"{path}\n".encode())
        elif event in ("socket.connect", "subprocess.Popen", "os.system", "os.exec"):
            os.write(opened, f"{event} {values}\n".encode())

    sys.addaudithook(audit)
    code = main(list(arguments))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
