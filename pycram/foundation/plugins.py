"""Robots, process modules and actions of other packages: entry points that are loaded when a plan uses their name.

``docs/guides/process_modules.md`` shows how a package declares entry points. The log of a run names each loaded entry
point and the version of its package.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from pycram.foundation.errors import export
from pycram.foundation.failures import UsageError

ROBOTS = "pycram.robots"
PROCESS_MODULES = "pycram.process_modules"
ACTIONS = "pycram.actions"


class PluginFailed(UsageError):
    """An entry point of another package can't be used."""

    def __init__(self, group: str, name: str, packages: list[str], problem: str) -> None:
        super().__init__(f"{name} of {' and '.join(packages)} (entry point of {group}) can't be used: {problem}")
        self.group = group  # group of the entry point, such as "pycram.robots".
        self.name = name  # name of the entry point
        self.packages = packages  # names and versions of the packages that declare the name
        self.problem = problem


export("pycram.failures", PluginFailed)


@cache
def load(group: str, name: str) -> Any:
    """Return the object of an entry point; None if no package has the name. Raise PluginFailed if loading fails."""
    import logging  # noqa: PLC0415  imported here: slow to import, and few plans use plugins
    from importlib.metadata import entry_points  # noqa: PLC0415  imported here: slow to import

    found = list(entry_points(group=group, name=name))
    if not found:
        return None
    packages = [f"{each.dist.name} {each.dist.version}" if each.dist else "a package" for each in found]
    if len(found) > 1:
        raise PluginFailed(group, name, packages, "uninstall all of these packages but one")
    try:
        loaded = found[0].load()
    except (ImportError, AttributeError) as error:
        raise PluginFailed(group, name, packages, str(error)) from error
    log = logging.getLogger("pycram.plugins")
    log.setLevel(logging.INFO)  # otherwise the log level of the plan could drop the line
    log.info("loaded %s of %s (%s: %s)", name, packages[0], group, found[0].value)
    return loaded
