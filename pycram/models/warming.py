"""Warming caches: a process repeats the imports and the cached computations of its first fork, once for all forks.

A function that is cached by its arguments notes them when it computes (:func:`notable`, below the cache's decorator).
A fork sends its notes to its parent as text. The parent calls the same functions, so that later forks find the results
in the caches. No code of the plan runs in the parent.
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
    """The computations and imports of a run."""

    calls: list[tuple[str, str, Any]] = field(default_factory=list)  # module, name and arguments of functions
    before: frozenset[str] = frozenset()  # modules imported before the run

    def text(self) -> str:
        """Return the notes as text for :func:`warm`."""
        libraries = tuple(sysconfig.get_path(each) for each in ("stdlib", "platstdlib", "purelib", "platlib"))
        imported = [
            name
            for name, module in sys.modules.copy().items()  # garbage collection may import modules
            if name not in self.before
            and (name.partition(".")[0] in _OURS or str(getattr(module, "__file__", "")).startswith(libraries))
        ]
        return base64.b64encode(pickle.dumps((imported, self.calls))).decode()


def notable(function: Callable[P, R]) -> Callable[P, R]:
    """Note each call of a function with positional arguments only; apply below ``lru_cache``."""

    @wraps(function)
    def compute(*arguments: P.args, **keywords: P.kwargs) -> R:
        if _noted is not None and not keywords:
            _noted.append((function.__module__, function.__qualname__, arguments))
        return function(*arguments, **keywords)

    return compute


@contextmanager
def noted() -> Iterator[Notes]:
    """Take notes while the block runs."""
    global _noted  # noqa: PLW0603  caches belong to the process, too
    notes = Notes(before=frozenset(sys.modules.copy()))
    _noted = notes.calls
    try:
        yield notes
    finally:
        _noted = None


def warm(text: str) -> None:
    """Repeat the imports and computations of a fork of this process; its notes come by a pipe and can be trusted."""
    imported, calls = pickle.loads(base64.b64decode(text))  # noqa: S301  from our own fork
    for name in imported:
        with suppress(Exception):  # an import may raise any error; the next run raises and reports it
            importlib.import_module(name)
    for module, name, arguments in calls:
        with suppress(Exception):  # likewise
            getattr(importlib.import_module(module), name)(*arguments)
