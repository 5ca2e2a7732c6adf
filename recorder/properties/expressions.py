"""Expressions about one state, such as ``milk.z > 0.5`` (docs/reference/properties.md).

Python parses expressions, but never executes them: each allowed node of the syntax tree becomes a function of a
:class:`Scene`. The margin of a condition is the smallest distance of its quantities from values that would change the
answer. If the condition holds, the margin is 0 or more. The margin of conditions about names is infinite.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn, Protocol, TypeAlias

from recorder import geometry
from recorder.errors import PortableError, did_you_mean
from recorder.records.fold import FoldedWorld

if TYPE_CHECKING:
    Function: TypeAlias = "Callable[[Scene], Any]"

UNITS: Final[Mapping[str, tuple[float, str]]] = {
    "m": (1.0, "m"), "cm": (0.01, "m"), "mm": (0.001, "m"),
    "rad": (1.0, "rad"), "deg": (math.pi / 180, "rad"),
    "m/s": (1.0, "m/s"), "cm/s": (0.01, "m/s"), "mm/s": (0.001, "m/s"),
    "rad/s": (1.0, "rad/s"), "deg/s": (math.pi / 180, "rad/s"),
    "s": (1.0, "s"), "ms": (0.001, "s"), "min": (60.0, "s"),
}  # fmt: skip
"""Units of numbers: the size of each in a base unit, and the name of the base unit."""
_BASE: Final = frozenset(base for _, base in UNITS.values())
NUMBER: Final = r"(?:\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)"
RANGE: Final = 0.05  # contacts are measured up to this distance in m. So "no contact" has at most this margin.
ROUNDING: Final = 1e-6  # numbers with a smaller difference are equal

_QUANTITY: Final = re.compile(rf"(?<![\w.])({NUMBER})\s*({'|'.join(sorted(UNITS, key=len, reverse=True))})\b(?!\s*\()")
_STRINGS: Final = re.compile(r"""('(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*")""")
_MEASURED: Final = "_measured"  # name of the function that replaces a number with a unit in the syntax tree
_UPRIGHT: Final = math.radians(10)  # rad, default tolerance
PARTS: Final = ("x", "y", "z", "position", "orientation", "velocity", "speed", "roll", "pitch", "yaw", "carrier")
"""Quantities of a body, in addition to the positions of its joints."""
_KINDS: Final = {
    **dict.fromkeys(("x", "y", "z", "distance"), "m"),
    **dict.fromkeys(("roll", "pitch", "yaw", "tilt", "angle"), "rad"),
    **dict.fromkeys(("speed", "position", "orientation", "velocity", "carrier"), ""),
}
"""Units of quantities. Any other quantity is a joint."""
_MAX_LENGTH: Final = 2000  # maximum number of characters, because Python's parser fails on deeply nested text


class BadProperty(PortableError, ValueError):
    """A text isn't a property of the language."""

    def __init__(self, text: str, cause: str, source: str = "") -> None:
        super().__init__(f"{source}{': ' if source else ''}{text}: {cause}")
        self.text = text
        self.cause = cause
        self.source = source  # file and line of the text; "" without a file


class NoValue(LookupError):
    """An expression has no value in a state, for example because its object isn't loaded yet."""

    def __init__(self, cause: str, name: str = "", known: Iterable[str] = ()) -> None:
        super().__init__(cause)
        self.name = name  # the unknown name; "" if there is another cause
        self.known = tuple(known)


@dataclass(frozen=True, order=True, slots=True)
class Truth:
    """Whether a condition holds, and its margin. The class isn't a tuple, so that calculations with conditions fail."""

    margin: float
    holds: bool

    def negated(self) -> Truth:
        """Return whether the opposite condition holds, and its margin."""
        return Truth(-self.margin, not self.holds)


class Touch(NamedTuple):
    """Whether two bodies touch. The margins are distances in m, at most RANGE."""

    contact: Truth
    on: Truth  # whether the first body is on the second body


class Geometry(Protocol):
    """Measures distances between the shapes of bodies."""

    def touch(self, world: FoldedWorld, one: tuple[str, str], other: tuple[str, str]) -> Touch:
        """Return whether two bodies touch. A body is a name and a link; the link "" means all links."""

    def owner(self, world: FoldedWorld, link: str) -> str:
        """Return the name of the body that has the link; "" if no body has it."""


class Scene:
    """The present state of all worlds, which gives values to names."""

    def __init__(self, worlds: Mapping[str, FoldedWorld], geometry: Geometry | None = None) -> None:
        self.worlds = worlds
        self.geometry = geometry
        self.removed: set[str] = set()  # names of the bodies that were removed

    def opened(self) -> list[FoldedWorld]:
        """Return the open worlds; the world that was opened last is the first."""
        found = [world for world in self.worlds.values() if world.open]
        if not found:
            raise NoValue("no world is open")
        return found[::-1]

    def named(self, name: str) -> Any:
        """Return the body, arm or world with a name."""
        opened = self.opened()
        for world in opened:
            found = _find(world, name)
            if found is not None:
                return found
        for world in opened:
            if name in (world.name, _identifier(world.name)):
                return world
        known = [each for world in opened for each in (world.name, *world.bodies)]
        raise NoValue(f"no object is called {name}", name, known)

    def holding(self, arm: str | None = None) -> str | None:
        """Return the name of the object that the robot holds with an arm, or with any arm; None if the arm is empty."""
        opened = self.opened()
        world = next((each for each in opened if each.robot in each.bodies), opened[0])
        links = None
        if arm is not None:
            arms = _arms(world)
            if arm not in arms:
                raise NoValue(f"no arm is called {arm}{did_you_mean(arm, arms)}", arm, arms)
            links = arms[arm]
        carried = (held for held in world.attachments.values() if held.carrier == world.robot)
        return next((held.body for held in carried if links is None or held.carrier_link in links), None)

    def touches(self, one: str, other: str) -> dict[tuple[tuple[str, str], tuple[str, str]], Touch]:
        """Return the contacts of pairs of bodies. Each name is a body, BODY.LINK, a link, or a pattern with ``*``."""
        if self.geometry is None:
            raise NoValue("contacts need the executor")
        for world in self.opened():
            first, second = (list(self._matching(world, self.geometry, name)) for name in (one, other))
            if first and second:
                return {(a, b): self.geometry.touch(world, a, b) for a in first for b in second if a[0] != b[0]}
        for name in (one, other):
            if not _is_pattern(name):
                self.named(name)
        if any(fnmatchcase(gone, name) for gone in self.removed for name in (one, other) if _is_pattern(name)):
            return {}
        raise NoValue(f"no objects are called {one} and {other}")

    def matching(self, pattern: str) -> list[BodyQuantities]:
        """Return the bodies whose names match a pattern."""
        for world in self.opened():
            if found := [BodyQuantities(world, each) for each in world.bodies if fnmatchcase(each, pattern)]:
                return found
        raise NoValue(f"no objects are called {pattern}")

    @staticmethod
    def _matching(world: FoldedWorld, geometry: Geometry, name: str) -> Iterator[tuple[str, str]]:
        if _is_pattern(name):
            yield from ((each, "") for each in world.bodies if fnmatchcase(each, name))
            return
        found = _find(world, name)
        if isinstance(found, BodyQuantities):
            yield found.name, ""
            return
        body, _, link = name.rpartition(".")
        owner = geometry.owner(world, link)
        if owner and body in ("", owner):
            yield owner, link


class Conditions:
    """One condition for each object, or each pair of objects, that matches a pattern: one or all of them must hold."""

    def __init__(self, truths: Iterable[Truth], choose: Callable[[Iterable[Truth]], Truth] = max) -> None:
        self.truths = list(truths)
        self._choose = choose
        self.truth = choose(self.truths) if self.truths else Truth(-RANGE, False)

    def negated(self) -> Conditions:
        """Return the opposite conditions: all must hold instead of one, or one instead of all."""
        return Conditions([each.negated() for each in self.truths or [self.truth]], max if self._choose is min else min)

    def __len__(self) -> int:
        return sum(each.holds for each in self.truths)


class BodyQuantities:
    """The quantities of a body of a world."""

    def __init__(self, world: FoldedWorld, name: str) -> None:
        self._world = world
        self.name = name
        self._body = world.bodies[name]

    def part(self, name: str) -> Any:
        """Return a quantity: one of ``PARTS``, or a joint's position."""
        body = self._body
        if name in ("x", "y", "z"):
            return body.position["xyz".index(name)]
        if name in body.joints:
            return body.joints[name]
        match name:
            case "position" | "orientation" | "velocity":
                return getattr(body, name)
            case "speed":
                return math.hypot(*body.velocity[:3])
            case "carrier":
                return next((each.carrier for each in self._world.attachments.values() if each.body == self.name), None)
            case "roll" | "pitch" | "yaw":
                return geometry.to_rpy(body.orientation)[("roll", "pitch", "yaw").index(name)]
        raise NoValue(f"{self.name} has no {name}{did_you_mean(name, (*PARTS, *body.joints))}", name)

    @property
    def tilt(self) -> float:
        """The angle between the vertical axes of the body and the world in rad."""
        return geometry.lean(geometry.IDENTITY[1], self._body.orientation)


def _is_pattern(name: object) -> bool:
    return isinstance(name, str) and ("*" in name or "?" in name)


@cache
def _identifier(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _find(world: FoldedWorld, name: str) -> BodyQuantities | str | None:
    if name in world.bodies:
        return BodyQuantities(world, name)
    for each in world.bodies:
        if _identifier(each) == name:
            return BodyQuantities(world, each)
    if name == "robot" and world.robot in world.bodies:
        return BodyQuantities(world, world.robot)
    return name if name in _arms(world) else None


def _arms(world: FoldedWorld) -> Mapping[str, frozenset[str]]:
    robot = world.bodies.get(world.robot)
    return {} if robot is None else _described_arms(robot.loaded.robot_description)


@cache
def _described_arms(description: str) -> Mapping[str, frozenset[str]]:
    """Return the links of each arm's hand in a robot's description, by the name of the arm."""
    try:
        arms = tomllib.loads(description).get("arms", {})
        hands = {name: arm.get("gripper", {}) for name, arm in arms.items()}
        return {
            name: frozenset({arms[name]["tool_frame"], *hand.get("fingers", ()), hand.get("palm", "")})
            - {arms[name]["base_link"]}
            for name, hand in hands.items()
        }
    except (tomllib.TOMLDecodeError, AttributeError, KeyError, TypeError):  # a damaged recording
        return {}


def plain(value: object) -> Any:
    """Return a value as numbers, texts, None and tuples."""
    if isinstance(value, BodyQuantities):
        return value.part("position"), value.part("orientation")
    if isinstance(value, Truth | Conditions):
        return truth(value).holds
    if not isinstance(value, str | int | float | tuple | None):
        raise NoValue("a world has no value; name a body of the world")
    return value


def truth(value: object) -> Truth:
    """Return the truth of a value. Values that aren't conditions are true as in Python, with an infinite margin."""
    if isinstance(value, Truth):
        return value
    if isinstance(value, Conditions):
        return value.truth
    return Truth(math.inf, True) if value else Truth(-math.inf, False)


class PropertyExpression:
    """A compiled expression. ``source`` is the property's file and line. Raises BadProperty for any other text."""

    def __init__(self, text: str, source: str = "") -> None:
        self.text = " ".join(text.split())
        self.source = source
        self.quantities: dict[str, Function] = {}  # functions by the texts of parts and calls
        self.units: set[str] = set()  # units of the comparisons
        self.names: dict[str, None] = {}  # names of objects, arms and worlds
        self.needs_geometry = False
        if len(text) > _MAX_LENGTH:
            self._refuse(f"it is longer than {_MAX_LENGTH} characters")
        parts = _STRINGS.split(text.strip())
        parts[::2] = [_QUANTITY.sub(rf'{_MEASURED}(\1,"\2")', part) for part in parts[::2]]
        try:
            with warnings.catch_warnings(action="ignore"):  # the warning is about text that looks like mistaken code
                tree = _meant(ast.parse("".join(parts), mode="eval").body)
            self._function = self._compile(tree)
        except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
            if isinstance(error, BadProperty):
                raise
            self._refuse(f"it isn't an expression: {error.msg if isinstance(error, SyntaxError) else error}")

    def value(self, scene: Scene) -> Any:
        """Return the value in a scene; raise NoValue if there is none."""
        try:
            return self._function(scene)
        except (ArithmeticError, TypeError, ValueError) as error:
            raise NoValue(str(error)) from None

    def truth(self, scene: Scene) -> Truth:
        """Return whether the expression holds in a scene; raise NoValue if it has no value."""
        return truth(self.value(scene))

    @property
    def unit(self) -> str:
        """The unit of the margin; "" if there are several."""
        return next(iter(self.units)) if len(self.units) == 1 else ""

    def values(self, scene: Scene) -> dict[str, Any]:
        """Return the values of the quantities in a scene; None for a quantity without a value."""
        found = {}
        for text, function in self.quantities.items():
            try:
                found[text] = plain(function(scene))
            except (NoValue, ArithmeticError, TypeError, ValueError):
                found[text] = None
        return found

    def _refuse(self, cause: str) -> NoReturn:
        raise BadProperty(self.text, cause, self.source)

    def _compile(self, node: ast.expr) -> Function:  # noqa: C901, PLR0911  one case for each allowed node
        match node:
            case ast.Name(id=name):
                self.names[name] = None
                return lambda scene: scene.named(name)
            case ast.Constant(value=str() | bool() | None as value):
                return lambda _: value
            case ast.Constant(value=int() | float() as value):
                number = float(value)  # a power of integers could take hours
                return lambda _: number
            case ast.Tuple(elts=nodes) | ast.List(elts=nodes):
                items = [self._compile(each) for each in nodes]
                return lambda scene: tuple(item(scene) for item in items)
            case ast.BoolOp(op=op, values=nodes):
                operands, choose = [self._compile(each) for each in nodes], min if isinstance(op, ast.And) else max
                return lambda scene: choose([truth(operand(scene)) for operand in operands])
            case ast.UnaryOp(op=op) | ast.BinOp(op=op) if operation := _OPERATIONS.get(type(op)):
                nodes = [node.operand] if isinstance(node, ast.UnaryOp) else [node.left, node.right]
                if not isinstance(op, ast.Not):
                    self._check_numbers(node, nodes)
                operands = [self._compile(each) for each in nodes]
                return lambda scene: operation(*[operand(scene) for operand in operands])
            case ast.Compare():
                return self._comparison(node)
            case ast.Attribute(value=inner, attr=part):
                owner = self._compile(_meant(inner))
                return self._quantity(node, lambda scene: _part(owner(scene), part))
            case ast.Subscript(value=inner, slice=index):
                owner, key = self._compile(_meant(inner)), self._index(node, index)
                return self._quantity(node, lambda scene: _item(owner(scene), key))
            case ast.Call(func=ast.Name(id=name), keywords=[]):
                return self._call(node, name)
            case _:
                return self._refuse(f"{_written(node)} isn't a part of the language")

    def _comparison(self, node: ast.Compare) -> Function:
        nodes = [node.left, *node.comparators]
        terms = [self._compile(each) for each in nodes]
        for (one, other), op in zip(pairwise(nodes), node.ops, strict=True):
            kinds = {_kind(one), _kind(other)} - {""}
            if len(kinds & _BASE) > 1:
                self._refuse(f"{_written(one)} and {_written(other)} have different units")
            for quantity, number in ((one, other), (other, one)):
                if _kind(quantity) in ("rad", "joint"):
                    self._check_angle(number)
            self.units |= kinds & _BASE or {""}
            if isinstance(op, ast.Lt | ast.LtE | ast.Gt | ast.GtE) or any(map(_is_amount, (one, other))):
                self._check_numbers(node, (one, other))
        comparisons = [_COMPARISONS[type(each)] for each in node.ops]

        def compare(scene: Scene) -> Truth:
            values = pairwise([term(scene) for term in terms])
            return min(comparison(a, b) for comparison, (a, b) in zip(comparisons, values, strict=True))

        return compare

    def _check_numbers(self, node: ast.expr, nodes: Iterable[ast.expr]) -> None:
        """Reject calculations with conditions."""
        for each in nodes:
            if isinstance(each, ast.List | ast.Tuple):
                self._check_numbers(node, each.elts)
            elif _is_condition(each):
                count = "count(...) is the number of objects for which a condition holds"
                self._refuse(f"{_written(node)}: {_written(each)} is a condition, not a number; {count}")

    def _check_angle(self, node: ast.expr) -> None:
        """Reject an angle that seems to be in degrees without a unit."""
        if isinstance(node, ast.UnaryOp):
            node = node.operand
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and abs(node.value) > 2 * math.pi:
            number = f"{node.value:g}"
            self._refuse(f"{number} is an angle of more than 2 pi rad; write {number} deg, or {number} rad")

    def _index(self, node: ast.expr, index: ast.expr) -> int | str:
        key = None
        with suppress(ValueError, TypeError):
            key = ast.literal_eval(index)
        if not isinstance(key, int | str):
            self._refuse(f"{_written(node)}: an index is a number, or a name in quotes")
        return key

    def _quantity(self, node: ast.expr, function: Function) -> Function:
        self.quantities.pop(_written(getattr(node, "value", node)), None)  # in lab.milk.z, lab.milk isn't a quantity
        self.quantities[_written(node)] = function
        return function

    def _call(self, node: ast.Call, name: str) -> Function:
        arguments = node.args
        if name == _MEASURED:
            number, unit = map(ast.literal_eval, arguments)
            size = float(number) * UNITS[unit][0]
            return lambda _: size
        if name not in _FUNCTIONS:
            self._refuse(f"there is no function {name}{did_you_mean(name, _FUNCTIONS)}")
        self._check_arguments(node, name, arguments)
        if name in _BY_NAME:
            return self._quantity(node, self._function_of_names(name, [self._name(each) for each in arguments]))
        before = dict(self.quantities)
        terms = [self._compile(_meant(each) if name in _OF_BODIES else each) for each in arguments]
        if name == "upright" and isinstance(arguments[0], ast.Name | ast.Constant) and _has_pattern(arguments[0]):
            pattern = self._name(arguments[0])
            terms[0] = lambda scene: scene.matching(pattern)
        function = _CALLED[name]

        def call(scene: Scene) -> Any:
            return function(*[term(scene) for term in terms])

        if name not in _OF_BODIES and name != "count":
            return call
        self.quantities = before  # a message shows the whole call
        if name != "upright":
            return self._quantity(node, call)
        self.units.add("rad")
        self.quantities[f"tilt({_written(arguments[0])})"] = lambda scene: _tilt(terms[0](scene))
        return call

    def _check_arguments(self, node: ast.expr, name: str, arguments: Sequence[ast.expr]) -> None:
        least, most = _FUNCTIONS[name]
        if not least <= len(arguments) <= most:
            takes = str(least) if least == most else f"{least} to {most}"
            self._refuse(f"{name} takes {takes} argument{'' if takes == '1' else 's'}, not {len(arguments)}")
        for each in arguments[_ANGLES.get(name, 9) :]:
            self._check_angle(each)
        if name in _OF_NUMBERS:
            self._check_numbers(node, () if name == "len" and _is_condition(arguments[0], ("contact",)) else arguments)
        if name == "count" and isinstance(arguments[0], ast.BoolOp | ast.Compare) and _has_pattern(arguments[0]):
            self._refuse(f"{_written(node)}: count takes a single condition with a pattern")

    def _function_of_names(self, name: str, names: list[str]) -> Function:
        self.names |= dict.fromkeys(names)
        if name == "holding":
            return lambda scene: scene.holding(*names)
        self.needs_geometry = True
        self.units.add("m")
        if name == "on":
            return lambda scene: Conditions(touch.on for touch in scene.touches(*names).values())
        pairs = operator.methodcaller("touches", *names)
        return lambda scene: Conditions({frozenset(pair): each.contact for pair, each in pairs(scene).items()}.values())

    def _name(self, node: ast.expr) -> str:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return node.value
        if isinstance(node, ast.Name):
            return node.id
        if not isinstance(node, ast.Attribute):
            self._refuse(f"{_written(node)} isn't a name")
        return f"{self._name(node.value)}.{node.attr}"


def _written(node: ast.expr) -> str:
    return re.sub(rf"{_MEASURED}\(([^,]*), '([\w/]+)'\)", r"\1 \2", ast.unparse(node))


def _meant(node: ast.expr) -> ast.expr:
    """Turn a string that means an object or a world into a name."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return ast.Name(node.value, ast.Load())
    return node


def _is_condition(node: ast.expr, calls: Sequence[str] = ("contact", "on", "upright")) -> bool:
    match node:
        case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
            return len(calls) > 1
        case ast.Call(func=ast.Name(id=name)):
            return name in calls
    return False


def _is_amount(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float) and node.value not in (0, 1)


def _has_pattern(node: ast.expr) -> bool:
    return any(isinstance(each, ast.Constant) and _is_pattern(each.value) for each in ast.walk(node))


def _kind(node: ast.expr) -> str:
    """Return the unit of a quantity: "m", "rad" or "s"; "joint" for a joint; "" if unknown."""
    kind = ""
    match node:
        case ast.Attribute(attr=part):
            kind = _KINDS.get(part, "joint")
        case ast.Call(func=ast.Name(id=name), args=[_, ast.Constant(value=str(unit))]) if name == _MEASURED:
            kind = UNITS[unit][1]
        case ast.Call(func=ast.Name(id="abs" | "min" | "max" | "round"), args=[operand, *_]):
            kind = _kind(operand)
        case ast.Call(func=ast.Name(id=name)):
            kind = _KINDS.get(name, "")
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            kind = _kind(operand)
        case ast.BinOp(op=ast.Add() | ast.Sub(), left=left, right=right):
            kind = _kind(left) or _kind(right)
    return kind


def _part(owner: Any, name: str) -> Any:
    return owner.part(name) if isinstance(owner, BodyQuantities) else _item(owner, name)


def _item(owner: Any, key: int | str) -> Any:
    if isinstance(owner, tuple) and isinstance(key, int) and -len(owner) <= key < len(owner):
        return owner[key]
    if isinstance(key, str) and hasattr(owner, "bodies"):
        found = _find(owner, key)
        if found is None:
            raise NoValue(
                f"no object of this world is called {key}{did_you_mean(key, owner.bodies)}", key, owner.bodies
            )
        return found
    raise NoValue(f"{_described(owner)} has no {key}")


def _described(value: object) -> str:
    return value.name if isinstance(value, BodyQuantities) else str(plain(value))


def _equal(a: Any, b: Any) -> Truth:
    a, b = (truth(value).holds if isinstance(value, Truth | Conditions) else value for value in (a, b))
    a, b = (value.name if isinstance(value, BodyQuantities) else value for value in (a, b))
    if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b) > 0:
        return min(map(_equal, a, b))
    return _at_least(ROUNDING, abs(a - b)) if _is_number(a) and _is_number(b) else truth(a == b)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _difference(a: Any, b: Any) -> Any:
    for value in (a, b):
        if not _is_number(value):
            raise NoValue(f"{_described(value)} isn't a number")
    return a - b


def _at_least(a: Any, b: Any) -> Truth:
    return Truth(_difference(a, b), a >= b)


def _among(value: Any, others: Any) -> Truth:
    if not isinstance(others, tuple) or not others:
        raise NoValue("the operator 'in' needs names in brackets")
    return max(_equal(value, other) for other in others)


_OPERATIONS: Final[Mapping[type, Callable[..., Any]]] = {
    ast.Not: lambda value: (value if isinstance(value, Conditions) else truth(value)).negated(),
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: lambda a, b: float(a) ** float(b),
}
_COMPARISONS: Final[Mapping[type, Callable[[Any, Any], Truth]]] = {
    ast.Lt: lambda a, b: Truth(_difference(b, a), b > a),
    ast.LtE: lambda a, b: _at_least(b, a),
    ast.Gt: lambda a, b: Truth(_difference(a, b), a > b),
    ast.GtE: _at_least,
    ast.Eq: _equal,
    ast.Is: _equal,
    ast.NotEq: lambda a, b: _equal(a, b).negated(),
    ast.IsNot: lambda a, b: _equal(a, b).negated(),
    ast.In: _among,
    ast.NotIn: lambda a, b: _among(a, b).negated(),
}


def _point(value: Any) -> Sequence[float]:
    if isinstance(value, BodyQuantities):
        position: Sequence[float] = value.part("position")
        return position
    if isinstance(value, tuple) and len(value) == 3 and all(map(_is_number, value)):
        return value
    raise NoValue(f"{_described(value)} is neither an object nor a point [x, y, z]")


def _angle(a: Any, b: Any) -> float:
    """Return the angle in rad between two angles, or between the orientations of two bodies."""
    if isinstance(a, BodyQuantities) and isinstance(b, BodyQuantities):
        return geometry.angle(a.part("orientation"), b.part("orientation"))
    return abs(math.remainder(a - b, 2 * math.pi))


def _body(value: Any) -> BodyQuantities:
    if not isinstance(value, BodyQuantities):
        raise NoValue(f"{_described(value)} isn't an object")
    return value


def _tilt(value: Any) -> Any:
    return tuple(each.tilt for each in value) if isinstance(value, list) else _body(value).tilt


def _upright(value: Any, tolerance: float = _UPRIGHT) -> Truth | Conditions:
    if isinstance(value, list):
        return Conditions(_at_least(tolerance, each.tilt) for each in value)
    return _at_least(tolerance, _tilt(value))


def _count(value: Any) -> int:
    """Return how many objects of a pattern, or elements of a list, fulfil their condition."""
    each = value.truths if isinstance(value, Conditions) else value if isinstance(value, tuple) else (value,)
    return sum(truth(one).holds for one in each)


_CALLED: Final[Mapping[str, Callable[..., Any]]] = {
    **{each.__name__: each for each in (abs, len, max, min, round, sum)},
    "sqrt": math.sqrt,
    "degrees": math.degrees,
    "count": _count,
    "distance": lambda a, b: math.dist(_point(a), _point(b)),
    "angle": _angle,
    "tilt": _tilt,
    "upright": _upright,
}
#: Minimum and maximum number of arguments of each function.
_FUNCTIONS: Final = {
    **dict.fromkeys(_CALLED, (1, 1)),
    **dict.fromkeys(("distance", "angle", "contact", "on"), (2, 2)),
    **dict.fromkeys(("min", "max"), (1, 9)),
    "upright": (1, 2),
    "holding": (0, 1),
}
_BY_NAME: Final = ("holding", "contact", "on")  # functions of names
_OF_NUMBERS: Final = ("abs", "round", "sum", "len", "sqrt", "degrees")
_ANGLES: Final = {"upright": 1, "angle": 0}  # index of the first angle among the arguments
_OF_BODIES: Final = ("distance", "angle", "tilt", "upright")  # in these functions, a text means an object
