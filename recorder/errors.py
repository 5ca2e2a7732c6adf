"""The recorder's shared errors, hints for their messages ("did you mean ...?"), and closed pipes."""

from __future__ import annotations

import copyreg
import io
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Final, TextIO

from recorder import notebook

_MAX_SUGGESTED: Final = 3
_MAX_LISTED: Final = 40  # maximum number of names in a hint, such as the joints of a kitchen
_MAX_FILES: Final = 2000  # maximum number of files of a folder that are compared with a name


class PortableError(Exception):
    """An error that keeps its fields when it is pickled or copied."""

    def __reduce__(self) -> tuple[object, ...]:
        """Python's own method would call the class only with the message."""
        new = copyreg.__newobj__  # type: ignore[attr-defined]  # pickle's function for making objects
        return new, (type(self), *self.args), {**vars(self), "args": self.args}

    def _render_traceback_(self) -> list[str]:
        """Return the lines that IPython prints."""
        return notebook.traceback_lines(self)


class RecordingError(PortableError, OSError):
    """A recording can't be written, for example because the folder is missing or the disk is full."""

    def __init__(self, path: str | Path, cause: str, hint: str = "") -> None:
        super().__init__(f"can't record to {path}: {cause}{'; ' + hint if hint else ''}")
        self.path = str(path)
        self.cause = cause  # the system's message


def nearest(name: object, known: Iterable[str]) -> list[str]:
    """Return the up to 3 most similar known names, best first, or else up to 3 known names that contain the name."""
    import difflib  # noqa: PLC0415  imported here: most processes make no suggestion

    names, given = list(known), str(name)
    close = difflib.get_close_matches(given, names, _MAX_SUGGESTED)
    return close or [each for each in names if given and given.casefold() in each.casefold()][:_MAX_SUGGESTED]


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return "; did you mean ...?" with similar known names for the end of a message; "" if no name is similar."""
    near = nearest(name, known)
    return f"; did you mean {' or '.join(near)}?" if near else ""


def similar_files(path: Path, others: Iterable[str] = ()) -> str:
    """Return "; did you mean ...?" with names like that of a missing file, from the file's folder and ``others``."""
    names = list(others)
    with suppress(OSError):
        near = (file for file in islice(path.parent.iterdir(), _MAX_FILES) if file.suffix == path.suffix)
        names += [str(path.parent / file.name) for file in near]
    by_stem = {type(path)(name).stem: name for name in names}
    found = [by_stem[stem] for stem in nearest(path.stem, by_stem)]
    return f"; did you mean {' or '.join(found)}?" if found else ""


def suggestion(name: object, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: similar known names; otherwise the known names, or only their number."""
    names = sorted(set(known))
    if near := did_you_mean(name, names):
        return near.removeprefix("; ")
    if len(names) > _MAX_LISTED:
        return f"there are {len(names)} names, such as {', '.join(names[:_MAX_SUGGESTED])}"
    return f"there are {', '.join(names) or 'none'}"


@contextmanager
def until_closed() -> Iterator[None]:
    """Run a block that prints. If the reader of the output has closed its pipe, the block ends without an error."""
    try:
        yield
    except BrokenPipeError:
        pass
    finally:
        for stream in filter(None, (sys.stdout, sys.stderr)):
            try:
                stream.flush()
            except BrokenPipeError:
                discard(stream)


def discard(stream: TextIO) -> None:
    """Discard the buffered text and all later text of a stream. Otherwise, Python reports an error at its exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(AttributeError, io.UnsupportedOperation):  # a plan may have replaced the stream
        os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
