"""Expressions about one state, such as ``milk.z > 0.5`` or ``holding(left) is milk``.

Python's parser reads them, but they are never executed: each node of the syntax tree that is allowed here becomes a
function of a :class:`Scene`. Names are bodies (``robot`` is the plan's robot), worlds, and the robot's arms. If several
worlds have a body of this name, the name means the body in the world that was opened last; ``lab.milk`` means the body
in the world ``lab``. Write a name that isn't an identifier in quotes: ``'milk carton'.z``, ``lab['milk carton'].z``.

A condition has a margin: the smallest distance of its quantities from values that would change the answer. The margin
is positive, or 0, if the condition holds. Conditions about names have an infinite margin.
"""

from __future__ import annotations

import ast
import math
import re
import tomllib
import warnings
from fnmatch import fnmatchcase
from functools import cache, cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn, Protocol, TypeAlias

from recorder import geometry
from recorder.errors import PortableError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from recorder.records.fold import FoldedWorld

    Function: TypeAlias = "Callable[[Scene], Any]"

UNITS: Final[Mapping[str, tuple[float, str]]] = {
    "m": (1.0, "m"),
    "cm": (0.01, "m"),
    "mm": (0.001, "m"),
    "rad": (1.0, "rad"),
    "deg": (math.pi / 180, "rad"),
    "s": (1.0, "s"),
    "ms": (0.001, "s"),
    "min": (60.0, "s"),
}
"""Units of numbers: their size in m, rad or s, and which of these three it is."""
NUMBER: Final = r"(?:\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)"
RANGE: Final = 0.05
"""m; contacts are measured up to this distance, which is thus the largest margin of "no contact"."""
ROUNDING: Final = 1e-6
"""Numbers that differ by less are equal."""

_QUANTITY: Final = re.compile(rf"(?<![\w.])({NUMBER})\s*({'|'.join(sorted(UNITS, key=len, reverse=True))})\b(?!\s*\()")
_STRINGS: Final = re.compile(r"""('(?:[^'\\\n]|\\.)*'|"(?:[^"\\\n]|\\.)*")""")
_MEASURED: Final = "_measured"  # stands in the syntax tree for a number with a unit
_UPRIGHT: Final = math.radians(10)  # rad, default tolerance
PARTS: Final = ("x", "y", "z", "position", "orientation", "velocity", "speed", "roll", "pitch", "yaw", "carrier")
"""Quantities of a body; its joints are quantities, too."""
_KINDS: Final = {
    **dict.fromkeys(("x", "y", "z", "distance"), "m"),
    **dict.fromkeys(("roll", "pitch", "yaw", "tilt", "angle"), "rad"),
    **dict.fromkeys(("speed", "position", "orientation", "velocity", "carrier"), ""),
}
"""Units of quantities; all others are joints."""
_MAX_LENGTH: Final = 2000  # characters; Python's parser fails on deeper nesting than such a text has


class BadProperty(PortableError, ValueError):
    """A text isn't a property, or a part of it isn't in the language."""

    def __init__(self, text: str, cause: str, source: str = "") -> None:
        super().__init__(f"{source}{': ' if source else ''}{text}: {cause}")
        self.text = text
        self.cause = cause
        self.source = source  # file and line; "" outside of files


class NoValue(LookupError):
    """An expression has no value in a state, for example before its object is loaded."""

    def __init__(self, cause: str, name: str = "", known: Iterable[str] = ()) -> None:
        super().__init__(cause)
        self.name = name  # the unknown name; "" for other causes
        self.known = tuple(known)  # the known names


class Truth(NamedTuple):
    """Whether a condition holds, and by which margin."""

    margin: float
    holds: bool

    def negated(self) -> Truth:
        """Return the opposite."""
        return Truth(-self.margin, not self.holds)


class Touch(NamedTuple):
    """Whether two bodies touch; if they don't, margins are distances in m, at most RANGE."""

    contact: Truth
    on: Truth  # whether the first lies on the second


