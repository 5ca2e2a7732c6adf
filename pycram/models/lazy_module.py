"""Modules that are imported when they are first used: trimesh and scipy take longer to load than many plans run."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from recorder.tracing.interrupts import Uninterrupted


class LazyModule:
    """Stands for a module, which is imported when one of its attributes is first asked for.

    Whether it is installed is looked up at once.

    Raises:
        ModuleNotFoundError: It isn't.
    """

    def __init__(self, name: str) -> None:
        package = name.partition(".")[0]
        if importlib.util.find_spec(package) is None:
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        with Uninterrupted():  # libraries that import each other lazily would swallow a Ctrl-C
            value = getattr(importlib.import_module(self._name), attribute)
        setattr(self, attribute, value)
        return value
