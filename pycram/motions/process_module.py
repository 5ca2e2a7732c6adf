"""Process modules execute motions: each module serves one robot in one execution environment (thesis 4.7-4.9).

``ProcessModule.perform(designator)`` makes a :class:`Motion`. A motion waits for its resources, resolves the
designator, and runs the module for the robot in the current execution environment. The plan names neither robot nor
module, so the same plan runs in simulation and, with other modules, on a real robot.
"""

from __future__ import annotations

import threading
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Final, Protocol, Self, TypeAlias, runtime_checkable

from pycram.foundation import checks, plugins
from pycram.foundation.errors import export, qualified_name
from pycram.foundation.failures import (
    BadArgument,
    Displaced,
    NoWorld,
    PlanFailure,
    TrackingLost,
    TrajectoryEnded,
    UsageError,
)
from pycram.foundation.refusals import refusing
from pycram.language.branch import current_block, run
from pycram.models.robots.description import Arm, RobotDescription, find_description
from pycram.motions.designator import Designator, DesignatorError, Resolvers, Solution, performing, unfinished
from pycram.motions.execution import INSTANT, LEVEL, Execution
from pycram.motions.resources import ResourceQueue, Resources, Ticket, forget_tickets
from pycram.scheduling.cancellation import Binding, checkpoint, uninterruptible
from pycram.world import attachment
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder.packages import require
from recorder.records import Decision
from recorder.tracing.span import Span, span


@runtime_checkable
class Module(Protocol):
    """The methods of a process module that environments and motions call."""

    def resources(self, designator: Any) -> Resources | None:
        """Return the resources that a designator needs."""

    def execute(self, designator: Designator) -> Any:
        """Execute a designator."""


Modules: TypeAlias = Mapping[str, Module]
Result: TypeAlias = Any
Chooser: TypeAlias = Callable[[Designator], "ProcessModule | None"]

AS_ASKED: Final = "as asked"  # the only candidate of a choice if the plan leaves nothing open

FOLLOWING: Final = (TrackingLost, Displaced, TrajectoryEnded)  # types of failures of motions that follow a trajectory

SIMULATED: Final = "simulated"  # the execution environment in which motions are instantaneous
CONTINUOUS: Final = "continuous"  # the execution environment in which motions take simulated time

_ONE_AT_A_TIME: Final = Resources(moves=frozenset({"module"}))
_TOGETHER: Final = Resources()

_environment: ContextVar[str] = ContextVar("pycram_environment", default="")
_of_run = SIMULATED  # the environment of plans that don't name an environment, in all threads
_modules_lock = threading.Lock()
#: Registered modules by robot and environment, and whether these modules replace the default modules.
_registered: dict[tuple[str, str], tuple[Modules, bool]] = {}
_defaults: dict[str, Callable[[], Modules]] = {}
_of_world: weakref.WeakKeyDictionary[BulletWorld, dict[tuple[str, str], Modules]] = weakref.WeakKeyDictionary()

_queues: weakref.WeakKeyDictionary[BulletWorld, ResourceQueue] = weakref.WeakKeyDictionary()
_queues_lock = threading.Lock()
#: In a motion: by world, the queues in which parts of the motion wait for its resources.
_parts: ContextVar[Mapping[BulletWorld, ResourceQueue]] = ContextVar("pycram_parts", default=MappingProxyType({}))
#: In a motion: the queues of the modules of its inner motions. Modules that run concurrently have separate queues.
_inner_queues: ContextVar[dict[ProcessModule, ResourceQueue] | None] = ContextVar("pycram_modules", default=None)
#: The designator that this branch executes, with the records of its resolution and of the choice of its module.
_decided: ContextVar[tuple[Designator | None, Decision | None]] = ContextVar("pycram_decided", default=(None, None))


class NoProcessModule(UsageError):
    """No process module can execute a designator."""

    def __init__(self, cmd: str, robot: str, environment: str, known: list[str], undescribed: str = "") -> None:
        super().__init__(
            f"no process module of {robot} in the {environment} environment takes {cmd!r}; "
            f"modules exist for {', '.join(known) or 'nothing'}; {undescribed}"
            "add a module with register() or ProcessModule.resolvers"
        )
        self.cmd = cmd  # ``cmd`` of the solution
        self.robot = robot  # name of the robot
        self.environment = environment
        self.known = known  # the ``cmd`` of each module in the environment
        self.undescribed = undescribed  # why the robot has no description; "" if it has a description


