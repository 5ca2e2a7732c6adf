"""The syntax tree of a plan, with facts for edits: which names have the same role, and what stays unchanged."""

from __future__ import annotations

import ast
import builtins
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Final, NamedTuple

from recorder.plan_lines import called_name, stored, written_number

_CHECKING: Final = ("print", "monitored")  # their arguments have no effect on the world
#: Functions and methods that change the world or a container, and that read the state of the world.
_ACTING: Final = re.compile(
    "perform|simulate|settle|wait_for|attach|detach|Object|BulletWorld|set_.*"
    "|append|add|extend|insert|pop|remove|update|clear"
)
#: An attribute that a class stores, declares or computes.
_FIELD: Final = re.compile(r"\bself\.(\w+)(?=[^=\n]* [-+*/]?= )|^ +(\w+): \w|@property\s+def (\w+)", re.MULTILINE)
READING: Final = re.compile("get_.*|.*(pose|position).*")
_GRAVITY: Final = 9.0
Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


class Change(NamedTuple):
    """New texts at places of the source."""

    what: str  # the change, in words
    cost: float
    parts: tuple[tuple[ast.AST | tuple[int, int], str], ...]  # nodes, or places in bytes
    asks: bool = False  # whether a value or name changes, rather than how values are computed
    chance: bool = False  # whether only the success of the run supports it
    kind: str = ""  # name of the operator


def instead(node: ast.AST, new: str, cost: float, what: str = "", asks: bool = False, chance: bool = False) -> Change:
    """Return the change of a node's text."""
    return Change(what or f"{new} instead of {ast.unparse(node)}", cost, ((node, new),), asks, chance)


