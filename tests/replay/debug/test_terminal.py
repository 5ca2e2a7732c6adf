"""The debugger in a real terminal, over a demo, as a person uses it: completion, history, colours, Ctrl-C."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_TIMEOUT, _AGAIN = 120.0, 5.0  # s
_COLOURS = re.compile(r"\x1b\[[\d;?]*[a-zA-Z]")


class Terminal:
    """A prompt in a terminal."""

    def __init__(self, log: Path, cache: Path) -> None:
        self.pid, self._screen = pty.fork()
        if not self.pid:
            os.environ |= {"TERM": "xterm", "PYCRAM_CACHE": str(cache)}
            os.execv(sys.executable, [sys.executable, "-m", "replay", "debug", str(log)])
        self.raw = ""

    def type(self, text: str) -> str:
        """Types something, and gives what is shown up to the next prompt."""
        os.write(self._screen, text.encode())
        return self.shown()

    def interrupt(self, typed: str) -> str:
        """Types something, presses Ctrl-C when it is on the screen, and gives what is shown up to the next prompt.

        Again, if nothing comes of it: Python misses what is pressed while it handles a key, until the next one.
        """
        os.write(self._screen, typed.encode())
        self._read(lambda read: typed.strip() in read)
        while True:
            os.write(self._screen, b"\x03")
            if select.select([self._screen], (), (), _AGAIN)[0]:
                return self.shown()

    def shown(self) -> str:
        return self._read(lambda read: read.endswith("(debug) "))

    def _read(self, is_all: Callable[[str], bool]) -> str:
        read = ""
        while not is_all(_COLOURS.sub("", read)):
            assert select.select([self._screen], (), (), _TIMEOUT)[0], read
            read += os.read(self._screen, 4096).decode()
        self.raw += read
        return _COLOURS.sub("", read).replace("\r", "")

    def end(self) -> int:
        """Types Ctrl-D, and gives the exit code."""
        os.write(self._screen, b"\x04")
        while True:
            try:
                if not os.read(self._screen, 4096):
                    break
            except OSError:  # the other end is closed
                break
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

    def close(self) -> None:
        os.close(self._screen)


@pytest.fixture
def terminal(failed_log: Path, tmp_path: Path) -> Iterator[Terminal]:
    """A history of its own, but the meshes that other processes of the run have converted."""
    (tmp_path / "cache").mkdir()
    for converted in Path(os.environ["PYCRAM_CACHE"]).glob("*.mesh"):
        (tmp_path / "cache" / converted.name).symlink_to(converted)
    opened = Terminal(failed_log, tmp_path / "cache")
    yield opened
    opened.close()


@pytest.mark.costly
@pytest.mark.slow
def test_a_person_finds_out_why_the_demo_failed(terminal: Terminal, tmp_path: Path, failed_log: Path) -> None:
    begun = terminal.shown()
    assert "PickUp failed" in begun
    assert "\x1b[36mstep 161" in terminal.raw
    assert "try_to_take()" in terminal.type("whe\t\n")
    assert "'r_gripper_tool_frame'" in terminal.type("p grip\t\n")
    assert "Breakpoint 1: task pick-up" in terminal.type("b pick\t\n")
    assert "step 158 of" in terminal.type("rc\n")
    assert "step 120 of" in terminal.type("\n"), "an empty line does the same again"
    assert "1.72" in terminal.type("p milk.get_posi\t()[0]\n")
    assert "--KeyboardInterrupt--" in terminal.interrupt("p wro")
    assert "--KeyboardInterrupt--" in terminal.interrupt("p [0 for _ in iter(int, 1)]\n")
    assert "attempt['place'] = [0.65, 0.6, 0]" in terminal.type("u\n") + terminal.type(
        "print(f\"attempt['place'] = {attempt['place']}\")\n"
    )
    assert "step " in terminal.type("g 0\n")
    terminal.interrupt("c\n")  # it comes to the breakpoint, or is interrupted before
    assert re.search(r"step \d+ of", terminal.type("s\n"))
    assert terminal.end() == 0
    again = Terminal(failed_log, tmp_path / "cache")
    again.shown()
    assert "step " in again.type("\x1b[A\n"), "the last line of the session before"
    os.kill(again.pid, signal.SIGKILL)
    os.waitpid(again.pid, 0)
    again.close()