class Geometry(Protocol):
    """Measures distances between bodies, which needs their shapes."""

    def touch(self, world: FoldedWorld, one: tuple[str, str], other: tuple[str, str]) -> Touch:
        """Return the nearest points of two bodies in RANGE; each has a name and a link ("" for all links)."""

    def owner(self, world: FoldedWorld, link: str) -> str:
        """Return the body with a link of this name; "" if no body has it."""


class Scene:
    """The present state of all worlds, in which names have values."""

    def __init__(self, worlds: Mapping[str, FoldedWorld], geometry: Geometry | None = None) -> None:
        self.worlds = worlds
        self.geometry = geometry

    def opened(self) -> list[FoldedWorld]:
        """Return the open worlds, the last opened first."""
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
        """Return the name of the object that the robot holds, like the fluent ``holding``."""
        opened = self.opened()
        world = next((each for each in opened if each.robot in each.bodies), opened[0])
        links = None
        if arm is not None:
            arms = _arms(world)
            if arm not in arms:
                raise NoValue(f"no arm is called {arm}{did_you_mean(arm, arms)}", arm, arms)
            links = arms[arm]
        for held in world.attachments.values():
            if held.carrier == world.robot and (links is None or held.carrier_link in links):
                return held.body
        return None

    def touches(self, one: str, other: str) -> Contacts:
        """Return the nearest points of all pairs of bodies. Bodies are named with ``*``, by BODY.LINK, or by a link."""
        if self.geometry is None:
            raise NoValue("contacts need the executor")
        for world in self.opened():
            first, second = (list(self._matching(world, self.geometry, name)) for name in (one, other))
            if first and second:
                pairs = {(a, b): None for a in first for b in second if a[0] != b[0] and (b, a) != (a, b)}
                return Contacts({pair: self.geometry.touch(world, *pair) for pair in pairs})
        for name in (one, other):
            if "*" not in name:
                self.named(name)
        raise NoValue(f"no objects are called {one} and {other}")

    @staticmethod
    def _matching(world: FoldedWorld, geometry: Geometry, name: str) -> Iterator[tuple[str, str]]:
        if "*" in name or "?" in name:
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


class Contacts:
    """The nearest points of pairs of bodies."""

    def __init__(self, pairs: Mapping[tuple[tuple[str, str], tuple[str, str]], Touch]) -> None:
        self.touching = [f"{a[0]} and {b[0]}" for (a, b), touch in pairs.items() if touch.contact.holds]
        self.truth = max((touch.contact for touch in pairs.values()), default=Truth(-RANGE, False))
        self.on = max((touch.on for touch in pairs.values()), default=Truth(-RANGE, False))

    def __len__(self) -> int:
        return len(self.touching)


class BodyQuantities:
    """A body of a world, with its quantities as attributes."""

    __slots__ = ("_body", "_world", "name")

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
        """The angle in rad between the body's vertical axis and the world's vertical axis."""
        return geometry.lean(geometry.IDENTITY[1], self._body.orientation)


