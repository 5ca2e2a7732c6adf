"""Commands on a terminal: colours, a pager, help with examples, progress in lines, and completion in shells."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import IO, TYPE_CHECKING, Any, Final, TextIO, cast

from recorder.errors import did_you_mean

if TYPE_CHECKING:
    import subprocess

_COLOURS: Final = {"bold": "1", "dim": "2", "red": "31", "green": "32", "yellow": "33", "cyan": "36"}
_HELP: Final = re.compile(
    r"(?P<bold>^[a-z][a-z ]*:(?=\s))|(?P<cyan>^ +(?:-\S+(?:, --\S+)?|[a-z_]+(?=  +\S)|pycram\b.*?(?=$|  )))",
    re.MULTILINE,
)
_WRONG_CHOICE: Final = re.compile(r"invalid choice: '(?P<given>.*?)' \(choose from (?P<known>.*)\)")
_PAGER: Final = "less -RFX"
_COMPLETING: Final = "_ARGCOMPLETE"  # environment variable that a shell sets when it asks for completions
PERIOD: Final = 10.0  # time in s between lines of progress


def has_colours(stream: IO[str]) -> bool:
    """Return whether a stream gets colours; ``NO_COLOR`` turns colours off, ``FORCE_COLOR`` on without a terminal."""
    if os.environ.get("NO_COLOR"):
        return False
    return bool(os.environ.get("FORCE_COLOR")) or (stream.isatty() and os.environ.get("TERM") != "dumb")


def painted(text: str, pattern: re.Pattern[str], stream: IO[str]) -> str:
    """Return a text. On a stream with colours, each match has the colour after which its group is named."""
    if not has_colours(stream):
        return text
    return pattern.sub(lambda match: coloured(match[0], match.lastgroup or "bold"), text)


def coloured(text: str, colour: str) -> str:
    """Return a text in a colour."""
    return f"\x1b[{_COLOURS[colour]}m{text}\x1b[0m"


class _Pager(io.TextIOBase):
    """A stream of output for a terminal. Output that is longer than the screen is shown in a pager."""

    def __init__(self, terminal: IO[str], command: str) -> None:
        self._target: IO[str] = terminal
        self._command = command
        self._held: list[str] | None = []  # text that isn't printed yet; None when it has been printed
        self._columns = self._lines = 0
        self._process: subprocess.Popen[str] | None = None
        with contextlib.suppress(OSError):  # COLUMNS and LINES may describe another terminal
            self._columns, self._lines = os.get_terminal_size(terminal.fileno())
        if not (self._columns and self._lines):
            self._columns, self._lines = shutil.get_terminal_size()

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> int:
        if self._held is None:
            self._target.write(text)
            return len(text)
        self._held.append(text)
        self._lines -= sum(1 + len(line) // self._columns for line in text.splitlines() or [""])
        if self._lines < 1:
            import shlex  # noqa: PLC0415  imported here: only long output needs a pager
            import subprocess  # noqa: PLC0415  as above

            with contextlib.suppress(OSError, ValueError):  # if there is no pager, the output is printed
                self._process = subprocess.Popen(  # noqa: S603  the command comes from $PAGER
                    shlex.split(self._command),
                    stdin=subprocess.PIPE,
                    text=True,
                    encoding="utf-8",
                    errors="backslashreplace",
                    env={"LESS": _PAGER.partition(" ")[2]} | os.environ,
                )
                assert self._process.stdin is not None  # noqa: S101  for mypy
                self._target = self._process.stdin
            self._print_held()
        return len(text)

    def _print_held(self) -> None:
        held, self._held = self._held or [], None
        self._target.write("".join(held))

    def finish(self) -> None:
        """Print the remaining output, and wait until the user quits the pager."""
        try:
            if self._held is not None:
                self._print_held()
            self._target.flush()
        finally:
            while self._process is not None:
                with contextlib.suppress(BrokenPipeError):  # the user has quit the pager
                    self._target.close()
                with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C belongs to the pager
                    self._process.wait()
                    self._process = None


@contextlib.contextmanager
def paged() -> Iterator[None]:
    """Run a block. If its output on a terminal exceeds the screen, ``$PAGER`` (less) shows the output."""
    terminal, command = sys.stdout, os.environ.get("PAGER", _PAGER)
    if not (terminal.isatty() and sys.stdin.isatty() and command.strip()) or os.environ.get("TERM") == "dumb":
        yield
        return
    pager = _Pager(terminal, command)
    sys.stdout = cast("TextIO", pager)  # printing needs only the method ``write``
    try:
        yield
    finally:
        sys.stdout = terminal
        pager.finish()


def messages() -> IO[str]:
    """Return the stream for messages: stderr, or the open pager, because stderr would overwrite the pager's text."""
    return sys.stdout if isinstance(cast("object", sys.stdout), _Pager) and sys.stderr.isatty() else sys.stderr


