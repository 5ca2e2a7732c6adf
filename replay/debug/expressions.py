"""Expressions about recorded states, as ``milk.z``, ``holding(left)``, ``distance(pr2, cup) < 1``, and their changes.

Names are bodies (``robot`` is the plan's robot) and arms. A body has ``x``, ``y``, ``z``, ``position``,
``orientation``, ``velocity``, ``carrier``, and its joints. If several worlds have a body, its name means the one in the
last opened world; ``lab.milk.z`` means the body in the world ``lab``. A name that isn't an identifier is in quotes:
``'milk carton'.z``, ``lab['milk carton'].z``.
"""

from __future__ import annotations

import ast
import math
import re
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from recorder.errors import did_you_mean, suggestion
from recorder.records import Keyframe, Mutation
from recorder.records.fold import apply
from replay.errors import ReplayError
from replay.report.question import written
from replay.restore.recorded_world import description_of
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from types import CodeType

    from recorder.records.fold import FoldedWorld
    from replay.file.record_reader import RecordReader

_PARTS: Final = ("x", "y", "z", "position", "orientation", "velocity", "carrier")
_ROUNDING: Final = 1e-6  # m or rad; smaller changes of a number are ignored, as by ``blame``
_FUNCTIONS: Final[Mapping[str, object]] = {
    each.__name__: each for each in (abs, all, any, len, max, min, round, sorted, sum, math.sqrt, math.degrees)
}


class NoQuantity(ReplayError):
    """An expression without a value in any recorded state, for example because of an unknown name."""

    def __init__(self, expression: str, cause: str) -> None:
        super().__init__(f"{expression}: {cause}")
        self.expression = expression


class ValueChange(NamedTuple):
    """A change of an expression's value at a step."""

    step: int
    before: object
    after: object


def value_changes(log: RecordReader, expression: str) -> list[ValueChange]:
    """Return the changes of an expression's value in a recording.

    Before an object is loaded, and after it is removed, values are None.

    Raises:
        NoQuantity: the expression has no value at any step.
    """
    try:
        code = compile(_QuotedNames().visit(ast.parse(expression.strip(), mode="eval")), "<watch>", "eval")
    except (SyntaxError, ValueError) as error:
        raise NoQuantity(expression, f"it isn't an expression: {error}") from None
    worlds: dict[str, FoldedWorld] = {}
    found: list[ValueChange] = []
    latest: object = None
    known, cause = False, ""
    unknown, names = "", set[str]()
    for record in log.records((Mutation, Keyframe)):
        apply(worlds, record)
        try:
            value = _value(code, worlds)
        except NameError as error:
            value, cause, unknown = None, str(error), error.name or ""
            names.update(name for world in worlds.values() for name in (world.name, *world.bodies))
        except _NoWorld as error:
            value, cause = None, cause or str(error)
        except Exception as error:  # noqa: BLE001  whatever the user's expression raises
            value, cause = None, str(error)
        else:
            known = True
        if _differ(latest, value):
            found.append(ValueChange(record.seq, latest, value))
            latest = value
    if not known:
        hint = f"; {suggestion(unknown, names)}" if unknown else ""
        raise NoQuantity(expression, f"{cause or 'the recording has no state'}{hint}")
    return found


class _NoWorld(LookupError):
    """No world is open in a state."""


class _QuotedNames(ast.NodeTransformer):
    """Turns strings into names where an object or a world is meant: alone, before a dot or [], in distance()."""

    def visit_Expression(self, node: ast.Expression) -> ast.AST:
        node.body = _meant(node.body)
        return self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        node.value = _meant(node.value)
        return self.generic_visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        node.value = _meant(node.value)
        return self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id == "distance":
            node.args = [_meant(each) for each in node.args]
        return self.generic_visit(node)


def _meant(node: ast.expr) -> ast.expr:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return ast.copy_location(ast.Name(node.value, ast.Load()), node)
    return node


def _value(code: CodeType, worlds: Mapping[str, FoldedWorld]) -> object:
    opened = {name: _World(world) for name, world in worlds.items() if world.open}
    if not opened:
        raise _NoWorld("no world is open")
    value = eval(code, {"__builtins__": {}}, _Names(opened))  # noqa: S307  the user's own
    if isinstance(value, _World):
        raise TypeError("a world has no value; name a body of the world")
    return (value.position, value.orientation) if isinstance(value, _Body) else value


