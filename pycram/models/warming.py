"""Warming caches: a process repeats the imports and the cached computations of its first fork, once for all forks.

Below the decorator of a cache, :func:`notable` notes the arguments of each computation. A fork sends its notes to its
parent as text. The parent calls the same functions, so later forks find the results in the caches. No code of the plan
runs in the parent.
"""

from __future__ import annotations

import base64
import importlib
import pickle
import sys
import sysconfig
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import wraps
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

P = ParamSpec("P")
R = TypeVar("R")

_OURS: Final = ("pycram", "recorder")
_noted: list[tuple[str, str, Any]] | None = None


@dataclass(slots=True)
class Notes:
    """Notes about the computations and imports of a run."""

    calls: list[tuple[str, str, Any]] = field(default_factory=list)  # module, name and arguments of functions
    before: frozenset[str] = frozenset()  # modules imported before the run

    def text(self) -> str:
        """Return the notes as text for :func:`warm`."""
        libraries = tuple(sysconfig.get_path(each) for each in ("stdlib", "platstdlib", "purelib", "platlib"))
        imported = [
            name
            for name, module in sys.modules.copy().items()  # a copy, because garbage collection may import modules
            if name not in self.before
            and (name.partition(".")[0] in _OURS or str(getattr(module, "__file__", "")).startswith(libraries))
        ]
        return base64.b64encode(pickle.dumps((imported, self.calls))).decode()


def notable(function: Callable[P, R]) -> Callable[P, R]:
    """Note each call of a function that has only positional arguments; apply this decorator below ``lru_cache``."""

    @wraps(function)
    def compute(*arguments: P.args, **keywords: P.kwargs) -> R:
        if _noted is not None and not keywords:
            _noted.append((function.__module__, function.__qualname__, arguments))
        return function(*arguments, **keywords)

    return compute


@contextmanager
def noted() -> Iterator[Notes]:
    """Take notes while the block runs."""
    global _noted  # noqa: PLW0603  a variable of the process, like the caches
    notes = Notes(before=frozenset(sys.modules.copy()))
    _noted = notes.calls
    try:
        yield notes
    finally:
        _noted = None


def warm(text: str) -> None:
    """Repeat the imports and computations of a fork of this process, given the text of its notes."""
    imported, calls = pickle.loads(base64.b64decode(text))  # noqa: S301  the notes come from a fork of this process
    for name in imported:
        with suppress(Exception):  # an import may raise any error, which the next run reports
            importlib.import_module(name)
    for module, name, arguments in calls:
        with suppress(Exception):  # the next run raises and reports the error
            getattr(importlib.import_module(module), name)(*arguments)
