"""What a run has computed of models and imported, so that a process can do it once for all its forks.

Functions that are cached by their arguments alone note them where they compute (:func:`notable`, below the cache's
decorator). A fork's notes go to its parent as text; the parent calls the same functions, and its next forks find the
answers. So nothing of the plan itself ever runs in the parent.
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
    """What was computed and imported."""

    calls: list[tuple[str, str, Any]] = field(default_factory=list)
    """Module, name and arguments of functions, in the order in which they were called."""
    before: frozenset[str] = frozenset()  # The modules that had been imported

    def text(self) -> str:
        """Return it as text for :func:`warm`."""
        libraries = tuple(sysconfig.get_path(each) for each in ("stdlib", "platstdlib", "purelib", "platlib"))
        imported = [
            name
            for name, module in sys.modules.copy().items()  # a garbage collection may import something
            if name not in self.before
            and (name.partition(".")[0] in _OURS or str(getattr(module, "__file__", "")).startswith(libraries))
        ]
        return base64.b64encode(pickle.dumps((imported, self.calls))).decode()


def notable(function: Callable[P, R]) -> Callable[P, R]:
    """Note the arguments with which a function is called, of positional ones only; for below ``lru_cache``."""

    @wraps(function)
    def compute(*arguments: P.args, **keywords: P.kwargs) -> R:
        if _noted is not None and not keywords:
            _noted.append((function.__module__, function.__qualname__, arguments))
        return function(*arguments, **keywords)

    return compute


@contextmanager
def noted() -> Iterator[Notes]:
    """Take notes while the block runs."""
    global _noted  # noqa: PLW0603  of the process, as the caches are
    notes = Notes(before=frozenset(sys.modules.copy()))
    _noted = notes.calls
    try:
        yield notes
    finally:
        _noted = None


def warm(text: str) -> None:
    """Import and compute what a fork of this process has: it wasn't read from anywhere else, so it can be trusted."""
    imported, calls = pickle.loads(base64.b64decode(text))  # noqa: S301  from our own fork, by its pipe
    for name in imported:
        with suppress(Exception):  # the next run will say what is wrong
            importlib.import_module(name)
    for module, name, arguments in calls:
        with suppress(Exception):  # as above
            getattr(importlib.import_module(module), name)(*arguments)
