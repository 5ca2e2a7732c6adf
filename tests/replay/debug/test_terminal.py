"""The debugger in a terminal, as a person uses it over both demos: completion, history, colours, Ctrl-C."""

from __future__ import annotations

import os
import re
import select
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.replay.documented import REPO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_TIMEOUT, _AGAIN = 120.0, 5.0  # s
_COLOURS = re.compile(r"\x1b\[[\d;]*m")
_PROMPT = "(debug)"


class Terminal:
    """A tmux server with one window, in which the debugger runs."""

    def __init__(self, folder: Path, cache: Path, *arguments: str | Path) -> None:
        self._socket, self._written = folder / "tmux", folder / "written"
        self._environment = os.environ | {"PYTHONPATH": str(REPO), "PYCRAM_CACHE": str(cache)}
        os.mkfifo(self._written)
        self._output = os.open(self._written, os.O_RDWR | os.O_NONBLOCK)  # tells when the window has changed
        command = shlex.join([sys.executable, "-m", "replay", "debug", *map(str, arguments)])
        command += "; echo ended with $?; cat"  # the window stays
        self._tmux("-u", "-f", "/dev/null", "new-session", "-d", "-x", "180", "-y", "60", "-c", str(folder), command)
        self._tmux("pipe-pane", f"cat > {self._written}")

    def _tmux(self, *arguments: str) -> str:
        command = ["tmux", "-S", str(self._socket), *arguments]
        return subprocess.run(command, env=self._environment, check=True, capture_output=True, text=True).stdout

    @property
    def coloured(self) -> str:
        """All that was shown, with the terminal's sequences for colours."""
        return self._tmux("capture-pane", "-p", "-e", "-J", "-S", "-")

    @property
    def lines(self) -> list[str]:
        return _COLOURS.sub("", self.coloured).rstrip().splitlines()

    def keys(self, text: str, *names: str) -> None:
        """Presses keys: those of a text, then others by their names."""
        if text:
            self._tmux("send-keys", "-l", text)
        if names:
            self._tmux("send-keys", *names)

    def type(self, text: str, *names: str) -> str:
        """Types a command, then presses keys and Enter, and gives what is shown up to the next prompt."""
        before = len(self.lines)
        self.keys(text, *names)
        self.keys("", "Enter")
        return self.shown(before)

    def shown(self, before: int = 0) -> str:
        """What is shown after a number of lines, when there is a prompt below it."""
        self._wait(lambda lines: len(lines) > before and lines[-1].rstrip() == _PROMPT)
        return "\n".join(self.lines[max(before - 1, 0) :])

    def interrupt(self, typed: str) -> None:
        """Types something, presses Ctrl-C when it is on the screen, and waits for the next prompt.

        Again, if nothing comes of it: Python misses what is pressed while it handles a key, until the next one.
        """
        before = len(self.lines)
        self.keys(typed.rstrip("\n"), *["Enter"] * typed.endswith("\n"))
        self._wait(lambda lines: typed.strip() in lines[before - 1])
        while True:
            self.keys("", "C-c")
            if self._came(lambda lines: len(lines) > before and lines[-1].rstrip() == _PROMPT, _AGAIN):
                return

    def _wait(self, is_all: Callable[[list[str]], bool]) -> None:
        assert self._came(is_all, _TIMEOUT), "\n".join(self.lines)

    def _came(self, is_all: Callable[[list[str]], bool], timeout: float) -> bool:
        while not is_all(self.lines):
            if not select.select([self._output], (), (), timeout)[0]:
                return False
            os.read(self._output, 1 << 16)
        return True

    def end(self, *keys: str) -> int:
        """Presses keys that end the debugger, and gives its exit code."""
        self.keys("", *keys)
        self._wait(lambda lines: "ended with" in lines[-1])
        return int(self.lines[-1].split()[-1])

    def close(self) -> None:
        self._tmux("kill-server")
        os.close(self._output)


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    """A history of its own, but the meshes that other processes of the run have converted."""
    folder = tmp_path / "cache"
    folder.mkdir()
    for converted in Path(os.environ["PYCRAM_CACHE"]).glob("*.mesh"):
        (folder / converted.name).symlink_to(converted)
    return folder


@pytest.fixture
def terminal(cache: Path) -> Iterator[Callable[..., Terminal]]:
    opened = []
    with tempfile.TemporaryDirectory(prefix="tmux-") as folder:  # names of sockets are short

        def opening(*arguments: str | Path) -> Terminal:
            opened.append(Terminal(Path(folder), cache, *arguments))
            return opened[-1]

        yield opening
        for each in opened:
            each.close()


def step(shown: str) -> int:
    """The step that the prompt has told last."""
    return int(re.findall(r"^step (\d+) of", shown, re.MULTILINE)[-1])


@pytest.mark.needs("tmux")
@pytest.mark.slow
def test_a_person_finds_out_why_a_demo_failed(
    terminal: Callable[..., Terminal], failed_log: Path, tmp_path: Path
) -> None:
    prompt = terminal(failed_log)
    assert "PickUp failed" in prompt.shown()
    assert "\x1b[36mstep 161" in prompt.coloured
    assert "try_to_take()" in prompt.type("whe", "Tab")
    assert "'r_gripper_tool_frame'" in prompt.type("p grip", "Tab")
    assert "Breakpoint 1: task pick-up" in prompt.type("b pick", "Tab")
    assert step(prompt.type("rc")) == 158
    assert step(prompt.type("")) == 120, "an empty line does the same again"
    prompt.keys("p milk.get_posi", "Tab")
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
    assert prompt.end("C-d") == 0


@pytest.mark.needs("tmux")
@pytest.mark.costly
def test_a_person_follows_the_demo_to_and_fro(
    terminal: Callable[..., Terminal], recorded_demo: Callable[[str], Path], cache: Path
) -> None:
    history = cache / "debug_history"
    history.write_text("locals\nwatch milk.z\n")
    prompt = terminal(recorded_demo("set_the_table"), "0")
    assert step(prompt.shown()) == 0
    assert "Watch 1: milk.z: step" in prompt.type("", "Up"), "the last line of the session before"
    loaded = step(prompt.type("c"))
    assert "\x1b[33mwatch milk.z: None -> 1" in prompt.coloured
    prompt.type("clear 1")
    assert "Breakpoint 2: task pick-up" in prompt.type("b pick", "Tab")
    shown = prompt.type("c")
    assert "Breakpoint 2, task pick-up" in shown
    begun = step(shown)
    assert "move_object()" in prompt.type("u")
    prompt.keys("p obj", "Tab")
    assert "\n'bowl'" in prompt.type("_t", "Tab")
    assert step(prompt.type("s")) == begun + 1
    assert step(prompt.type("rs")) == begun
    over = step(prompt.type("n"))
    assert over > begun + 1
    assert step(prompt.type("rn")) == begun
    assert "pick-up" in prompt.type("tree")
    assert "bowl" in prompt.type("state bow", "Tab")
    assert "stable(bowl): yes" in prompt.type("ask stable(bowl)")
    assert "bowl moved in simulation" in prompt.type("blame bowl")
    assert loaded < step(prompt.type("rwatch milk.z")) < begun
    assert prompt.end("q", "Enter") == 0
    assert history.read_text().endswith("ask stable(bowl)\nblame bowl\nrwatch milk.z\nq\n")