class PlanSyntax:
    """Facts about one source file."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.source = text.encode()  # the syntax tree counts bytes
        self.lines = [line.decode() for line in self.source.splitlines(keepends=True)]
        self.tree = ast.parse(text)
        self.nodes = [*ast.walk(self.tree)]  # outer nodes first
        self.parents = {child: node for node in self.nodes for child in ast.iter_child_nodes(node)}
        self.strings: dict[str, set[str]] = defaultdict(set)  # string constants by their role
        self.names: dict[str, set[str]] = defaultdict(set)  # variables by the call that returned their value
        self.goals: set[ast.AST] = set()  # assertions and what only they need; they stay unchanged
        self.counts: set[ast.AST] = set()  # expressions that count or number something, such as indices
        self.scene: set[ast.AST] = set()  # arguments of loaded objects; which objects there are stays unchanged
        self.functions = {node.name: node for node in self.nodes if isinstance(node, ast.FunctionDef)}
        self.parameters = {  # their names, besides the object of a method
            name: [each.arg for each in node.args.args if each.arg != "self"] for name, node in self.functions.items()
        }
        self.checks = {name for name, node in self.functions.items() if any(map(asserts, ast.walk(node)))}
        self.called = {node.func for node in self.nodes if isinstance(node, ast.Call)}
        self.constants: set[str] = set()  # variables with a written container
        self.fixed: set[str] = set()  # names of robots and environments, and their variables
        self.forgotten: set[str] = set()  # names and types of loaded objects without a use
        self.unused: set[str] = set()  # names that the plan defines, but doesn't use for an effect
        self.roles: dict[ast.AST, list[str]] = defaultdict(list)  # roles of expressions
        self.forms: dict[str, set[str]] = defaultdict(set)  # functions that convert the constants in a role
        self.literals: dict[str, str] = {}  # types of variables with a list, a dictionary or a set
        #: Numbers that may be lengths and angles, without signs; gravity is none of these.
        self.numbers = [each for each in map(written_number, self.nodes) if each and not _GRAVITY < each < _GRAVITY + 1]
        #: Lists of numbers, the last first.
        self.lists = [(node, numbers) for node in self.nodes[::-1] if (numbers := written_numbers(node))]
        #: Places on the floor, as those of robots.
        self.bases = [numbers for _, numbers in self.lists if len(numbers) == 3 and any(numbers) and not numbers[2]]
        fours = (each for each in self.lists if len(each[1]) == 4 and round(math.hypot(*each[1]), 1) == 1)
        self.turns = {each for node, _ in fours for each in ast.walk(node)}  # numbers of quaternions
        self.defined = {each.asname or each.name for each in self.nodes if isinstance(each, ast.alias)}
        named = (getattr(node, "name", "") for node in self.nodes)  # functions, classes and caught errors
        self.known = self.defined.union(named, vars(builtins))  # names that have a value, besides local ones
        self.local: dict[ast.AST, set[str]] = defaultdict(set)  # names by the scope that assigns them
        returns = (each for each in self.nodes if isinstance(each, ast.Return | ast.Yield) and each.value)
        self.returning = {getattr(self.scope(each), "name", "") for each in returns}  # functions with a result
        self.generators = {getattr(self.scope(each), "name", "") for each in self.nodes if isinstance(each, ast.Yield)}
        classes = (self.segment(each) for each in self.nodes if isinstance(each, ast.ClassDef))
        self.classes = [{*chain(*re.findall(_FIELD, each))} - {""} for each in classes]  # attributes of each class
        stores = {each.attr for each in self.nodes if isinstance(each, ast.Attribute) and not _loads(each)}
        self.fields = stores.union(*self.classes)  # attributes that classes store or compute
        self.words = re.findall(r"""(?<=["'])\w+(?=["'])|\b\w+(?==[^=])""", text)  # texts and keywords
        for node in self.nodes:
            self._note(node)
            if isinstance(node, ast.Call) and called_name(node) == "Object":
                self._note_object(node)
            for role, value in _roles(node):
                self.roles[value].append(role)
                if isinstance(value, ast.Call) and [*map(type, value.args)] == [ast.Constant] and not value.keywords:
                    self.forms[role].add(ast.unparse(value.func))
                if isinstance(value, ast.Constant) and isinstance(value.value, str):
                    self.strings[role].add(value.value)
                if isinstance(value, ast.Name):
                    self.names[role].add(value.id)
        self._protect_measurements()

    def _note(self, node: ast.AST) -> None:
        """Note the expressions that keep their value, the numbers that count something, and names in the same role."""
        match node:
            case ast.Subscript() | ast.BinOp() | ast.Compare() | ast.Slice():
                self.counts |= {*ast.iter_child_nodes(node)}
            case ast.Call():
                name = ast.unparse(node.func)
                self.counts |= {*node.args} if name in ("range", "enumerate") else set()
                self.scene |= {*ast.walk(node)} if name.endswith("Object") else set()
                self.goals |= {*ast.walk(node)} if name in _CHECKING else set()
            case ast.Dict(keys) if len({ast.dump(key) for key in keys if key}) == len(keys):
                self.scene |= {*filter(None, keys)}  # a key that stands there twice may be wrong
            case ast.Constant(value) if str(value).endswith((".stl", ".urdf", ".obj", ".dae")):
                self.scene.add(node)
            case ast.If() if any(map(asserts, (*node.body, *node.orelse))):
                self.goals |= {node, *ast.walk(node.test)}
            case ast.Assert() | ast.Raise():
                self.goals |= {*ast.walk(node)}
            case ast.withitem(ast.Call(function)) | ast.Assign(value=ast.Call(function)):
                self.names[ast.unparse(function)] |= stored(node)
            case ast.Assign(value=ast.List() | ast.Tuple() | ast.Dict() | ast.Set() as value):
                self.names[_shape(value)] |= stored(node)
                self.constants |= stored(node)
                kind = type(value).__name__.lower()
                self.literals |= {} if kind == "tuple" else dict.fromkeys(stored(node), kind)
            case ast.Name(name, ast.Store()) | ast.arg(name):
                self.local[self.scope(node)].add(name)

    def _note_object(self, node: ast.Call) -> None:
        """Note whether a loaded object is fixed, or has no variable."""
        texts = {str(each.value) for each in node.args[:2] if isinstance(each, ast.Constant)}
        parent = self.parents[node]
        if not texts.isdisjoint(("environment", "robot")):
            self.fixed |= texts | (stored(parent) if isinstance(parent, ast.Assign) else set())
        elif isinstance(parent, ast.Expr):
            self.forgotten |= texts

    def span(self, first: ast.AST, last: ast.AST) -> tuple[int, int]:
        """Return the place of some nodes in the source, in bytes."""
        return self.offset(first.lineno, first.col_offset), self.offset(last.end_lineno, last.end_col_offset)  # type: ignore[attr-defined]

    def segment(self, first: ast.AST, last: ast.AST | None = None) -> str:
        """Return the text of some nodes."""
        start, end = self.span(first, last or first)
        return self.source[start:end].decode()

    def replaced(self, parts: Iterable[tuple[ast.AST | tuple[int, int], str]], within: ast.AST | None = None) -> str:
        """Return the source, or the text of a node, with other texts at some places."""
        source = self.source
        start, end = (0, len(source)) if within is None else self.span(within, within)
        end -= len(source)
        places = ((each if isinstance(each, tuple) else self.span(each, each), new) for each, new in parts)
        for (first, last), new in sorted(places, reverse=True):
            source = source[:first] + new.encode() + source[last:]
        return source[start : len(source) + end].decode()

    def offset(self, line: int, column: int = 0) -> int:
        """Return the place of a line, or a column in bytes in it, in the source."""
        return len("".join(self.lines[: line - 1]).encode()) + column

    def around(self, node: ast.AST) -> Iterator[ast.AST]:
        """Yield the nodes around a node, inner nodes first."""
        while node in self.parents:
            node = self.parents[node]
            yield node

    def scope(self, node: ast.AST) -> ast.AST:
        """Return the function around a node, or the module."""
        return next((each for each in self.around(node) if isinstance(each, Function)), self.tree)

    def in_loop(self, node: ast.AST) -> bool:
        """Return whether a statement belongs to a loop of its function."""
        kinds = (each for each in self.around(node) if isinstance(each, ast.For | ast.While | Function))
        return isinstance(next(kinds, None), ast.For | ast.While)

    def block(self, statement: ast.AST) -> list[ast.stmt]:
        """Return the statements of a statement's block."""
        fields = [value for _, value in ast.iter_fields(self.parents.get(statement, self.tree))]
        return next((each for each in fields if isinstance(each, list) and statement in each), [])

    def later(self, node: ast.AST) -> set[str]:
        """Return the local names of a node's function that have no value yet at the node."""
        names = [each for each in ast.walk(self.scope(node)) if isinstance(each, ast.Name | ast.arg)][::-1]
        lines = {getattr(each, "id", "") or each.arg: each.lineno for each in names if not _loads(each)}  # type: ignore[union-attr]
        return {name for name, line in lines.items() if line >= node.lineno}  # type: ignore[attr-defined]

    def acts(self, node: ast.AST, what: re.Pattern[str] = _ACTING, seen: tuple[str, ...] = ()) -> bool:
        """Return whether a node calls something that changes the world or a container, or other functions."""
        names = {*map(called_name, ast.walk(node))}
        inner = ((self.functions[name], what, (*seen, name)) for name in names - {*seen} if name in self.functions)
        return any(map(what.fullmatch, names)) or any(self.acts(*each) for each in inner)

    def _protect_measurements(self) -> None:
        """Protect the statements whose values only assertions, properties and printed texts use."""
        homes: dict[ast.AST, tuple[ast.AST, str]] = {}  # the scopes that assign names, with the names
        for name in (node for node in self.nodes if isinstance(node, ast.Name)):
            scopes = (each for each in self.around(name) if isinstance(each, Function) and name.id in self.local[each])
            homes[name] = next(scopes, self.tree), name.id
        loaded = {home for node, home in homes.items() if _loads(node)}
        before = -1
        while before < len(self.goals):
            before = len(self.goals)
            used = {home for node, home in homes.items() if _loads(node) and node not in self.goals}
            for node in (each for each in self.nodes if each not in self.goals):
                if isinstance(node, ast.For | ast.If | ast.While):
                    measures = all(each in self.goals for each in (*node.body, *node.orelse))
                elif isinstance(node, ast.Expr):
                    measures = called_name(node.value) in _CHECKING
                elif isinstance(node, ast.Assign | ast.AnnAssign | ast.FunctionDef):
                    made = {homes[each] for each in ast.walk(node) if each in homes and not _loads(each)}
                    if isinstance(node, ast.FunctionDef):
                        made = {(self.scope(node), node.name)}
                    targets = [*getattr(node, "targets", [getattr(node, "target", None)])]
                    stores = any(isinstance(each, ast.Attribute | ast.Subscript) for each in targets)
                    measures = bool(made) and made <= loaded - used and not stores and not self.acts(node)
                else:
                    continue
                self.goals |= {*ast.walk(node)} if measures else set()
        attributes = {node.attr for node in self.nodes if isinstance(node, ast.Attribute) and _loads(node)}
        methods = {name for name, node in self.functions.items() if isinstance(self.parents[node], ast.ClassDef)}
        variables = {name for scope, names in self.local.items() for name in names if (scope, name) not in used}
        functions = {name for name in {*self.functions} - methods if (self.tree, name) not in used}
        texts = (node for node in self.nodes if isinstance(node, ast.Constant) and node not in self.scene)
        self.forgotten -= {node.value for node in texts if isinstance(node.value, str)}
        self.unused = (variables | functions | self.forgotten | (methods - attributes)) - {"_"} - self.fixed


def asserts(node: ast.AST) -> bool:
    """Return whether a node is an assertion."""
    return isinstance(node, ast.Assert | ast.Raise)


def written_numbers(node: ast.AST) -> list[float]:
    """Return the numbers of a list that has only numbers; [] for another node."""
    items = node.elts if isinstance(node, ast.List) else []
    pairs = [(each, written_number(getattr(each, "operand", each))) for each in items]
    found = [-value if isinstance(each, ast.UnaryOp) else value for each, value in pairs if value is not None]
    return found if len(found) == len(items) else []


def loads(node: ast.AST, names: set[str]) -> bool:
    """Return whether a node uses one of some variables."""
    return any(isinstance(each, ast.Name) and _loads(each) and each.id in names for each in ast.walk(node))


def _loads(node: ast.AST) -> bool:
    return isinstance(getattr(node, "ctx", None), ast.Load)


def _shape(node: ast.expr) -> str:
    """Return the types of a container and its items."""
    items = getattr(node, "elts", None)
    return f"{type(node).__name__}({', '.join(map(_shape, items))})" if items is not None else "."


def _roles(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield expressions with their roles: the keyword or the place of an argument, the key or place in a container."""
    match node:
        case ast.Call(function, values, keywords):
            yield from ((keyword.arg, keyword.value) for keyword in keywords if keyword.arg)
            yield from ((f"{ast.unparse(function)} {at}", value) for at, value in enumerate(values))
        case ast.Dict(keys, values):
            pairs = zip(keys, values, strict=True)
            yield from ((f"{{}} {key.value!r}", value) for key, value in pairs if isinstance(key, ast.Constant))
            roles = (f"keys of line {node.lineno}", "a key")
            yield from ((role, key) for key in keys if key is not None for role in roles)
        case ast.Subscript(_, ast.Constant(str()) as key):
            yield "a key", key
        case ast.List(items) | ast.Tuple(items):
            yield from ((f"items of line {node.lineno}", value) for value in items)
