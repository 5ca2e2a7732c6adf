"""Fluents that follow a world: poses, joints, held objects and contacts.

Each world transaction updates all fluents of the world at the same moment, with the world's lock held, and their
records follow the change's record. No user code is called then; waiting threads are only notified. During a simulation
the values are read 30 times a simulated second, and assigned in order when the simulation has ended.

If an object was removed or a world has ended, its fluents raise :class:`~pycram.failures.WorldClosed` when they are
read or awaited. A world that no fluent follows has no extra cost.

Values are plain: tuples in m and xyzw, floats in rad or m, names. They are assigned only when they have changed::

    height = network(itemgetter(2), position(milk))
    (height < 0.5).OR(holding(robot, "left") == "milk").wait_for()
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

from pycram.fluents.expressions import Ended, Variable, assign, end
from pycram.fluents.fluent import Derived
from pycram.foundation.failures import BadArgument
from pycram.foundation.refusals import refusing
from pycram.motions.process_module import CONTINUOUS, current_environment
from pycram.reasoning.queries.contact import touches
from pycram.reasoning.queries.query import world_of
from pycram.scheduling.future import unwrap
from pycram.world.simulation import WorldClock

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.fluents.expressions import Value
    from pycram.fluents.fluent import Fluent
    from pycram.world.object import Object
    from pycram.world.transaction import Transaction
    from pycram.world.world import BulletWorld

__all__ = ["contact", "holding", "joint", "pose", "position"]


@refusing(name="fluents.pose")
def pose(body: Object, link: str | None = None) -> Fluent:
    """Follow the pose of an object's base link, or of another link: ((x, y, z), (x, y, z, w)) in the world frame.

    Raises:
        BadArgument: ``body`` isn't an object.
        UnknownName: There is no such link.
        WorldClosed: The object or its world is gone.
    """
    owner, name = _link(body, link)
    return _follow("pose", name, lambda: _pose(owner, link), owner)


@refusing(name="fluents.position")
def position(body: Object, link: str | None = None) -> Fluent:
    """Follow the position of an object's base link, or of another link: (x, y, z) in m in the world frame.

    Raises:
        BadArgument: ``body`` isn't an object.
        UnknownName: There is no such link.
        WorldClosed: The object or its world is gone.
    """
    owner, name = _link(body, link)
    return _follow("position", name, lambda: _pose(owner, link)[0], owner)


@refusing(name="fluents.joint")
def joint(body: Object, name: str) -> Fluent:
    """Follow the position of an object's joint, in rad or m.

    Raises:
        BadArgument: ``body`` isn't an object.
        UnknownName: There is no such movable joint.
        WorldClosed: The object or its world is gone.
    """
    owner = _object(body)
    owner.check_joint(name)
    return _follow("joint", f"{name} of {owner.name}", lambda: owner.get_joint_position(name), owner)


@refusing(name="fluents.holding")
def holding(robot: Object, arm: str | None = None) -> Fluent:
    """Follow the object that a robot holds: its name, None if there is none; the first of several.

    Args:
        robot: A robot, or any other object that carries objects.
        arm: Name of one of its arms; all links by default.

    Raises:
        BadArgument: ``robot`` isn't an object, or has no arms.
        UnknownName: There is no such arm.
        WorldClosed: The object or its world is gone.
    """
    carrier = _object(robot)
    links: frozenset[str] | None = None
    if arm is not None:
        if carrier.description is None:
            raise BadArgument("robot", carrier, "a robot with arms")
        described = carrier.description.arm(arm)
        links = frozenset(described.links()) - {described.base_link}

    def held() -> str | None:
        return next((each.body.name for each in carrier.carried if links is None or each.carrier_link in links), None)

    return _follow("holding", carrier.name if arm is None else f"{arm} arm of {carrier.name}", held, carrier)


@refusing(name="fluents.contact")
def contact(object1: Object, object2: Object) -> Fluent:
    """Follow whether two objects of the same world touch: True or None.

    Raises:
        BadArgument: One of the two isn't an object, or they are in different worlds.
        WorldClosed: One of the two, or the world, is gone.
    """
    a, b = _object(object1), _object(object2)
    return _follow("contact", f"{a.name} and {b.name}", lambda: True if touches(a, b) else None, a, b)


class _WorldVariable(Variable):
    """A variable that follows a world."""

    __slots__ = ("objects", "read")

    def __init__(self, source: str, name: str, read: Callable[[], Value], objects: tuple[Object, ...]) -> None:
        super().__init__(read(), f"{source} of {name}", source, tuple(body.name for body in objects))
        self.read = read  # returns the present value; called with the world's lock held, while the objects exist
        self.objects = objects

    def clock(self) -> WorldClock | None:
        """Return the world's time, if motions take time."""
        return WorldClock(self.objects[0].world, last=False) if current_environment() == CONTINUOUS else None

    def gone(self) -> str:
        """Return the object that has been removed; "" for none."""
        return next((f"object {body.name}" for body in self.objects if not body.alive), "")


