"""Forks of a process that records."""

from __future__ import annotations

import subprocess
import sys

# Ctrl-C strikes while Python runs the hooks of a fork, as logging and random have them.
STRUCK = """
import os, signal
from recorder.tracing import forking
os.register_at_fork(after_in_parent=lambda: signal.raise_signal(signal.SIGINT))
try:
    if not forking.fork():
        os._exit(0)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_a_ctrl_c_within_a_fork_is_not_lost() -> None:
    ended = subprocess.run([sys.executable, "-c", STRUCK], capture_output=True, text=True, check=True)
    assert (ended.stdout, ended.stderr) == ("interrupted\n", "")