class NoDescription(UsageError):
    """The robot has no description, but process modules need the names of its arms."""

    def __init__(self, robot: str) -> None:
        super().__init__(f"the robot {robot} has no description; give Object(..., description=...) its TOML file")
        self.robot = robot


export("pycram.process_module", NoProcessModule, NoDescription)


@contextmanager
def execution_environment(name: str, *, level: bool = False) -> Iterator[None]:
    """Use the process modules of an environment in the ``with`` block.

    Args:
        name: "simulated" (the default), "continuous", or an environment for which modules are registered.
        level: Whether motions keep the objects in the robot's hands upright, within 15 degrees.

    Raises:
        BadArgument: The argument isn't a name.
        NotInstalled: "continuous" needs packages that plan motions, and these aren't installed.
    """
    _require(checks.text("name", name))
    with Binding(_environment, name), Binding(LEVEL, level):
        yield


def current_environment() -> str:
    """Return the name of the current execution environment."""
    return _environment.get() or _of_run


def set_default(name: str) -> None:
    """Set the environment of plans that don't name an environment, in all threads of this process."""
    global _of_run  # noqa: PLW0603  a process has one run
    _require(name)
    _of_run = name or SIMULATED


def _require(environment: str) -> None:
    if environment == CONTINUOUS:
        require("ompl", "toppra")


def register(robot: str, environment: str, modules: Modules, *, replace: bool = False) -> None:
    """Register process modules of a robot in an environment. A module replaces an earlier module with the same ``cmd``.

    Args:
        robot: Name of the robot in its URDF.
        environment: Name of the execution environment.
        modules: Process modules by the ``cmd`` of the solutions that they execute.
        replace: Whether to remove all other modules of the robot in the environment, also PyCRAM's modules.
    """
    if not isinstance(modules, Mapping) or not all(
        isinstance(cmd, str) and isinstance(module, Module) and not isinstance(module, type)
        for cmd, module in modules.items()
    ):
        raise BadArgument("modules", modules, "process modules by cmd, such as {'looking': Looking()}")
    with _modules_lock:
        key = checks.text("robot", robot), checks.text("environment", environment)
        before, alone = _registered.get(key, ({}, False))
        _registered[key] = (dict(modules), True) if replace else ({**before, **modules}, alone)


def register_default(environment: str, modules: Callable[[], Modules]) -> None:
    """Register process modules for all robots that have a description, in an environment.

    Args:
        environment: Name of the execution environment.
        modules: Called once for each robot; returns new process modules by the ``cmd`` of the solutions that they take.
    """
    with _modules_lock:
        _defaults[environment] = modules


@dataclass(frozen=True, slots=True)
class Chosen:
    """A process module, and the reason for its choice."""

    module: Module
    environment: str
    chooser: str = ""  # qualified name of the function that chose the module; "" for a registered module
    registered_for: str = ""  # name of the robot for which the module is registered; "" for a default module


def choose(designator: Designator, solution: Solution) -> Chosen:
    """Return the process module for a designator and its solution (thesis 4.8).

    Raises:
        NoProcessModule: No module takes the solution.
        NoWorld: There is no current world, or the world has no robot.
        BadArgument: A user's function returned an object that isn't a process module.
    """
    environment = current_environment()
    for chooser in ProcessModule.resolvers:
        module = chooser(designator)
        if module is not None and not isinstance(module, ProcessModule):
            raise BadArgument(f"result of {qualified_name(chooser)}", module, "a process module, or None")
        if module is not None:
            return Chosen(module, environment, chooser=qualified_name(chooser))
    world, cmd = _current_world(), str(solution.get("cmd", ""))
    robot = world.robot
    if robot is None:
        raise NoWorld("robot")
    with _modules_lock:
        registered, alone = _registered.get((robot.urdf.name, environment), ({}, False))
        make = _defaults.get(environment)
        defaults: Modules = {}
        if not alone and make is not None and robot.description is not None:
            sets = _of_world.setdefault(world, {})
            key = robot.name, environment
            if key not in sets:
                sets[key] = make()
            defaults = sets[key]
    modules = {**defaults, **registered}
    if cmd not in modules and (plugin := plugins.load(plugins.PROCESS_MODULES, cmd)) is not None:
        register(robot.urdf.name, environment, {cmd: plugin()})
        return choose(designator, solution)
    if cmd not in modules:
        raise NoProcessModule(cmd, robot.urdf.name, environment, sorted(modules), _undescribed(robot))
    return Chosen(modules[cmd], environment, registered_for=robot.urdf.name if cmd in registered else "")


