"""Process modules carry motions out, each on one robot, in one execution environment (thesis 4.7-4.9).

``ProcessModule.perform(designator)`` makes a :class:`Motion` of the designator. It queues for resources, is resolved,
and is carried out by the module that serves the robot in the current execution environment. The plan names neither
robot nor module, so the same plan runs in simulation and, with other modules, on a real robot.
"""

from __future__ import annotations

import threading
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol, TypeAlias, runtime_checkable

from pycram.foundation import checks
from pycram.foundation.failures import (
    BadArgument,
    Displaced,
    NoWorld,
    PlanFailure,
    TrackingLost,
    TrajectoryEnded,
    UsageError,
)
from pycram.foundation.names import export, qualified_name
from pycram.foundation.refusals import refusing
from pycram.language.block import current_block
from pycram.language.branch import run
from pycram.models.robots.description import why_none
from pycram.motions.designator import Designator, DesignatorError, Resolvers, performing, unfinished
from pycram.motions.execution import INSTANT
from pycram.motions.resources import ResourceQueue, Resources, Ticket, forget_tickets
from pycram.scheduling.cancellation import Binding, checkpoint, uninterruptible
from pycram.world import attachment
from pycram.world.world import BulletWorld
from recorder.records import Decision
from recorder.tracing.span import Span, span

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

    from pycram.models.robots.description import Arm, RobotDescription
    from pycram.motions.execution import Execution
    from pycram.world.object import Object


@runtime_checkable
class Module(Protocol):
    """A process module, as environments and motions use it."""

    def resources(self, designator: Designator) -> Resources | None:
        """Return what carrying a designator out needs of the robot."""

    def execute(self, designator: Designator) -> Any:
        """Carry a designator out."""


Modules: TypeAlias = Mapping[str, Module]
Result: TypeAlias = Any
Chooser: TypeAlias = Callable[[Designator], "ProcessModule | None"]

AS_ASKED: Final = "as asked"
"""The only candidate, where a plan leaves nothing to choose."""

FOLLOWING: Final = (TrackingLost, Displaced, TrajectoryEnded)
"""Failures of whatever follows a trajectory."""

SIMULATED = "simulated"
"""The environment in which motions are done at once."""
CONTINUOUS = "continuous"
"""The environment in which they take simulated time."""

_environment: ContextVar[str] = ContextVar("pycram_environment", default="")
_of_run = SIMULATED  # where the plan names none, in any thread
_modules_lock = threading.Lock()
_registered: dict[tuple[str, str], Modules] = {}
_defaults: dict[str, Callable[[], Modules]] = {}
_of_world: weakref.WeakKeyDictionary[BulletWorld, dict[tuple[str, str], Modules]] = weakref.WeakKeyDictionary()

_queues: weakref.WeakKeyDictionary[BulletWorld, ResourceQueue] = weakref.WeakKeyDictionary()
_queues_lock = threading.Lock()
#: For the motions that one is made of: the queues for what is held of the robots of worlds, by world.
_parts: ContextVar[Mapping[BulletWorld, ResourceQueue]] = ContextVar("pycram_parts", default=MappingProxyType({}))
#: The designator that is carried out in this context, and how that was decided.
_decided: ContextVar[tuple[Designator | None, Decision | None]] = ContextVar("pycram_decided", default=(None, None))

_ONE_AT_A_TIME = Resources(moves=frozenset({"module"}))
_TOGETHER = Resources()

#: Queues of the modules that a running module performs motions with; concurrent modules have separate ones.
_inner_queues: ContextVar[dict[ProcessModule, ResourceQueue] | None] = ContextVar("pycram_modules", default=None)


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
    with _modules_lock:
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
    with _modules_lock:
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
    with _modules_lock:
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


