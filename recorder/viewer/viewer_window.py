"""The viewer's own window on this machine's screen, as a process that outlives the one which opens it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from typing import IO

from recorder.viewer.address import HOST, POLL_PERIOD, PORT, ViewerGone, address, answers, free_port


def open_window() -> str:
    """Starts a viewer that outlives this process, unless one is open already; returns its address once it answers.

    Raises:
        ViewerGone: it ended at once, for example because there is no screen.
    """
    if answers(address(PORT)):
        return address(PORT)
    port = free_port(PORT)
    with tempfile.TemporaryFile() as stderr:
        viewer = subprocess.Popen(  # noqa: S603  the viewer that came with the library
            [sys.executable, "-m", "rerun_cli", "--port", str(port), "--bind", HOST, "--expect-data-soon"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            start_new_session=True,  # Ctrl-C is for the plan
            env=os.environ | {"RERUN_APP_ONLY": "true"},
        )
        pause = threading.Event()
        while not answers(address(port)):
            if viewer.poll() is not None:
                raise ViewerGone(f"the viewer didn't open ({_last_line(stderr)})")
            pause.wait(POLL_PERIOD)
    return address(port)


def _last_line(stderr: IO[bytes]) -> str:
    stderr.seek(0)
    lines = stderr.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "it didn't say why")