def _current_world() -> BulletWorld:
    world = BulletWorld.current_bullet_world
    if world is None:
        raise NoWorld
    return world


def _undescribed(robot: Object) -> str:
    """Return why a robot has no description, and the remedy; "" if it has one."""
    if robot.description:
        return ""
    _, misfits = find_description(robot.urdf)
    misfit = next(iter(misfits.values()), "")
    but = f" (PyCRAM's description of {robot.urdf.name} doesn't match the URDF: {misfit})" if misfit else ""
    return f"the robot has no description{but}: `pycram describe` writes one for Object(..., description=...); or "


class Motion:
    """A motion from its request to its end: it queues for resources, is resolved, and is executed in a world.

    The parts of a motion wait among themselves for the resources of that motion. Two such motions therefore never wait
    for each other. If a motion performs a motion in another world, the inner motion uses the queue of that world.
    """

    def __init__(self, designator: Designator, world: BulletWorld) -> None:
        self.name = str(dict(designator.description).get("type", type(designator).__name__))
        slots = {key: value for key, value in designator.description if key != "type"}
        self._designator = designator
        self._world = world
        with performing(designator):
            resources = designator.resources()
        with _queues_lock:
            queue = _parts.get().get(world) or _queues.setdefault(world, ResourceQueue())
        self.ticket = Ticket(queue, resources, self.name)
        self.span = Span("motion", self.name, parameters=slots)

    def carry_out(self) -> Any:
        """Wait for the motion's turn, resolve the designator, run the process module, and return its result."""
        try:
            for branch in self._designator.branches():  # the branches may need resources that the motion will hold
                branch.result()
            with self.ticket.turn():
                checkpoint()
                with performing(self._designator):
                    module = self._resolve()
                    with self._holding(), Binding(_decided, (self._designator, self.span.decision)):
                        return module.execute(self._designator)
        finally:
            self.ticket.leave()

    def _resolve(self) -> Module:
        """Find the solution and the process module, and request the resources that they need."""
        with self._holding():  # resolvers may perform motions
            self.span.decision = decision = Decision(environment=current_environment())
            try:
                self.span.solution = solution = self._designator.reference()
                chosen = choose(self._designator, solution)
            finally:
                found = self._designator.resolution()
                decision.resolver, decision.solution = found.resolver, found.index
                decision.known, decision.complete = found.known, found.complete
            module = chosen.module
            decision.module, decision.chooser = qualified_name(type(module)), chosen.chooser
            decision.registered_for = chosen.registered_for
            resources = module.resources(self._designator)
        self.ticket.correct(resources)
        return module

    def _holding(self) -> Binding[Mapping[BulletWorld, ResourceQueue]]:
        """Make motions that the ``with`` block performs in this world parts of this motion; they use its resources."""
        return Binding(_parts, {**_parts.get(), self._world: ResourceQueue(self.ticket.resources)})


@refusing(name="perform")
def _motion(designator: Designator) -> Motion:
    if not isinstance(designator, Designator):
        raise DesignatorError(f"perform takes a designator, not {designator!r}", value=designator)
    if designator.performed_by:
        kind = type(designator).__name__
        problem = f"a {kind} is performed by {designator.performed_by}, not by ProcessModule.perform"
        raise DesignatorError(problem, value=designator)
    return Motion(designator, _current_world())


def forget_claims() -> None:
    """Forget all running and waiting motions; a forked child process continues only this branch, without resources."""
    _queues.clear()
    _parts.set(MappingProxyType({}))
    forget_tickets()
    _inner_queues.set({})


