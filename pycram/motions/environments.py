"""Execution environments: sets of process modules, one for each robot (thesis 4.8).

The plan names neither robot nor module, so the same plan runs in simulation and, with other modules, on a real robot.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, runtime_checkable

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld, UsageError
from pycram.foundation.names import export
from pycram.models.robots.description import why_none
from pycram.scheduling.cancellation import Binding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pycram.motions.designator import Designator
    from pycram.motions.resources import Resources
    from pycram.world.object import Object
    from pycram.world.world import BulletWorld


@runtime_checkable
class Module(Protocol):
    """A process module, as environments and motions use it."""

    def resources(self, designator: Designator) -> Resources | None:
        """Return what carrying a designator out needs of the robot."""

    def execute(self, designator: Designator) -> Any:
        """Carry a designator out."""


Modules: TypeAlias = Mapping[str, Module]

SIMULATED = "simulated"
"""The environment in which motions are done at once."""
CONTINUOUS = "continuous"
"""The environment in which they take simulated time."""

_environment: ContextVar[str] = ContextVar("pycram_environment", default="")
_of_run = SIMULATED  # where the plan names none, in any thread
_lock = threading.Lock()
_registered: dict[tuple[str, str], Modules] = {}
_defaults: dict[str, Callable[[], Modules]] = {}
_of_world: weakref.WeakKeyDictionary[BulletWorld, dict[tuple[str, str], Modules]] = weakref.WeakKeyDictionary()


class NoProcessModule(UsageError):
    """No process module takes a designator.

    Attributes:
        cmd: The solution's ``cmd``.
        robot: Name of the robot.
        environment: The execution environment.
        known: The ``cmd`` of each of its modules.
        undescribed: Why the robot has no description, without which it has no modules of PyCRAM's; "" if it has one.
    """

    def __init__(self, cmd: str, robot: str, environment: str, known: list[str], undescribed: str = "") -> None:
        super().__init__(
            f"no process module of {robot} in the {environment} environment takes {cmd!r}; "
            f"it has modules for {', '.join(known) or 'nothing'}; {undescribed}"
            "add one with register() or ProcessModule.resolvers"
        )
        self.cmd = cmd
        self.robot = robot
        self.environment = environment
        self.known = known
        self.undescribed = undescribed


export("pycram.process_module", NoProcessModule)


@contextmanager
def execution_environment(name: str) -> Iterator[None]:
    """Use the process modules of an environment in the ``with`` block.

    Args:
        name: "simulated" (the default), "continuous", or an environment that modules are registered for.

    Raises:
        BadArgument: It isn't a name.
    """
    with Binding(_environment, checks.text("name", name)):
        yield


def set_default(name: str) -> None:
    """Use the process modules of an environment wherever the plan names none, in all threads of this process."""
    global _of_run  # noqa: PLW0603  of the run, which is the process's
    _of_run = name or SIMULATED


def register(robot: str, environment: str, modules: Modules) -> None:
    """Register the process modules of a robot in an environment, in place of those registered before.

    Args:
        robot: The robot's name in its URDF.
        environment: The execution environment.
        modules: By the ``cmd`` of the solutions that they take.

    Raises:
        BadArgument: They aren't process modules.
    """
    if not isinstance(modules, Mapping) or not all(_serves(cmd, module) for cmd, module in modules.items()):
        raise BadArgument("modules", modules, "process modules by cmd, such as {'looking': Looking()}")
    with _lock:
        _registered[checks.text("robot", robot), checks.text("environment", environment)] = dict(modules)


def _serves(cmd: object, module: object) -> bool:
    """Whether this is a process module for a ``cmd``; a class of modules has the same methods, and is none."""
    return isinstance(cmd, str) and isinstance(module, Module) and not isinstance(module, type)


def register_default(environment: str, modules: Callable[[], Modules]) -> None:
    """Register the process modules, in an environment, of each robot that has a description and no modules of its own.

    Args:
        environment: The execution environment.
        modules: Makes a new set, by the ``cmd`` of the solutions that they take; called once for each robot.
    """
    with _lock:
        _defaults[environment] = modules


@dataclass(frozen=True, slots=True)
class Chosen:
    """A process module, and why it is that one.

    Attributes:
        module: the module.
        environment: the execution environment.
        chooser: qualified name of the function that chose it; "" if it is a registered one.
        registered_for: name of the robot that it was registered for; "" if the environment has it for any robot.
    """

    module: Module
    environment: str
    chooser: str = ""
    registered_for: str = ""


def current_environment() -> str:
    """Return the name of the current execution environment."""
    return _environment.get() or _of_run


def module_for(cmd: str, world: BulletWorld) -> Chosen:
    """Return the module for a ``cmd`` of a world's robot in the current environment.

    Raises:
        NoProcessModule: There is none.
        NoWorld: The world has no robot.
    """
    if world.robot is None:
        raise NoWorld("robot")
    modules, registered_for = _modules_of(world, world.robot)
    if cmd not in modules:
        why = "" if world.robot.description else _undescribed(world.robot)
        raise NoProcessModule(cmd, world.robot.urdf.name, current_environment(), sorted(modules), why)
    return Chosen(modules[cmd], current_environment(), registered_for=registered_for)


def _undescribed(robot: Object) -> str:
    """Return why a robot has no description, and what to do."""
    misfit = why_none(robot.urdf)
    but = f" (PyCRAM's own description of {robot.urdf.name} doesn't fit it: {misfit})" if misfit else ""
    return f"it has no description{but}: pycram describe writes one for Object(..., description=...); else "


def _modules_of(world: BulletWorld, robot: Object) -> tuple[Modules, str]:
    """Return the modules of a robot, and its name if they were registered for it."""
    environment = current_environment()
    with _lock:
        registered = _registered.get((robot.urdf.name, environment))
        if registered is not None:
            return registered, robot.urdf.name
        make = _defaults.get(environment)
        if make is None or robot.description is None:
            return {}, ""
        sets = _of_world.setdefault(world, {})
        key = robot.name, environment
        if key not in sets:
            sets[key] = make()
        return sets[key], ""
