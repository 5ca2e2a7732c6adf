"""High-level robot plans that run in a simulated world; everything that happens is recorded."""

# General layout, from the bottom up; each room imports only rooms above it in this list:
#
# foundation/  failures, checks of arguments, names. Imports nothing of pycram.
# scheduling/  branches of a plan as greenlets that take turns: cancellation, futures, locks.
# physics/     the only room that knows PyBullet.     models/  from a model's file to a checked URDF; robots as data.
# world/       worlds and objects. Every change is a world transaction: validate, act, read back, record, fire events.
# vision/      what a camera sees.     language/  par, seq, pursue, try_all, retries, timeouts, cleanup.
# reasoning/   queries that leave no trace: collision, kinematics, grasping, visibility, stability.
# planning/    paths without collision, and their times.
# motions/     motion designators, their resolvers, the resources they move, and the process modules that execute them.
# fluents/     values that branches wait for and react to, also those that follow a world.
# describing/  first descriptions of robots and furniture.
# projection/  plans tried in a copy of the process.     actions/  goals of a robot; choices of how to reach them.
# exploration/ plans run in many orders of their branches.     sweeping/  with many seeds and parameters.
#
# bullet_world, bullet_world_reasoning, designator, process_module, fluent, event, failures, tasks: the names of the
# thesis, from which plans import. motion_designators, action_designators: typed constructors, written by constructors.
# knowledge: a robot's beliefs. plan_parameters: named values that runs set. monitoring: watched properties. running,
# cli: the command "pycram".

from importlib import import_module
from typing import TYPE_CHECKING, Any

import recorder  # noqa: F401  before numpy: it limits threads

if TYPE_CHECKING:
    from pycram.actions import perform
    from pycram.monitoring import monitored
    from pycram.plan_parameters import UnknownParameter, parameters
    from pycram.running import seed
    from pycram.sweeping import sweep

#: Modules of the names that plans use as ``pycram.NAME``; they are imported on demand, so that commands start fast.
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
