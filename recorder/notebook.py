"""Support for notebooks: names of cells, IPython's own variables, and tracebacks with only the plan's lines."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import PurePath
from types import TracebackType
from typing import Any, Final

_CELL: Final = re.compile(r"In \[\d+\]")
_FILE: Final = re.compile(r'(?<=File ")[^"\n]+(?=", line )')
#: Packages whose frames are left out of tracebacks.
_MACHINERY: Final = frozenset({"pycram", "recorder", "replay", "IPython", "ipykernel", "contextlib", "threading"})


def _shell() -> Any:
    ipython = sys.modules.get("IPython")  # IPython isn't imported here, because it is already loaded if it runs
    return ipython.get_ipython() if ipython is not None and hasattr(ipython, "get_ipython") else None


def is_running() -> bool:
    """Return whether this process runs cells of IPython."""
    return _shell() is not None


def title() -> str:
    """Return the name of the running notebook, as given by Jupyter; "" if unknown."""
    return PurePath(os.environ.get("JPY_SESSION_NAME", "")).stem if is_running() else ""


def cell_of(file: str) -> str:
    """Return the name of a cell, such as "In [3]", from the file name of its compiled code; "" for other files."""
    number = getattr(getattr(_shell(), "compile", None), "_filename_map", {}).get(file)
    return f"In [{number}]" if number is not None else ""


def with_cells(traceback: str) -> str:
    """Return a traceback with the names of cells instead of their files."""
    return _FILE.sub(lambda found: cell_of(found[0]) or found[0], traceback) if is_running() else traceback


def is_cell(file: str) -> bool:
    """Return whether a recorded file is a cell."""
    return _CELL.fullmatch(file) is not None


def place(file: str, line: int) -> str:
    """Return the place of a line: "file:line" in a file, "In [3], line 1" in a cell."""
    return f"{file}, line {line}" if is_cell(file) else f"{file}:{line}"


def own_variables() -> Mapping[str, object]:
    """Return the variables that IPython adds to the user's variables: In, Out, _i3, ..."""
    return getattr(_shell(), "user_ns_hidden", {})


def traceback_lines(error: BaseException) -> list[str]:
    """Return IPython's lines for an error and its causes; leave out frames of PyCRAM and IPython if others remain."""
    formatter = _shell().InteractiveTB
    related = [error]
    with ExitStack() as undoing:
        for each in related:  # the loop appends to the list that it iterates over
            others = (each.__cause__, each.__context__, *vars(each).get("failures", ()))
            related += [other for other in others if isinstance(other, BaseException) and other not in related]
            undoing.callback(setattr, each, "__traceback__", each.__traceback__)
            each.__traceback__ = _shortened(each.__traceback__)
        lines: list[str] = formatter.structured_traceback(type(error), error, error.__traceback__, tb_offset=0)
    return lines


def _shortened(trace: TracebackType | None) -> TracebackType | None:
    entries = []
    entry = trace
    while entry is not None:
        if str(entry.tb_frame.f_globals.get("__name__", "")).partition(".")[0] not in _MACHINERY:
            entries.append(entry)
        entry = entry.tb_next
    shown = None
    for each in reversed(entries):
        shown = TracebackType(shown, each.tb_frame, each.tb_lasti, each.tb_lineno)
    return shown or trace
