"""The debugger in a terminal, as a person uses it over both demos: completion, history, colours, Ctrl-C."""

from __future__ import annotations

import codecs
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import TYPE_CHECKING

import pyte
import pytest

from tests.replay.documented import REPO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_TIMEOUT, _AGAIN = 120.0, 5.0  # s
_COLUMNS, _ROWS = 300, 60
ENTER, TAB, UP = "\r", "\t", "\x1b[A"
_PROMPT = "(debug)"


class Terminal:
    """A terminal of 300 columns in which the debugger runs."""

    def __init__(self, folder: Path, cache: Path, *arguments: str | Path) -> None:
        environment = os.environ | {"PYTHONPATH": str(REPO), "PYCRAM_CACHE": str(cache), "TERM": "linux"}
        command = [sys.executable, "-m", "replay", "debug", *map(str, arguments)]
        self.coloured = ""  # all output, with the terminal's sequences for colours
        self._screen = pyte.HistoryScreen(_COLUMNS, _ROWS, history=10_000)
        self._stream = pyte.Stream(self._screen)
        self._decoder = codecs.getincrementaldecoder("utf-8")()
        end, self._fd = pty.openpty()[::-1]
        fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("HHHH", _ROWS, _COLUMNS, 0, 0))
        # The child makes the terminal its controlling one, so that Ctrl-C interrupts it.
        start = "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY); os.execv(sys.argv[1], sys.argv[1:])"
        self._process = subprocess.Popen(
            [sys.executable, "-c", start, *command],
            stdin=end,
            stdout=end,
            stderr=end,
            cwd=folder,
            env=environment,
            start_new_session=True,
        )
        os.close(end)

    @property
    def lines(self) -> list[str]:
        past = ["".join(line[column].data for column in range(_COLUMNS)).rstrip() for line in self._screen.history.top]
        return "\n".join([*past, *(line.rstrip() for line in self._screen.display)]).rstrip().splitlines()

    def keys(self, text: str) -> None:
        os.write(self._fd, text.encode())

    def type(self, text: str, key: str = "") -> str:
        """Types a command, then presses a key and Enter, and returns the output up to the next prompt."""
        before = len(self.lines)
        self.keys(text + key)
        self.keys(ENTER)
        return self.shown(before)

    def shown(self, before: int = 0) -> str:
        """Return the output after a number of lines, once a prompt follows it."""
        self._wait(lambda lines: len(lines) > before and lines[-1].rstrip() == _PROMPT)
        return "\n".join(self.lines[max(before - 1, 0) :])

    def interrupt(self, typed: str) -> None:
        """Types something, presses Ctrl-C when it is on the screen, and waits for the next prompt.

        Presses it again if nothing happens: Python misses an interrupt while it handles a key, until the next key.
        """
        before = len(self.lines)
        self.keys(typed.replace("\n", ENTER))
        self._wait(lambda lines: typed.strip() in lines[before - 1])
        while True:
            self.keys("\x03")
            if self._reached(lambda lines: len(lines) > before and lines[-1].rstrip() == _PROMPT, _AGAIN):
                return

    def _wait(self, is_all: Callable[[list[str]], bool]) -> None:
        assert self._reached(is_all, _TIMEOUT), "\n".join(self.lines)

    def _reached(self, is_all: Callable[[list[str]], bool], timeout: float) -> bool:
        while not is_all(self.lines):
            if not select.select([self._fd], (), (), timeout)[0] or not self._read():
                return False
        return True

    def _read(self) -> bool:
        try:
            read = self._decoder.decode(os.read(self._fd, 1 << 16))
        except OSError:  # Linux' way to say that no process has the terminal any more
            return False
        self.coloured += read
        self._stream.feed(read)
        return True

    def end(self, keys: str) -> int:
        """Presses keys that end the debugger, and returns its exit code."""
        self.keys(keys)
        while select.select([self._fd], (), (), _TIMEOUT)[0] and self._read():
            pass
        return self._process.wait(_TIMEOUT)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._fd)


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    """A history of its own, but the meshes that other processes of the run have converted."""
    folder = tmp_path / "cache"
    folder.mkdir()
    for converted in Path(os.environ["PYCRAM_CACHE"]).glob("*.mesh"):
        (folder / converted.name).symlink_to(converted)
    return folder


