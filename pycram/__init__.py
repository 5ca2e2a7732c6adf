"""Robot plans that run in a simulated world, which records everything; docs/architecture.md describes the packages."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import recorder  # noqa: F401  limits numpy's threads, so numpy must be imported later

if TYPE_CHECKING:
    from pycram.actions import perform
    from pycram.monitoring import monitored
    from pycram.plan_parameters import UnknownParameter, parameters
    from pycram.running import seed
    from pycram.sweeping import sweep

#: Modules that plans use as ``pycram.NAME``; they are imported on demand, so that commands start fast.
_SOURCES = {
    "UnknownParameter": "pycram.plan_parameters",
    "monitored": "pycram.monitoring",
    "parameters": "pycram.plan_parameters",
    "perform": "pycram.actions",
    "seed": "pycram.running",
    "sweep": "pycram.sweeping",
}
#: Modules from which plans import.
_MODULES = (
    "action_designators",
    "actions",
    "bullet_world",
    "bullet_world_reasoning",
    "designator",
    "event",
    "exploration",
    "failures",
    "fluent",
    "fluents",
    "knowledge",
    "language",
    "motion_designators",
    "process_module",
    "projection",
    "tasks",
)

__all__ = ["UnknownParameter", "monitored", "parameters", "perform", "seed", "sweep"]


def __getattr__(name: str) -> Any:
    if name in _SOURCES:
        return getattr(import_module(_SOURCES[name]), name)
    if name in _MODULES:
        return import_module(f"pycram.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, *_MODULES]
