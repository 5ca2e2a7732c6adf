"""Fluents that follow a world: where an object is, what a robot holds, whether two things touch.

They are brought up to date by the one funnel through which worlds change, with the world's lock held: in the order of
the changes, each a moment of its own for all fluents of that world, and on record after the change that caused it.
Nobody is called then; those who wait are only woken. While time is simulated they are looked at 30 times a simulated
second; what they were on the way is told, in order, when the stretch has ended.

A fluent of an object that was removed, or of a world that has ended, has no value any more: whoever asks or waits gets
:class:`~pycram.failures.WorldClosed`. A world that no fluent follows pays nothing.

Values are plain: tuples in m and xyzw, floats in rad or m, names. They change only when they are others than before::

    height = network(itemgetter(2), position(milk))
    (height < 0.5).OR(holding(robot, "left") == "milk").wait_for()
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

from pycram.fluents.expressions import Ended
from pycram.fluents.fluent import Derived
from pycram.fluents.variables import Variable, change, end
from pycram.foundation.failures import BadArgument
from pycram.reasoning.queries.contact import touches
from pycram.reasoning.queries.query import world_of
from pycram.scheduling.future import unwrap

if TYPE_CHECKING:
    from collections.abc import Callable

    from pycram.fluents.expressions import Value
    from pycram.fluents.fluent import Fluent
    from pycram.world.object import Object
    from pycram.world.transaction import Change
    from pycram.world.world import BulletWorld

__all__ = ["contact", "holding", "joint", "pose", "position"]


def pose(body: Object, link: str | None = None) -> Fluent:
    """Follows the pose of an object: ((x, y, z), (x, y, z, w)).

    Args:
        body: the object.
        link: one of its links; by default the base link.

    Raises:
        BadArgument: it isn't an object.
        UnknownName: there is no such link.
        WorldClosed: it is gone.
    """
    whole, name = _link(body, link)
    return _follow("pose", name, lambda: _pose(whole, link), whole)


def position(body: Object, link: str | None = None) -> Fluent:
    """Follows the position of an object: (x, y, z) in m.

    Args:
        body: the object.
        link: one of its links; by default the base link.

    Raises:
        BadArgument: it isn't an object.
        UnknownName: there is no such link.
        WorldClosed: it is gone.
    """
    whole, name = _link(body, link)
    return _follow("position", name, lambda: _pose(whole, link)[0], whole)


def joint(body: Object, name: str) -> Fluent:
    """Follows the value of a joint, in rad or m.

    Args:
        body: the object.
        name: of the joint.

    Raises:
        BadArgument: it isn't an object.
        UnknownName: there is no such movable joint.
        WorldClosed: it is gone.
    """
    whole = _object(body)
    whole.check_joint(name)
    return _follow("joint", f"{name} of {whole.name}", lambda: whole.get_joint_position(name), whole)


def holding(robot: Object, arm: str | None = None) -> Fluent:
    """Follows what a robot holds: the name of the object, None if there is none; the first of several.

    Args:
        robot: the robot, or any other object that carries things.
        arm: one of its arms ("left", "right"); by default whatever it carries.

    Raises:
        BadArgument: it isn't an object, or has no arms.
        UnknownName: there is no such arm.
        WorldClosed: it is gone.
    """
    carrier = _object(robot)
    links = None if arm is None else _gripper(carrier, arm)

    def held() -> str | None:
        return next((one.body.name for one in carrier.carried if links is None or one.carrier_link in links), None)

    return _follow("holding", carrier.name if arm is None else f"{arm} arm of {carrier.name}", held, carrier)


def contact(one: Object, other: Object) -> Fluent:
    """Follows whether two objects touch: True or None.

    Args:
        one: an object.
        other: another one of the same world.

    Raises:
        BadArgument: one isn't an object, or they are in different worlds.
        WorldClosed: one is gone.
    """
    a, b = _object(one), _object(other)
    return _follow("contact", f"{a.name} and {b.name}", lambda: True if touches(a, b) else None, a, b)


class _Followed(Variable):
    """A variable that is what a world says.

    Attributes:
        read: gives its value; called with the world's lock held, while the objects exist.
        objects: the objects whose it is.
    """

    __slots__ = ("objects", "read")

    def __init__(self, source: str, name: str, read: Callable[[], Value], objects: tuple[Object, ...]) -> None:
        super().__init__(read(), f"{source} of {name}", source, tuple(body.name for body in objects))
        self.read = read
        self.objects = objects

    def gone(self) -> str:
        """Which of its objects has been removed, in words; "" if none."""
        return next((f"object {body.name}" for body in self.objects if not body.alive), "")


class Followers:
    """The variables that follow one world; what its funnel tells of changes."""

    def __init__(self, world: BulletWorld) -> None:
        self._world = world
        self._followed: weakref.WeakValueDictionary[str, _Followed] = weakref.WeakValueDictionary()
        self._passed: list[tuple[int, dict[_Followed, Value]]] = []

    def follow(self, source: str, name: str, read: Callable[[], Value], objects: tuple[Object, ...]) -> _Followed:
        """The variable for something; the same for all who follow the same. The world's lock is held."""
        key = f"{source} of {name}"
        known = self._followed.get(key)
        if known is None:
            self._followed[key] = known = _Followed(source, name, read, objects)
        return known

    def passed(self) -> None:
        """Simulated time has passed: notes what is others now, to be told at the end of the change."""
        now = {followed: followed.read() for followed in self._followed.values() if not followed.gone()}
        if now:
            self._passed.append((self._world.sim_step, now))

    def changed(self, done: Change) -> None:
        """A change is on record: brings what it concerns up to date. The world's lock is held."""
        followed = list(self._followed.values())
        if not followed:
            return
        world = self._world
        for sim_step, values in self._passed:
            _tell(values, world.name, sim_step)
        self._passed.clear()
        if world.closed:
            end(followed, Ended(world.name, "the world"))
            return
        for one in followed:
            if gone := one.gone():
                end((one,), Ended(world.name, gone))
                del self._followed[one.name]
        names = done.concerned()
        living = [one for one in followed if one.name in self._followed and not names.isdisjoint(one.bodies)]
        _tell({one: one.read() for one in living}, world.name, world.sim_step)


def _tell(values: dict[_Followed, Value], world: str, sim_step: int) -> None:
    news: dict[Variable, Value] = {followed: value for followed, value in values.items() if value != followed.held}
    if news:
        change(news, world, sim_step)


def _follow(source: str, name: str, read: Callable[[], Value], *objects: Object) -> Fluent:
    world = world_of(*objects)
    with world.lock:
        transactions = world.transactions
        if not isinstance(transactions.observer, Followers):
            transactions.observer = Followers(world)
        return Derived(transactions.observer.follow(source, name, read, objects))


def _object(body: Object) -> Object:
    plain: Object = unwrap(body)
    world_of(plain)
    return plain


def _link(body: Object, link: str | None) -> tuple[Object, str]:
    whole = _object(body)
    return whole, whole.name if link is None else f"{whole.check_link(link)} of {whole.name}"


def _pose(body: Object, link: str | None) -> tuple[tuple[float, ...], tuple[float, ...]]:
    at, turn = body.get_position_and_orientation() if link is None else body.get_link_position_and_orientation(link)
    return tuple(at), tuple(turn)


def _gripper(robot: Object, arm: str) -> frozenset[str]:
    """The links with which an arm holds."""
    if robot.description is None:
        raise BadArgument("robot", robot, "a robot with arms")
    described = robot.description.arm(arm)
    return frozenset((described.tool_frame, described.gripper.palm, *described.gripper.fingers))