class ProcessModule(ABC):
    """Executes one kind of motion; designators are executed one by one in order of arrival.

    Motions that a module performs are parts of its motion, and use the resources of that motion.
    """

    one_at_a_time = True  # false for a module without state, so that two arms can use the module at the same time

    failures: ClassVar[tuple[type[PlanFailure], ...]] = ()
    """Failures that the module may raise in any environment; docs/reference/designators.md lists PyCRAM's failures."""

    failures_in_time: ClassVar[tuple[type[PlanFailure], ...]] = ()
    """Types of failures that the module may raise if motions take simulated time."""

    resolvers: ClassVar[Resolvers[Chooser]] = Resolvers("process modules")
    """Functions that return a module for a designator, or None; they precede registered modules."""

    _queue: ResourceQueue

    def __new__(cls, *_: object, **__: object) -> Self:
        """Make a process module; not in ``__init__``, as subclasses may omit ``super().__init__()``."""
        made = super().__new__(cls)
        made._queue = ResourceQueue()
        return made

    @abstractmethod
    def _execute(self, designator: Any) -> Result:  # a subclass may name the class of its designators
        """Execute a designator with the parameters of its ``reference()``; return the result for the plan.

        Raises:
            PlanFailure: The world prevents the motion.
        """

    def resources(self, designator: Any) -> Resources | None:
        """Return the resources that a designator needs; None for the whole robot.

        The designator is resolved at this time, and nothing has moved. The ``cmd`` determines the resources of PyCRAM's
        motions. A module for another ``cmd`` gets the whole robot, unless the module's own method returns the resources
        of the motion and all its parts::

            def resources(self, designator):
                return Resources(moves={"left-arm"}, at_rest={"base"})
        """
        needs: Resources | None = designator.resources()
        return needs

    def execute(self, designator: Designator) -> Result:
        """Execute a designator, after earlier designators; a failure frees the module."""
        inner = _inner_queues.get()
        queue = self._queue if inner is None else inner.setdefault(self, ResourceQueue())
        turn = Ticket(queue, _ONE_AT_A_TIME if self.one_at_a_time else _TOGETHER).turn()
        with turn, Binding(_inner_queues, {}), performing(designator):
            checkpoint()
            solution: Mapping[str, object] = designator.reference()
            task = span("process-module", type(self).__name__, solution)
            carried_out, decision = _decided.get()
            task.decision = decision if carried_out is designator else None
            with task, uninterruptible():
                task.solution = solution
                task.result = result = run(self._execute, designator)
                return result

    @staticmethod
    def perform(designator: Designator) -> Result:
        """Perform a motion (thesis 4.9); return the result of its process module.

        In the body of a concurrent block or of ``try_in_order``, return a future of the result.

        Raises:
            DesignatorError: The argument isn't a designator, or can't be resolved.
            NoProcessModule: No process module can execute the designator.
            PlanFailure: The world prevents the motion.
        """
        motion = _motion(designator)
        block = current_block()
        if block is None:
            with motion.span:
                motion.span.result = result = motion.carry_out()
                return result
        # enqueue the motion now if it can wait only for earlier motions
        ordered = block.immediate and not unfinished(designator)
        leave = motion.ticket.leave
        with ExitStack() as after_failure:
            after_failure.callback(leave)
            if ordered:
                motion.ticket.enqueue()
            future = block.start(motion.name, motion.carry_out, ordered=ordered, dropped=leave, span=motion.span)
            after_failure.pop_all()
        return future


class SimulatedModule(ProcessModule):
    """A process module for the current world's robot; ``execution`` moves the robot, by default instantaneously."""

    def __init__(self, execution: Execution = INSTANT) -> None:
        self.execution = execution
        self.one_at_a_time = not execution.takes_time

    @staticmethod
    def held(robot: Object, arm: Arm) -> Object | None:
        """Return the object in the gripper of an arm; None if the gripper is empty."""
        return attachment.attached_to(robot, arm.tool_frame)

    @staticmethod
    def description(robot: Object) -> RobotDescription:
        """Return the description of a robot; raise NoDescription without a description."""
        if robot.description is None:
            raise NoDescription(robot.name)
        return robot.description