def _differ(before: object, after: object) -> bool:
    if isinstance(before, float) and isinstance(after, float):
        return abs(before - after) > _ROUNDING
    if isinstance(before, tuple) and isinstance(after, tuple) and len(before) == len(after):
        return any(map(_differ, before, after))
    return before != after


class _Names(dict[str, Any]):
    """The values of names in an expression, in the open worlds."""

    def __init__(self, worlds: Mapping[str, _World]) -> None:
        super().__init__(_FUNCTIONS)
        self._worlds = worlds
        latest = list(worlds.values())[::-1]
        self._latest = latest
        self |= {"holding": next((each for each in latest if each.has_robot), latest[0]).holding, "distance": _distance}

    def __missing__(self, name: str) -> object:
        for world in self._latest:
            found = world.find(name)
            if found is not None:
                return found
        for known, world in self._worlds.items():
            if _is_called(known, name):
                return world
        raise NameError(f"no object is called {name}", name=name)


def _is_called(known: str, name: str) -> bool:
    return name in (known, re.sub(r"\W", "_", known))


class _World:
    def __init__(self, world: FoldedWorld) -> None:
        self._world = world

    @property
    def has_robot(self) -> bool:
        """Whether the world has a robot."""
        return self._robot in self._world.bodies

    @property
    def _robot(self) -> str:
        return self._world.robot

    def find(self, name: str) -> object:
        """Return a body, the robot or the name of an arm; None for an unknown name."""
        body = next((each for each in self._world.bodies if _is_called(each, name)), None)
        if body is None and name == "robot" and self.has_robot:
            body = self._robot
        if body is not None:
            return _Body(self._world, body)
        return name if name in self._arms() else None

    def __getattr__(self, name: str) -> object:
        found = self.find(name)
        if found is None:
            raise AttributeError(f"no object of this world is called {name}{did_you_mean(name, self._world.bodies)}")
        return found

    def __getitem__(self, name: str) -> object:
        return self.__getattr__(name)

    def _arms(self) -> Mapping[str, Any]:
        robot = self._world.bodies.get(self._robot)
        if robot is None or not robot.loaded.robot_description:
            return {}
        description = description_of(robot.loaded.robot_description)
        return {} if description is None else description.arms

    def holding(self, arm: str | None = None) -> str | None:
        """Return the name of the object that the robot holds, like the fluent ``holding``."""
        links = None
        if arm is not None:
            if arm not in self._arms():
                raise LookupError(f"no arm is called {arm}{did_you_mean(arm, self._arms())}")
            described = self._arms()[arm]
            links = set(described.links()) - {described.base_link}
        for held in self._world.attachments.values():
            if held.carrier == self._robot and (links is None or held.carrier_link in links):
                return held.body
        return None


class _Body:
    """A body of a world, with its quantities as attributes."""

    def __init__(self, world: FoldedWorld, name: str) -> None:
        self._world = world
        self._name = name
        body = world.bodies[name]
        self.position, self.orientation, self.velocity = body.position, body.orientation, body.velocity
        self.x, self.y, self.z = body.position

    @property
    def carrier(self) -> str | None:
        """Name of the body that carries it."""
        return next((each.carrier for each in self._world.attachments.values() if each.body == self._name), None)

    def __getattr__(self, joint: str) -> float:
        joints = self._world.bodies[self._name].joints
        if joint not in joints:
            raise AttributeError(f"{self._name} has no {joint}{did_you_mean(joint, (*_PARTS, *joints))}")
        return joints[joint]


def _distance(one: _Body, other: _Body) -> float:
    """Return the distance in m between the base links of two bodies."""
    return math.dist(one.position, other.position)


def quantity_names(log: RecordReader, step: int) -> Iterator[str]:
    """Yield the names that an expression may contain at a step, for completion."""
    state = state_at(log, step)
    yield from (f"{each}(" for each in ("holding", "distance"))
    for world in state.worlds.values():
        yield written(world.name)
        for body in world.bodies.values():
            name = written(body.name)
            yield name
            yield from (f"{name}.{part}" for part in _PARTS)
            yield from (f"{name}.{joint}" for joint in body.joints)
