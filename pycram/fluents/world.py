"""Fluents that follow a world: poses, joints, held objects and contacts.

A transaction updates all fluents of its world at the same moment. A simulation reads the values 30 times a simulated
second, and assigns them at its end. After the end of a world or an object, its fluents raise WorldClosed. All functions
here raise BadArgument for an argument that isn't an object, and UnknownName for an unknown link, joint or arm.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable

from pycram.fluents.expressions import Ended, Value, Variable, assign, end
from pycram.fluents.fluent import Derived, Fluent
from pycram.foundation.failures import BadArgument
from pycram.foundation.refusals import refusing
from pycram.motions.process_module import CONTINUOUS, current_environment
from pycram.reasoning.queries.contact import touches
from pycram.reasoning.queries.query import world_of
from pycram.scheduling.future import unwrap
from pycram.world.object import Object
from pycram.world.simulation import WorldClock
from pycram.world.transaction import Transaction
from pycram.world.world import BulletWorld

__all__ = ["contact", "holding", "joint", "pose", "position"]


@refusing(name="fluents.pose")
def pose(body: Object, link: str | None = None) -> Fluent:
    """Follow the pose of an object's base link, or of another link: ((x, y, z), (x, y, z, w)) in the world frame."""
    owner, name = _link(body, link)
    return _follow("pose", name, lambda: _pose(owner, link), owner)


@refusing(name="fluents.position")
def position(body: Object, link: str | None = None) -> Fluent:
    """Follow the position of an object's base link, or of another link: (x, y, z) in m in the world frame."""
    owner, name = _link(body, link)
    return _follow("position", name, lambda: _pose(owner, link)[0], owner)


@refusing(name="fluents.joint")
def joint(body: Object, name: str) -> Fluent:
    """Follow the position of a movable joint of an object, in rad or m."""
    owner = _object(body)
    owner.check_joint(name)
    return _follow("joint", f"{name} of {owner.name}", lambda: owner.get_joint_position(name), owner)


@refusing(name="fluents.holding")
def holding(robot: Object, arm: str | None = None) -> Fluent:
    """Follow the name of the first object that a robot holds; None if the robot holds no object.

    Args:
        robot: A robot, or any other object that carries objects.
        arm: Name of an arm of the robot; by default, all links are considered.
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
    """Follow whether two objects of the same world touch: True or None."""
    a, b = _object(object1), _object(object2)
    return _follow("contact", f"{a.name} and {b.name}", lambda: True if touches(a, b) else None, a, b)


class _WorldVariable(Variable):
    __slots__ = ("objects", "read")

    def __init__(self, source: str, name: str, read: Callable[[], Value], objects: tuple[Object, ...]) -> None:
        super().__init__(read(), f"{source} of {name}", source, tuple(body.name for body in objects))
        self.read = read  # returns the value; the caller holds the world's lock, and the objects exist
        self.objects = objects

    def clock(self) -> WorldClock | None:
        """Return the clock of the world if motions take simulated time."""
        return WorldClock(self.objects[0].world, last=False) if current_environment() == CONTINUOUS else None

    def gone(self) -> str:
        """Return the name of a followed object that was removed; "" if all objects exist."""
        return next((f"object {body.name}" for body in self.objects if not body.alive), "")


class WorldVariables:
    """All variables that follow one world. Transactions of the world notify this object."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._variables: weakref.WeakValueDictionary[str, _WorldVariable] = weakref.WeakValueDictionary()
        self._passed: list[tuple[int, dict[_WorldVariable, Value]]] = []

    def variable(
        self, source: str, name: str, read: Callable[[], Value], objects: tuple[Object, ...]
    ) -> _WorldVariable:
        """Return the variable that all fluents of a quantity share; the caller holds the world's lock."""
        key = f"{source} of {name}"
        known = self._variables.get(key)
        if known is None:
            self._variables[key] = known = _WorldVariable(source, name, read, objects)
        return known

    def time_passed(self) -> None:
        """Read the values of all variables during a simulation; the simulation's end assigns these values."""
        values = {variable: variable.read() for variable in self._variables.values() if not variable.gone()}
        if values:
            self._passed.append((self._world.sim_step, values))

    def has_news(self) -> bool:
        """Return whether the simulation has changed a value for which a wait or a counter waits."""
        followed = [each for each in self._variables.values() if (each.waiters or each.counters) and not each.gone()]
        return any(each.read() != each.held for each in followed)

    def committed(self, transaction: Transaction) -> None:
        """Update the variables that a recorded transaction affects; the caller holds the world's lock."""
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