class Motion:
    """A designator to be carried out in a world.

    Args:
        choose: Returns the process module of a designator that can be resolved.

    Attributes:
        name: The designator's type.
        span: Its node of the task tree.
    """

    def __init__(self, designator: Designator, world: BulletWorld, choose: Callable[[Designator], Chosen]) -> None:
        self.name = str(dict(designator.description).get("type", type(designator).__name__))
        slots = {key: value for key, value in designator.description if key != "type"}
        self._designator = designator
        self._choose = choose
        self._world = world
        with performing(designator):
            resources = designator.resources()
        self._ticket = Ticket(_parts.get().get(world) or _queue_of(world), resources, self.name)
        self.span = Span("motion", self.name, parameters=slots)

    def enqueue(self) -> None:
        """Take its place in the queue for resources."""
        self._ticket.enqueue()

    def leave(self) -> None:
        """Give its place up, if it has one."""
        self._ticket.leave()

    def carry_out(self) -> Any:
        """Wait for its turn, resolve it, run its process module within the span, and return the module's result."""
        try:
            self._await_slots()
            with self._ticket.turn():
                checkpoint()
                with performing(self._designator):
                    module = self._resolve()
                    with self._holding(), Binding(_decided, (self._designator, self.span.decision)):
                        return module.execute(self._designator)
        finally:
            self.leave()

    def _await_slots(self) -> None:
        """Wait for futures among its slots while it holds no resources: their branches may need some."""
        for branch in self._designator.branches():
            branch.result()

    def _resolve(self) -> Module:
        """Find solution and process module, and request the resources that these need."""
        with self._holding():  # resolvers may perform motions
            self.span.decision = decision = Decision(environment=current_environment())
            try:
                self.span.solution = self._designator.reference()
                chosen = self._choose(self._designator)
            finally:
                found = self._designator.resolution()
                decision.resolver, decision.solution = found.resolver, found.index
                decision.known, decision.complete = found.known, found.complete
            module = chosen.module
            decision.module, decision.chooser = qualified_name(type(module)), chosen.chooser
            decision.registered_for = chosen.registered_for
            resources = module.resources(self._designator)
        self._ticket.correct(resources)
        return module

    def _holding(self) -> Binding[Mapping[BulletWorld, ResourceQueue]]:
        """Make motions performed in this world in the ``with`` block parts of this one, within its resources."""
        return Binding(_parts, {**_parts.get(), self._world: ResourceQueue(self._ticket.resources)})


def decision_of(designator: Designator) -> Decision | None:
    """Return how the motion was decided that carries a designator out in this context; None if none does."""
    carried_out, decision = _decided.get()
    return decision if carried_out is designator else None


def forget_motions() -> None:
    """Forget all motions that run or wait, in a forked child; what this context does is part of none."""
    _queues.clear()
    _parts.set(MappingProxyType({}))
    forget_tickets()


def _queue_of(world: BulletWorld) -> ResourceQueue:
    with _queues_lock:
        return _queues.setdefault(world, ResourceQueue())


class ProcessModule(ABC):
    """Carries out one kind of motion, one designator at a time, in order of arrival.

    Motions that it performs are parts of that motion, within its resources.

    Attributes:
        one_at_a_time: False for one that keeps nothing of a designator: two arms may move by the same module.
    """

    one_at_a_time = True

    failures: ClassVar[tuple[type[PlanFailure], ...]] = ()
    """What it may raise, in any environment; of PyCRAM's modules the reference lists them."""

    failures_in_time: ClassVar[tuple[type[PlanFailure], ...]] = ()
    """What else it may raise where motions take simulated time."""

    resolvers: ClassVar[Resolvers[Chooser]] = Resolvers("process modules")
    """Functions that return a module for a designator, or None; called before the registered modules are looked up.

    Like resolvers, they are called when the motion's turn has come; motions that they perform are part of it."""

    _queue: ResourceQueue

    def __new__(cls, *_: object, **__: object) -> Self:
        """Make one; not in ``__init__``, which subclasses may have without calling this class's."""
        made = super().__new__(cls)
        made._queue = ResourceQueue()
        return made

    @abstractmethod
    def _execute(self, designator: Designator) -> Result:
        """Carry a designator out, with the parameters of its ``reference()``; return what the plan gets.

        Raises:
            PlanFailure: The world said no; the world is consistent then.
        """

    def resources(self, designator: Designator) -> Resources | None:
        """Return what carrying a designator out needs of the robot; None for the whole robot.

        Called when it is resolved, before anything moves. The resources of PyCRAM's own motions are known by the
        solution's ``cmd``. A module for another ``cmd`` gets the whole robot, unless it returns here what it needs, for
        itself and for all motions that it performs::

            def resources(self, designator):
                return Resources(moves={"left-arm"}, at_rest={"base"})
        """
        return designator.resources()

    def execute(self, designator: Designator) -> Result:
        """Carry a designator out, after all earlier ones if need be; a failure frees the module for the next."""
        inner = _inner_queues.get()
        queue = self._queue if inner is None else inner.setdefault(self, ResourceQueue())
        turn = Ticket(queue, _ONE_AT_A_TIME if self.one_at_a_time else _TOGETHER).turn()
        with turn, Binding(_inner_queues, {}), performing(designator):
            checkpoint()
            solution: Mapping[str, object] = designator.reference()
            task = span("process-module", type(self).__name__, solution)
            task.decision = decision_of(designator)
            with task, uninterruptible():
                task.solution = solution
                task.result = result = run(self._execute, designator)
                return result

    @staticmethod
    def perform(designator: Designator) -> Result:
        """Perform a motion (thesis 4.9); return its process module's result.

        In the body of a block whose branches are concurrent, or are tried in order, return a future of that.

        Raises:
            DesignatorError: It isn't a designator, or can't be resolved.
            NoProcessModule: No process module takes it.
            PlanFailure: The world said no.
        """
        motion = _motion(designator)
        block = current_block()
        if block is None:
            with motion.span:
                motion.span.result = result = motion.carry_out()
                return result
        # queued already here if it can wait only for earlier motions
        ordered = block.immediate and not unfinished(designator)
        try:
            if ordered:
                motion.enqueue()
            return block.start(motion.name, motion.carry_out, ordered=ordered, dropped=motion.leave, span=motion.span)
        except BaseException:
            motion.leave()
            raise