class Parser(argparse.ArgumentParser):
    """A parser with coloured help and examples, similar names in errors, and completion in shells."""

    def __init__(
        self,
        *args: Any,
        examples: Callable[[], Iterable[tuple[str, str]]] = lambda: (),
        completers: Mapping[str, Callable[..., list[str]]] | None = None,
        **options: Any,
    ) -> None:
        self._examples = examples  # commands and their results
        self._completers = completers or {}  # completers, by the name or placeholder of an argument
        super().__init__(*args, **options)
        self._negative_number_matcher = re.compile(r"-[\d.]")  # points and times, such as -1,0,2 and -2.5s, too

    def add_argument(self, *args: Any, **options: Any) -> argparse.Action:
        """Add an argument, with its completer."""
        action = super().add_argument(*args, **options)
        for name in (action.dest, action.metavar):
            if isinstance(name, str) and name in self._completers:
                vars(action)["completer"] = self._completers[name]  # argcomplete reads this attribute
        return action

    def format_help(self) -> str:
        """Return the help and its examples."""
        shown = "\n".join(example_lines(list(self._examples())))
        return super().format_help() + (f"\nexamples:\n{shown}\n" if shown else "")

    def print_help(self, file: Any = None) -> None:
        """Print the help, in colours on a terminal."""
        stream = sys.stdout if file is None else file
        stream.write(painted(self.format_help(), _HELP, stream))

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments; an error about unknown arguments shows the usage of the subcommand."""
        options, unknown = self.parse_known_args(args, namespace)
        verbs = (each for each in self._actions if isinstance(each, argparse._SubParsersAction))  # noqa: SLF001
        if unknown:
            parser = next((each.choices[getattr(options, each.dest)] for each in verbs), self)
            parser.error(f"unrecognized arguments: {' '.join(unknown)}")
        return options

    def error(self, message: str) -> Any:
        """Exit with a message about wrong usage."""
        if wrong := _WRONG_CHOICE.search(message):
            message += did_you_mean(wrong["given"], re.findall(r"[\w.-]+", wrong["known"]))
        super().error(message)


def example_lines(examples: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield commands and their results, in two columns, or below each other if the terminal is too narrow."""
    width = max((len(command) for command, _ in examples), default=0)
    fits = 4 + width + max((len(result) for _, result in examples), default=0) <= shutil.get_terminal_size().columns
    for command, result in examples:
        yield f"  {command:{width}}  {result}" if fits else f"  {command}\n      {result}"


class ProgressLines:
    """A clock for lines of progress every 10 s, on streams that can't show a progress bar."""

    def __init__(self) -> None:
        self._next = time.monotonic() + PERIOD

    def due(self) -> bool:
        """Return whether a line is due. If a line is due, the next one is due 10 s later."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + PERIOD
        return True


def typed_words() -> list[str] | None:
    """Return the finished words of the command line that a shell wants to complete; None if no shell asks."""
    if _COMPLETING not in os.environ:
        return None
    line = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", "0"))]
    words = line.split()
    return words[1:] if line.endswith(" ") else words[1:-1]


def complete(parser: argparse.ArgumentParser) -> None:
    """If a shell asks for completions, print them and exit."""
    if _COMPLETING in os.environ:
        import argcomplete  # noqa: PLC0415  imported here: only completion in shells needs it

        argcomplete.autocomplete(parser, always_complete_options=False)


def files_ending(*suffixes: str) -> Callable[..., list[str]]:
    """Return a completer for folders and for files with the suffixes."""

    def complete_file(prefix: str, **_: object) -> list[str]:
        folder, slash, start = prefix.rpartition("/")
        # os.path.expanduser keeps "./"
        with contextlib.suppress(OSError), os.scandir(os.path.expanduser(folder + slash) or ".") as entries:  # noqa: PTH111
            return [
                f"{folder}{slash}{entry.name}{'/' * entry.is_dir()}"
                for entry in entries
                if entry.name.startswith(start)
                and (entry.name.endswith(suffixes) or (entry.is_dir() and not entry.name.startswith(".")))
            ]
        return []

    return complete_file
