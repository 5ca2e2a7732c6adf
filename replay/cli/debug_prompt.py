"""A prompt as pdb's: lines from a terminal, with history and completion, or from a script on stdin."""

from __future__ import annotations

import cmd
import contextlib
import os
import sys
from typing import TYPE_CHECKING, Final

from recorder.user_folders import cache_folder
from replay.cli.console import visible
from replay.errors import ReplayError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_HISTORY: Final = 1000  # lines


class LinePrompt(cmd.Cmd):
    """Takes commands from a terminal, or from lines on stdin, which are printed as they are carried out."""

    prompt = "(debug) "

    def __init__(self) -> None:
        super().__init__()
        self._asks = self.use_rawinput = sys.stdin.isatty()
        self._coloured = sys.stdout.isatty() and "NO_COLOR" not in os.environ

    def run(self) -> None:
        """Take commands until the end of the input, or ``quit``."""
        with self._history():
            while True:
                try:
                    self.cmdloop()
                except KeyboardInterrupt:
                    print("--KeyboardInterrupt--")
                else:
                    return

    @contextlib.contextmanager
    def _history(self) -> Iterator[None]:
        """Keep what is typed at a terminal for the next session, where lines can be edited."""
        folder = cache_folder() if self._asks else None
        try:
            import readline  # noqa: PLC0415  some systems lack it
        except ImportError:
            folder = None
        if folder is None:
            yield
            return
        file = folder / "debug_history"
        with contextlib.suppress(OSError):
            readline.read_history_file(file)
        readline.set_history_length(_HISTORY)
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                readline.write_history_file(file)

    # --- lines ------------------------------------------------------------------------------------------------------

    def precmd(self, line: str) -> str:
        """Split a line at ``;;``, as pdb does; print those of a script."""
        if not self._asks:
            print("" if line == "EOF" else visible(line.rstrip("\n")))
        first, separator, rest = line.partition(";;")
        if separator:
            self.cmdqueue.insert(0, rest.strip())
        return "" if first.lstrip().startswith("#") else first.strip()

    def onecmd(self, line: str) -> bool:
        """Carry out a command; what can't be done is told."""
        try:
            return bool(super().onecmd(line))
        except ReplayError as error:
            self.print_error(str(error))
        except SystemExit:  # of wrong arguments, which are told already
            pass
        except KeyboardInterrupt:
            print("--KeyboardInterrupt--")
        finally:
            sys.stdout.flush()
        return False

    def emptyline(self) -> bool:
        """Repeat the last command at a terminal, as pdb does; do nothing in a script."""
        return bool(self._asks and self.lastcmd and self.onecmd(self.lastcmd))

    # --- what is printed --------------------------------------------------------------------------------------------

    def print_error(self, text: str) -> None:
        """Print what can't be done, and why."""
        print(self.painted(f"*** {text}", "31"))

    def print_lines(self, lines: Iterable[str]) -> None:
        """Print results."""
        for line in lines:
            print(visible(line))

    def painted(self, text: str, colour: str) -> str:
        """Return a text in a colour, by its number in the terminal's sequences, where stdout is a terminal."""
        shown = visible(text)
        return f"\x1b[{colour}m{shown}\x1b[0m" if self._coloured else shown