@cache
def _identifier(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _find(world: FoldedWorld, name: str) -> BodyQuantities | str | None:
    """Return a body, the robot or the name of an arm; None for an unknown name."""
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
    """Return the links of each arm's hand, by the names of the arms in a robot's description."""
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
    if isinstance(value, Truth):
        return value.holds
    if isinstance(value, Contacts):
        return bool(value.touching)
    if not isinstance(value, str | int | float | tuple | None):
        raise NoValue("a world has no value; name a body of the world")
    return value


def truth(value: object) -> Truth:
    """Return the truth of a value. A value that isn't a condition is true as in Python, with an infinite margin."""
    if isinstance(value, Truth):
        return value
    if isinstance(value, Contacts):
        return value.truth
    return Truth(math.inf, True) if value else Truth(-math.inf, False)


class PropertyExpression:
    """A compiled expression; ``source`` is the property's file and line.

    Raises:
        BadProperty: the text has something that the language lacks.
    """

    def __init__(self, text: str, source: str = "") -> None:
        self.text = " ".join(text.split())
        self.source = source
        self.quantities: dict[str, Function] = {}  # functions by texts of parts and calls; these contain no others
        self.units: set[str] = set()  # units of its comparisons
        self.names: dict[str, None] = {}  # names of objects, arms and worlds
        self.needs_geometry = False
        if len(text) > _MAX_LENGTH:
            self._refuse(f"it is longer than {_MAX_LENGTH} characters")
        parts = _STRINGS.split(text.strip())
        parts[::2] = [_QUANTITY.sub(rf'{_MEASURED}(\1,"\2")', part) for part in parts[::2]]
        try:
            with warnings.catch_warnings(action="ignore"):  # Python warns about text that looks like mistaken code
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
        """The unit of the margin; "" if its comparisons have several units."""
        return next(iter(self.units)) if len(self.units) == 1 else ""

    def values(self, scene: Scene) -> dict[str, Any]:
        """Return the values of its quantities in a scene."""
        found = {}
        for text, function in self.quantities.items():
            try:
                found[text] = plain(function(scene))
            except (NoValue, ArithmeticError, TypeError, ValueError):
                found[text] = None
        return found

    def _refuse(self, cause: str) -> NoReturn:
        raise BadProperty(self.text, cause, self.source)

    def _refuse_node(self, node: ast.expr) -> NoReturn:
        self._refuse(f"{_written(node)} isn't a part of the language")

    # --- the allowed nodes --------------------------------------------------------------------------------------------

    def _compile(self, node: ast.expr) -> Function:
        return (self._compilers.get(type(node)) or self._refuse_node(node))(node)

    @cached_property
    def _compilers(self) -> Mapping[type, Callable[[Any], Function]]:
        return {
            ast.BoolOp: self._logic,
            ast.UnaryOp: self._unary,
            ast.BinOp: self._arithmetic,
            ast.Compare: self._comparison,
            ast.Call: self._call,
            ast.Attribute: self._attribute,
            ast.Subscript: self._subscript,
            ast.Name: self._object,
            ast.Constant: self._constant,
            ast.Tuple: self._tuple,
            ast.List: self._tuple,
        }

    def _object(self, node: ast.Name) -> Function:
        self.names[node.id] = None
        return lambda scene: scene.named(node.id)

    def _constant(self, node: ast.Constant) -> Function:
        value = node.value
        if isinstance(value, str) or value is None or isinstance(value, bool):
            return lambda _: value
        if not isinstance(value, int | float):
            self._refuse_node(node)
        number = float(value)  # powers of integers could take hours
        return lambda _: number

    def _tuple(self, node: ast.Tuple | ast.List) -> Function:
        items = [self._compile(each) for each in node.elts]
        return lambda scene: tuple(item(scene) for item in items)

    def _logic(self, node: ast.BoolOp) -> Function:
        operands = [self._compile(each) for each in node.values]
        choose = min if isinstance(node.op, ast.And) else max
        return lambda scene: choose([truth(operand(scene)) for operand in operands])

    def _unary(self, node: ast.UnaryOp) -> Function:
        operand = self._compile(node.operand)
        operation = _UNARY.get(type(node.op)) or self._refuse_node(node)
        return lambda scene: operation(operand(scene))

    def _arithmetic(self, node: ast.BinOp) -> Function:
        operation = _OPERATIONS.get(type(node.op)) or self._refuse_node(node)
        left, right = self._compile(node.left), self._compile(node.right)
        return lambda scene: operation(left(scene), right(scene))

    def _comparison(self, node: ast.Compare) -> Function:
        nodes = [node.left, *node.comparators]
        terms = [self._compile(each) for each in nodes]
        for one, other in pairwise(nodes):
            self._check_kinds(one, other)
        comparisons = [_COMPARISONS[type(each)] for each in node.ops]

        def compare(scene: Scene) -> Truth:
            values = pairwise([term(scene) for term in terms])
            return min(comparison(a, b) for comparison, (a, b) in zip(comparisons, values, strict=True))

        return compare

    def _check_kinds(self, one: ast.expr, other: ast.expr) -> None:
        kinds = {_kind(one), _kind(other)} - {""}
        if len(kinds & {"m", "rad", "s"}) > 1:
            self._refuse(f"{_written(one)} and {_written(other)} have different units")
        for quantity, number in ((one, other), (other, one)):
            if _kind(quantity) in ("rad", "joint"):
                self._check_angle(number)
        self.units |= kinds & {"m", "rad", "s"} or {""}

    def _check_angle(self, node: ast.expr) -> None:
        """Refuse an angle in degrees without a unit."""
        if isinstance(node, ast.UnaryOp):
            node = node.operand
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and abs(node.value) > 2 * math.pi:
            number = f"{node.value:g}"
            self._refuse(f"{number} is an angle of more than 2 pi rad; write {number} deg, or {number} rad")

    def _attribute(self, node: ast.Attribute) -> Function:
        owner, part = self._compile(_meant(node.value)), node.attr
        return self._quantity(node, lambda scene: _part(owner(scene), part))

    def _subscript(self, node: ast.Subscript) -> Function:
        owner, index = self._compile(_meant(node.value)), node.slice
        if (
            isinstance(index, ast.UnaryOp)
            and isinstance(index.op, ast.USub)
            and isinstance(index.operand, ast.Constant)
        ):
            index = ast.Constant(-index.operand.value if isinstance(index.operand.value, int) else None)
        if not isinstance(index, ast.Constant) or not isinstance(index.value, int | str):
            self._refuse(f"{_written(node)}: an index is a number, or a name in quotes")
        key = index.value
        return self._quantity(node, lambda scene: _item(owner(scene), key))

    def _quantity(self, node: ast.expr, function: Function) -> Function:
        self.quantities.pop(_written(getattr(node, "value", node)), None)  # lab.milk isn't a quantity of lab.milk.z
        self.quantities[_written(node)] = function
        return function

    def _call(self, node: ast.Call) -> Function:
        if not isinstance(node.func, ast.Name) or node.keywords:
            self._refuse_node(node)
        name, arguments = node.func.id, node.args
        if name == _MEASURED:
            size = _size(node)
            return lambda _: size
        if name not in _FUNCTIONS:
            self._refuse(f"there is no function {name}{did_you_mean(name, _FUNCTIONS)}")
        least, most = _FUNCTIONS[name]
        if not least <= len(arguments) <= most:
            takes = str(least) if least == most else f"{least} to {most}"
            self._refuse(f"{name} takes {takes} argument{'' if takes == '1' else 's'}, not {len(arguments)}")
        if name in _BY_NAME:
            return self._call_by_name(node, name, [self._name(each) for each in arguments])
        for each in arguments[_ANGLES.get(name, 9) :]:
            self._check_angle(each)
        before = dict(self.quantities)
        terms = [self._compile(_meant(each) if name in _OF_BODIES else each) for each in arguments]
        function = _CALLED[name]

        def call(scene: Scene) -> Any:
            return function(*[term(scene) for term in terms])

        if name not in _OF_BODIES and name != "count":
            return call
        self.quantities = before  # the call is shown as a whole
        if name != "upright":
            return self._quantity(node, call)
        self.units.add("rad")
        self.quantities[f"tilt({_written(arguments[0])})"] = lambda scene: _body(terms[0](scene)).tilt
        return call

    def _call_by_name(self, node: ast.Call, name: str, names: list[str]) -> Function:
        self.names |= dict.fromkeys(names)
        if name == "holding":
            return self._quantity(node, lambda scene: scene.holding(*names))
        self.needs_geometry = True
        self.units.add("m")
        if name == "on":
            return self._quantity(node, lambda scene: scene.touches(*names).on)
        return self._quantity(node, lambda scene: scene.touches(*names))

    def _name(self, node: ast.expr) -> str:
        """Return an argument as a name."""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return node.value
        if isinstance(node, ast.Name):
            return node.id
        if not isinstance(node, ast.Attribute):
            self._refuse(f"{_written(node)} isn't a name")
        return f"{self._name(node.value)}.{node.attr}"


def _written(node: ast.expr) -> str:
    text = ast.unparse(node)
    return re.sub(rf"{_MEASURED}\(([^,]*), '(\w+)'\)", r"\1 \2", text)


def _meant(node: ast.expr) -> ast.expr:
    """Turn a string into a name where an object or a world is meant."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return ast.Name(node.value, ast.Load())
    return node


def _size(node: ast.Call) -> float:
    number, unit = (each.value if isinstance(each, ast.Constant) else None for each in node.args)
    return float(number) * UNITS[str(unit)][0]  # type: ignore[arg-type]  # the pattern's number


def _kind(node: ast.expr) -> str:
    """Return the unit of a quantity: "m", "rad" or "s"; "joint" for "m" or "rad" (unknown which); "" if unknown."""
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


# --- values -----------------------------------------------------------------------------------------------------------


def _part(owner: Any, name: str) -> Any:
    if isinstance(owner, BodyQuantities):
        return owner.part(name)
    return _item(owner, name)


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


def _compared(value: Any) -> Any:
    """Return a value in the form that ``is`` compares: the name of a body, and whether a condition holds."""
    if isinstance(value, Truth | Contacts):
        return truth(value).holds
    return value.name if isinstance(value, BodyQuantities) else value


def _equal(a: Any, b: Any) -> Truth:
    a, b = _compared(a), _compared(b)
    if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b) > 0:
        return min(map(_equal, a, b))
    if _is_number(a) and _is_number(b):
        return _at_least(ROUNDING, abs(a - b))
    return truth(a == b)


def _at_least(a: Any, b: Any) -> Truth:
    _check_numbers(a, b)
    return Truth(a - b, a >= b)


def _more(a: Any, b: Any) -> Truth:
    _check_numbers(a, b)
    return Truth(a - b, a > b)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check_numbers(*values: object) -> None:
    for value in values:
        if not _is_number(value):
            raise NoValue(f"{_described(value)} isn't a number")


def _among(value: Any, others: Any) -> Truth:
    if not isinstance(others, tuple) or not others:
        raise NoValue("in needs names in brackets")
    return max(_equal(value, other) for other in others)


_UNARY: Final[Mapping[type, Callable[[Any], Any]]] = {
    ast.Not: lambda value: truth(value).negated(),
    ast.USub: lambda value: -value,
    ast.UAdd: lambda value: +value,
}
_OPERATIONS: Final[Mapping[type, Callable[[Any, Any], Any]]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: float(a) ** float(b),
}
_COMPARISONS: Final[Mapping[type, Callable[[Any, Any], Truth]]] = {
    ast.Lt: lambda a, b: _more(b, a),
    ast.LtE: lambda a, b: _at_least(b, a),
    ast.Gt: _more,
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
        return value.part("position")  # type: ignore[no-any-return]
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


def _count(value: Any) -> int:
    return len(value) if isinstance(value, Contacts | tuple) else int(truth(value).holds)


_CALLED: Final[Mapping[str, Callable[..., Any]]] = {
    **{each.__name__: each for each in (abs, len, max, min, round, sum)},
    "sqrt": math.sqrt,
    "degrees": math.degrees,
    "count": _count,
    "distance": lambda a, b: math.dist(_point(a), _point(b)),
    "angle": _angle,
    "tilt": lambda body: _body(body).tilt,
    "upright": lambda body, tolerance=_UPRIGHT: _at_least(tolerance, _body(body).tilt),
}
#: Smallest and largest numbers of arguments.
_FUNCTIONS: Final = {
    **dict.fromkeys(_CALLED, (1, 1)),
    "distance": (2, 2),
    "angle": (2, 2),
    "upright": (1, 2),
    "min": (1, 9),
    "max": (1, 9),
    "holding": (0, 1),
    "contact": (2, 2),
    "on": (2, 2),
}
_BY_NAME: Final = ("holding", "contact", "on")  # functions of names
_ANGLES: Final = {"upright": 1, "angle": 0}  # functions of angles, and the index of their first angle
_OF_BODIES: Final = ("distance", "angle", "tilt", "upright")  # functions that take a text as the name of an object