@pytest.fixture
def terminal(cache: Path, tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    opened = []

    def opening(*arguments: str | Path) -> Terminal:
        opened.append(Terminal(tmp_path, cache, *arguments))
        return opened[-1]

    yield opening
    for each in opened:
        each.close()


def step(shown: str) -> int:
    """The step that the prompt has told last."""
    return int(re.findall(r"^step (\d+) of", shown, re.MULTILINE)[-1])


@pytest.mark.costly
@pytest.mark.slow
def test_a_person_finds_out_why_a_demo_failed(
    terminal: Callable[..., Terminal], failed_log: Path, tmp_path: Path
) -> None:
    prompt = terminal(failed_log)
    assert "PickUp failed" in prompt.shown()
    assert "\x1b[36mstep 161" in prompt.coloured
    assert "try_to_take()" in prompt.type("whe", TAB)
    assert "'r_gripper_tool_frame'" in prompt.type("p grip", TAB)
    assert "Breakpoint 1: task pick-up" in prompt.type("b pick", TAB)
    assert step(prompt.type("rc")) == 158
    assert step(prompt.type("")) == 120, "an empty line does the same again"
    prompt.keys("p milk.get_posi" + TAB)
    assert "1.72" in prompt.type("()[0]")
    prompt.interrupt("p wro")
    prompt.interrupt("p [0 for _ in iter(int, 1)]\n")
    assert prompt.coloured.count("--KeyboardInterrupt--") == 2
    prompt.type("u")
    assert "\nattempt['place'] = [0.65, 0.6, 0]" in prompt.type("print(f\"attempt['place'] = {attempt['place']}\")")
    assert "pick-up was attempted 4 times" in prompt.type("why")
    assert "step 101" in prompt.type("blame pr2")
    fork = tmp_path / "on.mcap"
    assert "fails_to_reach.mcap; the plan failed" in prompt.type(f"fork {fork}")
    assert fork.exists()
    assert step(prompt.type("g 0")) == 0
    prompt.interrupt("c\n")  # it comes to the breakpoint, or is interrupted before
    prompt.type("s")
    assert prompt.end("\x04") == 0


@pytest.mark.costly
def test_a_person_follows_the_demo_to_and_fro(
    terminal: Callable[..., Terminal], recorded_demo: Callable[[str], Path], cache: Path
) -> None:
    history = cache / "debug_history"
    history.write_text("locals\nwatch milk.z\n")
    prompt = terminal(recorded_demo("set_the_table"), "0")
    assert step(prompt.shown()) == 0
    assert "Watch 1: milk.z: step" in prompt.type("", UP), "the last line of the session before"
    loaded = step(prompt.type("c"))
    assert "\x1b[33mwatch milk.z: None -> 1" in prompt.coloured
    prompt.type("clear 1")
    assert "Breakpoint 2: task pick-up" in prompt.type("b pick", TAB)
    shown = prompt.type("c")
    assert "Breakpoint 2, task pick-up" in shown
    begun = step(shown)
    assert "move_object()" in prompt.type("where")
    prompt.keys("p obj" + TAB)
    assert "\n'bowl'" in prompt.type("_t", TAB)
    assert step(prompt.type("s")) == begun + 1
    assert step(prompt.type("rs")) == begun
    over = step(prompt.type("n"))
    assert over > begun + 1
    assert step(prompt.type("rn")) == begun
    assert "pick-up" in prompt.type("tree")
    assert "bowl" in prompt.type("state bow", TAB)
    assert "stable(bowl): yes" in prompt.type("ask stable(bowl)")
    assert "bowl moved in simulation" in prompt.type("blame bowl")
    assert loaded < step(prompt.type("rwatch milk.z")) < begun
    assert prompt.end("q" + ENTER) == 0
    assert history.read_text().endswith("ask stable(bowl)\nblame bowl\nrwatch milk.z\nq\n")
