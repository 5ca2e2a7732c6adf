"""The viewer's own window on this machine's screen, as a process that outlives the one which opens it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from typing import IO, Final

from recorder.viewer.address import HOST, PORT, ViewerGone, address, answers, free_port, is_own, wait_for_answer

END_TIMEOUT: Final = 2.0  # s that a viewer whose connection broke takes to end


class ViewerWindow:
    """This user's viewer that is open on this machine, or a new one that outlives this process.

    Its server answers before its window opens, and it ends then if there is no screen. So whoever can't reach it any
    more calls :meth:`check`.

    Attributes:
        url: Where it takes records; it answered there.

    Raises:
        ViewerGone: It ended at once, or can't be told from another user's.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  its last line is read when it ended
        self.url = address(PORT)
        if not (is_own(PORT) and answers(self.url)):
            self._start(free_port(PORT))

    def _start(self, port: int) -> None:
        self.url = address(port)
        self._process = subprocess.Popen(  # noqa: S603  the viewer that came with the library
            [sys.executable, "-m", "rerun_cli", "--port", str(port), "--bind", HOST, "--expect-data-soon"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._stderr,
            start_new_session=True,  # Ctrl-C is for the plan
            env=os.environ | {"RERUN_APP_ONLY": "true"},
        )
        wait_for_answer(self.url, self.check)
        if not is_own(port):  # somebody was quicker than it
            raise ViewerGone(f"another user's program listens at {self.url}")

    def check(self, timeout: float = 0.0) -> None:
        """Check that it lives.

        Args:
            timeout: s to wait for its end, as it is ending when a connection to it broke.

        Raises:
            ViewerGone: It was closed, or ended with an error, for example because there is no screen.
        """
        if self._process is None:
            return
        with suppress(subprocess.TimeoutExpired):
            code, words = self._process.wait(timeout), _last_line(self._stderr)
            if code or words.startswith("Error"):  # the viewer's code is 0 then, too
                raise ViewerGone(f"the viewer didn't open ({words})")
            raise ViewerGone("the viewer was closed")


def _last_line(stderr: IO[bytes]) -> str:
    stderr.seek(0)
    lines = stderr.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "it didn't say why")
