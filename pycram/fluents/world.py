"""Fluents that follow a world: where an object is, what a robot holds, whether two things touch.

They are updated with each world transaction, with the world's lock held: in the order of the transactions, all fluents
of that world at the same moment, and recorded after the change that caused it. No user code is called then; waiting
threads are only notified. During a simulation they are read 30 times a simulated second; these values are assigned, in
order, when the simulation has ended.

A fluent of an object that was removed, or of a world that has ended, has no value any more: reading it and waiting for
it raise :class:`~pycram.failures.WorldClosed`. A world that no fluent follows has no extra cost.

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
from pycram.reasoning.queries.contact import touches
from pycram.reasoning.queries.query import world_of
from pycram.scheduling.future import unwrap

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
        BadArgument: It isn't an object.
        UnknownName: There is no such link.
        WorldClosed: It is gone.
    """
    owner, name = _link(body, link)
    return _follow("pose", name, lambda: _pose(owner, link), owner)


@refusing(name="fluents.position")
def position(body: Object, link: str | None = None) -> Fluent:
    """Follow the position of an object's base link, or of another link: (x, y, z) in m in the world frame.

    Raises:
        BadArgument: It isn't an object.
        UnknownName: There is no such link.
        WorldClosed: It is gone.
    """
    owner, name = _link(body, link)
    return _follow("position", name, lambda: _pose(owner, link)[0], owner)


@refusing(name="fluents.joint")
def joint(body: Object, name: str) -> Fluent:
    """Follow the position of an object's joint, in rad or m.

    Raises:
        BadArgument: It isn't an object.
        UnknownName: There is no such movable joint.
        WorldClosed: It is gone.
    """
    owner = _object(body)
    owner.check_joint(name)
    return _follow("joint", f"{name} of {owner.name}", lambda: owner.get_joint_position(name), owner)


@refusing(name="fluents.holding")
def holding(robot: Object, arm: str | None = None) -> Fluent:
    """Follow what a robot holds: the name of the object, None if there is none; the first of several.

    Args:
        robot: The robot, or any other object that carries things.
        arm: The name of one of its arms; by default all its links.

    Raises:
        BadArgument: It isn't an object, or has no arms.
        UnknownName: There is no such arm.
        WorldClosed: It is gone.
    """
    carrier = _object(robot)
    links = None if arm is None else _gripper(carrier, arm)

    def held() -> str | None:
        return next((each.body.name for each in carrier.carried if links is None or each.carrier_link in links), None)

    return _follow("holding", carrier.name if arm is None else f"{arm} arm of {carrier.name}", held, carrier)


@refusing(name="fluents.contact")
def contact(object1: Object, object2: Object) -> Fluent:
    """Follow whether two objects of the same world touch: True or None.

    Raises:
        BadArgument: One isn't an object, or they are in different worlds.
        WorldClosed: One is gone.
    """
    a, b = _object(object1), _object(object2)
    return _follow("contact", f"{a.name} and {b.name}", lambda: True if touches(a, b) else None, a, b)


class _WorldVariable(Variable):
    """A variable that follows a world.

    Attributes:
        read: Returns its present value; called with the world's lock held, while the objects exist.
        objects: The objects that it follows.
    """

    __slots__ = ("objects", "read")

    def __init__(self, source: str, name: str, read: Callable[[], Value], objects: tuple[Object, ...]) -> None:
        super().__init__(read(), f"{source} of {name}", source, tuple(body.name for body in objects))
        self.read = read
        self.objects = objects

    def gone(self) -> str:
        """Return which of its objects has been removed; "" for none."""
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
        """Return the variable of a source, the same for all fluents that follow it. The world's lock is held."""
        key = f"{source} of {name}"
        known = self._variables.get(key)
        if known is None:
            self._variables[key] = known = _WorldVariable(source, name, read, objects)
        return known

    def time_passed(self) -> None:
        """Read all variables within a simulation; they are assigned at the end of its transaction."""
        values = {variable: variable.read() for variable in self._variables.values() if not variable.gone()}
        if values:
            self._passed.append((self._world.sim_step, values))

    def has_news(self) -> bool:
        """Whether a variable that somebody waits for has another value, within a simulation."""
        followed = [each for each in self._variables.values() if (each.waiters or each.counters) and not each.gone()]
        return any(each.read() != each.held for each in followed)

    def committed(self, transaction: Transaction) -> None:
        """Update the variables that a recorded transaction affects. The world's lock is held."""
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


def _gripper(robot: Object, arm: str) -> frozenset[str]:
    """Return the links with which an arm holds."""
    if robot.description is None:
        raise BadArgument("robot", robot, "a robot with arms")
    described = robot.description.arm(arm)
    return frozenset(described.links()) - {described.base_link}