def forget_claims() -> None:
    """Claim nothing of any robot or module any more: in a forked child, no motion but this branch's goes on."""
    forget_motions()
    _inner_queues.set({})


@refusing(name="perform")
def _motion(designator: Designator) -> Motion:
    if not isinstance(designator, Designator):
        raise DesignatorError(f"perform takes a designator, not {designator!r}", value=designator)
    if designator.performed_by:
        kind = type(designator).__name__
        problem = f"a {kind} is performed by {designator.performed_by}, not by ProcessModule.perform"
        raise DesignatorError(problem, value=designator)
    return Motion(designator, _world(), choose)


def choose(designator: Designator) -> Chosen:
    """Return the process module for a designator that can be resolved (thesis 4.8).

    Raises:
        NoProcessModule: There is none.
        NoWorld: The current world has no robot.
        BadArgument: A user's function returned something else.
    """
    for chooser in ProcessModule.resolvers:
        module = chooser(designator)
        if module is not None and not isinstance(module, ProcessModule):
            raise BadArgument(f"what {qualified_name(chooser)} chose", module, "a process module, or None")
        if module is not None:
            return Chosen(module, current_environment(), chooser=qualified_name(chooser))
    return module_for(str(designator.reference().get("cmd", "")), _world())


def _world() -> BulletWorld:
    world = BulletWorld.current_bullet_world
    if world is None:
        raise NoWorld
    return world


class NoDescription(UsageError):
    """The robot has no description, so that process modules can't know its arms.

    Attributes:
        robot: its name.
    """

    def __init__(self, robot: str) -> None:
        super().__init__(f"nothing is known of the robot {robot}; give Object(..., description=...) its TOML file")
        self.robot = robot


export("pycram.process_module", NoDescription)


class SimulatedModule(ProcessModule):
    """A process module that works on the current world's robot.

    Args:
        execution: how what it decides is done; at once by default.
    """

    execution: Execution = INSTANT

    def __init__(self, execution: Execution = INSTANT) -> None:
        self.execution = execution
        self.one_at_a_time = not execution.takes_time

    @staticmethod
    def robot() -> Object:
        """Return the robot.

        Raises:
            NoWorld: there is none.
        """
        return BulletWorld.current_robot()

    @staticmethod
    def held(robot: Object, arm: Arm) -> Object | None:
        """Return what a robot holds with the gripper of an arm; None if nothing."""
        return attachment.attached_to(robot, arm.tool_frame)

    @staticmethod
    def description(robot: Object) -> RobotDescription:
        """Return a robot's description.

        Raises:
            NoDescription: it has none.
        """
        if robot.description is None:
            raise NoDescription(robot.name)
        return robot.description
