"""Which failures functions may raise, read off their source: what they and all that they call make of a class.

Calls are followed by name: of functions and classes as their modules know them, of methods and properties in all classes
of the rooms below that have one of that name. What is caught and forgotten isn't raised. So a failure that a process module
may raise is among those found, and one that nothing it calls makes any more isn't.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import textwrap
from functools import cache
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Final, TypeAlias

import pycram.models
import pycram.motions
import pycram.planning
import pycram.reasoning
import pycram.world
from pycram.foundation.errors import PlanFailure
from pycram.motions.execution import Execution

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pycram.motions.process_module import ProcessModule

#: A function, and the class that ``self`` is of.
_Key: TypeAlias = "tuple[FunctionType, type | None]"

_ROOMS: Final = (pycram.models, pycram.motions, pycram.planning, pycram.reasoning, pycram.world)
_HANDED_OUT: Final = frozenset({"execute", "perform"})  # other motions, which are tasks of their own


class _Function:
    """A function, and the names in it.

    Attributes:
        owner: The class that ``self`` is of; None outside of methods.
        uses: Each name, whether it is called, and what is caught and forgotten there.
    """

    def __init__(self, function: FunctionType, owner: type | None) -> None:
        self.owner = owner
        self.names = inspect.getmodule(function).__dict__
        self.closure = {**inspect.getclosurevars(function).nonlocals}
        self.uses: list[tuple[ast.expr, bool, tuple[type[BaseException], ...]]] = []
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        self._walk(tree, ())

    def _walk(self, node: ast.AST, forgotten: tuple[type[BaseException], ...]) -> None:
        if isinstance(node, ast.Try):
            caught = forgotten + tuple(kind for handler in node.handlers for kind in self._forgets(handler))
            for child in node.body:
                self._walk(child, caught)
            for child in (*node.handlers, *node.orelse, *node.finalbody):
                self._walk(child, forgotten)
            return
        if isinstance(node, ast.With):
            calls = [item.context_expr for item in node.items if isinstance(item.context_expr, ast.Call)]
            suppressing = [call for call in calls if ast.unparse(call.func) == "suppress"]
            forgotten += tuple(self.value(kind) for call in suppressing for kind in call.args)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            self.uses.append((node.func, True, forgotten))
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
            self.uses.append((node, False, forgotten))
        for child in ast.iter_child_nodes(node):
            if not (isinstance(node, ast.arg | ast.AnnAssign) and child is node.annotation):
                self._walk(child, forgotten)

    def _forgets(self, handler: ast.ExceptHandler) -> Iterator[type[BaseException]]:
        """Yield what a handler catches without raising or keeping it."""
        inside = [node for child in handler.body for node in ast.walk(child)]
        if any(
            isinstance(node, ast.Raise) or (isinstance(node, ast.Name) and node.id == handler.name) for node in inside
        ):
            return
        kinds = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
        yield from (kind for each in kinds if isinstance(kind := self.value(each), type))

    def value(self, node: ast.expr | None) -> object:
        """Return what an expression stands for, as far as names of modules and their globals tell it."""
        if isinstance(node, ast.Name):
            return self.closure.get(node.id, self.names.get(node.id))
        if isinstance(node, ast.Attribute):
            owner = self.value(node.value)
            if isinstance(owner, ModuleType | type):
                return getattr(owner, node.attr, None)
        return None


@cache
def _of(function: FunctionType, owner: type | None = None) -> _Function:
    return _Function(function, owner)


@cache
def _members() -> Mapping[str, list[tuple[FunctionType, type]]]:
    """Return the methods and properties of all classes of the rooms, by name."""
    found: dict[str, list[tuple[FunctionType, type]]] = {}
    fields: set[str] = set()
    for room in _ROOMS:
        for info in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
            module = importlib.import_module(info.name)
            classes = [each for each in vars(module).values() if isinstance(each, type)]
            for kind in classes:
                if kind.__module__ == module.__name__ and not issubclass(kind, Execution):
                    fields.update(vars(kind).get("__annotations__", ()))
                    for name, member in vars(kind).items():
                        function = _function(member)
                        if function is not None:
                            found.setdefault(name, []).append((function, kind))
    return {name: functions for name, functions in found.items() if name not in fields}


def _function(member: object) -> FunctionType | None:
    member = member.fget if isinstance(member, property) else getattr(member, "func", member)
    member = inspect.unwrap(getattr(member, "__func__", member))  # type: ignore[arg-type]
    own = isinstance(member, FunctionType) and "/pycram/" in member.__code__.co_filename  # not what dataclasses make
    return member if own else None  # type: ignore[return-value]


def may_raise(module: type[ProcessModule], execution: type[Execution]) -> set[type[PlanFailure]]:
    """Return the failures that a process module may raise where motions are carried out in a certain way."""
    start: _Key = module._execute, module
    made: dict[_Key, set[type[PlanFailure]]] = {}
    calls: dict[_Key, list[tuple[_Key, tuple[type[BaseException], ...]]]] = {}
    waiting = [start]
    while waiting:
        key = waiting.pop()
        if key in made:
            continue
        made[key], calls[key] = set(), []
        known = _of(*key)
        for node, called, forgotten in known.uses:
            value = known.value(node)
            if called and isinstance(value, type) and issubclass(value, PlanFailure):
                if not issubclass(value, forgotten):
                    made[key].add(value)
                continue
            for target in _targets(known, node, value, execution, called=called):
                calls[key].append((target, forgotten))
                waiting.append(target)
    changed = True
    while changed:
        changed = False
        for key, targets in calls.items():
            for target, forgotten in targets:
                new = {kind for kind in made[target] if not issubclass(kind, forgotten)} - made[key]
                made[key] |= new
                changed = changed or bool(new)
    return made[start]


def _targets(
    known: _Function, node: ast.expr, value: object, execution: type[Execution], *, called: bool
) -> Iterator[_Key]:
    """Yield what a name in a function may stand for that can be called."""
    if isinstance(value, type):
        function = _function(vars(value).get("__init__")) if called else None
        yield from [(function, value)] if function is not None else []
    elif value is not None:
        function = _function(value)
        yield from [(function, None)] if function is not None else []
    elif isinstance(node, ast.Attribute) and node.attr not in _HANDED_OUT and not node.attr.startswith("__"):
        owners: list[type] = []
        if isinstance(node.value, ast.Name) and node.value.id == "self" and known.owner is not None:
            owners = [known.owner]
        elif isinstance(node.value, ast.Attribute) and node.value.attr == "execution":
            owners = [execution]
        for owner in owners:
            function = _function(inspect.getattr_static(owner, node.attr, None))
            yield from [(function, owner)] if function is not None else []
        if not owners:
            yield from _members().get(node.attr, ())
