"""The reasoning queries of the thesis (section 4.4, table 4.3); plans import this module as ``btr``.

Queries don't change the world. A camera is given by its frame's name, its position, or a pair of position and
orientation.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pycram.foundation.failures import ReasoningError

if TYPE_CHECKING:
    from pycram.reasoning.queries.contact import contact, supporting
    from pycram.reasoning.queries.reachability import (
        blocking,
        reachable,
        reachable as reachable_position,
        reachable_object,
        reachable_pose,
        reachable_poses,
    )
    from pycram.reasoning.queries.stability import stable
    from pycram.reasoning.queries.visibility import occluding, visible

__all__ = [
    "ReasoningError",
    "blocking",
    "contact",
    "occluding",
    "reachable",
    "reachable_object",
    "reachable_pose",
    "reachable_poses",
    "reachable_position",
    "stable",
    "supporting",
    "visible",
]

#: Modules of the queries. Each module is imported with its first query; importing all takes 30 ms.
_MODULES = {
    "contact": ("contact", "supporting"),
    "reachability": ("blocking", "reachable", "reachable_object", "reachable_pose", "reachable_poses"),
    "stability": ("stable",),
    "visibility": ("occluding", "visible"),
}


def __getattr__(name: str) -> Any:
    query = "reachable" if name == "reachable_position" else name  # the name in table 4.3 is reachable_position
    for module, queries in _MODULES.items():
        if query in queries:
            found = globals()[name] = getattr(import_module(f"pycram.reasoning.queries.{module}"), query)
            return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