class WorldVariables:
    """The variables that follow one world; the observer of its transactions."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._variables: weakref.WeakValueDictionary[str, _WorldVariable] = weakref.WeakValueDictionary()
        self._passed: list[tuple[int, dict[_WorldVariable, Value]]] = []

    def variable(
        self, source: str, name: str, read: Callable[[], Value], objects: tuple[Object, ...]
    ) -> _WorldVariable:
        """Return the variable of a source, shared by all fluents that follow it; the world's lock is held."""
        key = f"{source} of {name}"
        known = self._variables.get(key)
        if known is None:
            self._variables[key] = known = _WorldVariable(source, name, read, objects)
        return known

    def time_passed(self) -> None:
        """Read all variables within a simulation; the values are assigned at the end of its transaction."""
        values = {variable: variable.read() for variable in self._variables.values() if not variable.gone()}
        if values:
            self._passed.append((self._world.sim_step, values))

    def has_news(self) -> bool:
        """Return whether a variable with waits or counters has another value now, within a simulation."""
        followed = [each for each in self._variables.values() if (each.waiters or each.counters) and not each.gone()]
        return any(each.read() != each.held for each in followed)

    def committed(self, transaction: Transaction) -> None:
        """Update the variables that a recorded transaction affects; the world's lock is held."""
        variables = list(self._variables.values())
        if not variables:
            return
        world = self._world
        for sim_step, values in self._passed:
            _assign_changed(values, world.name, sim_step)
        self._passed.clear()
        if world.closed:
            end(variables, Ended(world.name, "the world"))
            return
        for variable in variables:
            if gone := variable.gone():
                end((variable,), Ended(world.name, gone))
                del self._variables[variable.name]
        names = transaction.affected()
        affected = [each for each in variables if each.name in self._variables and not names.isdisjoint(each.bodies)]
        _assign_changed({variable: variable.read() for variable in affected}, world.name, world.sim_step)


def _assign_changed(values: dict[_WorldVariable, Value], world: str, sim_step: int) -> None:
    changed: dict[Variable, Value] = {variable: value for variable, value in values.items() if value != variable.held}
    if changed:
        assign(changed, world, sim_step)


def _follow(source: str, name: str, read: Callable[[], Value], *objects: Object) -> Fluent:
    world = world_of(*objects)
    with world.lock:
        transactions = world.transactions
        if not isinstance(transactions.observer, WorldVariables):
            transactions.observer = WorldVariables(world)
        return Derived(transactions.observer.variable(source, name, read, objects))


def _object(body: Object) -> Object:
    plain: Object = unwrap(body)
    world_of(plain)
    return plain


def _link(body: Object, link: str | None) -> tuple[Object, str]:
    owner = _object(body)
    return owner, owner.name if link is None else f"{owner.check_link(link)} of {owner.name}"


def _pose(body: Object, link: str | None) -> tuple[tuple[float, ...], tuple[float, ...]]:
    position, orientation = body.get_link_position_and_orientation(body.check_link(link))
    return tuple(position), tuple(orientation)
