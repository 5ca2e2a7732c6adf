"""Notes of a running plan: the values of names, calls, attributes, items, conditions and returns.

The plan's files are compiled with added calls of :class:`ValueNotes` around these expressions. The values, lines and
names of the plan stay the same, so the plan makes the same records.
"""

from __future__ import annotations

import ast
import builtins
import sys
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from types import AsyncGeneratorType, CodeType, CoroutineType, FrameType, GeneratorType, TracebackType
from typing import Any, Final

from replay.history.line_forms import line_ranks

#: Functions that read the frame of their caller.
_OF_FRAMES: Final = frozenset({"super", "locals", "globals", "vars", "eval", "exec", "dir", "breakpoint"})
_UNHELD: Final = (GeneratorType, CoroutineType, AsyncGeneratorType, FrameType, TracebackType, BaseException)
_MAX_ITEMS: Final = 64  # maximum number of items of a container that is copied
_MAX_DEPTH: Final = 4
_MAX_NOTES: Final = 1_000_000
#: Fields of nodes that aren't changed: targets, types and patterns.
_UNCHANGED: Final = frozenset({"target", "targets", "optional_vars", "annotation", "returns", "pattern", "ctx", "op"})
_NOTED: Final = (
    *(ast.Call, ast.Attribute, ast.Subscript, ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp),
    ast.ListComp,
)
FUNCTIONS: Final = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


class Held:
    """A value at a moment: the value itself, and a copy if it is a container that can change later."""

    __slots__ = ("copy", "ref")

    def __init__(self, value: Any) -> None:
        kind = type(value)
        self.ref = f"<{kind.__name__}>" if issubclass(kind, _UNHELD) else value
        self.copy = _copied(self.ref)


def _copied(value: Any, depth: int = 0) -> Any:
    kind = type(value)
    small = kind in (list, tuple, dict) and len(value) <= _MAX_ITEMS and depth < _MAX_DEPTH
    if small and kind is dict:
        return {key: _copied(each, depth + 1) for key, each in list(value.items())}
    if small:
        return kind(_copied(each, depth + 1) for each in value)
    if kind.__module__ == "numpy" and hasattr(value, "tolist") and value.size <= _MAX_ITEMS:
        return value.tolist()
    return value


@dataclass(slots=True, eq=False)
class Note:
    """The values of a node of the plan's source at a moment."""

    kind: str  # kind of the note: "call", "value", "bind", "store" or "return"
    number: int  # number of the node
    frame: int  # number of the frame in which the node was evaluated
    parent: Note | None  # the innermost running call of the plan at that moment
    step: int  # the last recorded step before the note
    time: int  # index of the note
    values: tuple[Held, ...] = ()  # "bind": a value for each name; "store": the object and the key; else one value
    function: Any = None  # the function that is called, for a "call"
    end: int = sys.maxsize  # time at which a call ended
    last_step: int = -1  # the last recorded step before a call ended

    @property
    def result(self) -> Held | None:
        """The first value; None if the call has not returned."""
        return self.values[0] if self.values else None


class ValueNotes:
    """The notes of a run, in order."""

    def __init__(self, is_plan: Callable[[str], bool]) -> None:
        self.all: list[Note] = []
        self.nodes: list[tuple[str, ast.AST]] = []  # file and node by number; these trees are as written
        self.trees: dict[str, ast.Module] = {}  # by file
        self.texts: dict[str, list[str]] = {}  # lines by file
        self.ranks: dict[str, Mapping[int, float]] = {}  # ranks of lines by file
        self.codes: list[CodeType] = []  # code, by number of the frame
        self.step = -1  # the last recorded step of the run
        self._is_plan = is_plan
        self._frames: dict[int, int] = {}  # numbers of frames, by their ids
        self._current: ContextVar[Note | None] = ContextVar("noted_call", default=None)

    @property
    def current(self) -> Note | None:
        """The innermost running call of the plan; it may be around a branch or thread."""
        return self._current.get()

    def install(self) -> None:
        """Compile the plan's files with notes from now on."""
        builtins.__noted__, builtins.__noted_call__ = self._noted, self._noted_call  # type: ignore[attr-defined]
        plain, cached = builtins.compile, SourceFileLoader.get_code

        def compiled(
            source: Any, filename: Any, mode: str, flags: int = 0, _: bool = False, optimize: int = -1, **rest: Any
        ) -> Any:
            if mode == "exec" and not flags & ast.PyCF_ONLY_AST and isinstance(source, str | bytes):
                file = filename if isinstance(filename, str) else ""
                source = self._with_notes(source, file) if self._is_plan(file) else source
            rest.pop("dont_inherit", None)
            return plain(source, filename, mode, flags, True, optimize, **rest)

        def code_of(loader: SourceFileLoader, name: str) -> Any:
            path = loader.get_filename(name)
            return loader.source_to_code(loader.get_data(path), path) if self._is_plan(path) else cached(loader, name)

        builtins.compile = compiled  # type: ignore[assignment]
        SourceFileLoader.get_code = code_of  # type: ignore[method-assign, assignment]
        sys.setrecursionlimit(sys.getrecursionlimit() * 2)

    def _with_notes(self, source: str | bytes, file: str) -> ast.Module:
        written, tree = ast.parse(source, file), ast.parse(source, file)
        numbers = {}
        for clean, node in zip(ast.walk(written), ast.walk(tree), strict=True):
            numbers[id(node)] = len(self.nodes)
            self.nodes.append((file, clean))
        text = source if isinstance(source, str) else source.decode("utf-8", "replace")
        self.trees[file], self.texts[file], self.ranks[file] = written, text.splitlines(), line_ranks(text)
        noted: ast.Module = _Noting(numbers).visit(tree)
        return ast.fix_missing_locations(noted)

    def frame_of(self, frame: FrameType, *, new: bool = False) -> int:
        """Return the number of a frame."""
        number = self._frames.get(id(frame))
        if number is None or new or self.codes[number] is not frame.f_code:
            number = self._frames[id(frame)] = len(self.codes)
            self.codes.append(frame.f_code)
        return number

    def _note(self, kind: str, number: int, frame: int) -> Note:
        note = Note(kind, number, frame, self._current.get(), self.step, len(self.all), last_step=self.step)
        if len(self.all) < _MAX_NOTES:
            self.all.append(note)
        return note

    def _noted(self, kind: str, number: int, /, *values: Any) -> Any:
        """Note values for the plan, and return the last value. At "enter", these are a function's arguments."""
        frame = self.frame_of(sys._getframe(1), new=kind == "enter")  # noqa: SLF001  inspect has no such depth
        self._note("bind" if kind == "enter" else kind, number, frame).values = tuple(map(Held, values))
        return values[-1] if values else None

    def _noted_call(self, number: int, function: Any, /, *args: Any, **kwargs: Any) -> Any:
        note = self._note("call", number, self.frame_of(sys._getframe(1)))  # noqa: SLF001  as above
        note.function = function
        self._current.set(note)
        try:
            result = function(*args, **kwargs)
        finally:
            self._current.set(note.parent)
            note.end, note.last_step = len(self.all), self.step
        note.values = (Held(result),)
        return result


def bound_names(node: ast.AST) -> list[str]:
    """Return the names that a node binds, in the order of the values in its notes."""
    if isinstance(node, FUNCTIONS):
        given = node.args
        every = [*given.posonlyargs, *given.args, given.vararg, *given.kwonlyargs, given.kwarg]
        return [each.arg for each in every if each is not None]
    if isinstance(node, ast.With | ast.AsyncWith):
        targets = [item.optional_vars for item in node.items]
    else:
        targets = getattr(node, "targets", [getattr(node, "target", None)])
    found = (each for target in targets if target is not None for each in ast.walk(target))
    return [each.id for each in found if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)]


class _Noting(ast.NodeTransformer):
    """Adds calls of :class:`ValueNotes` to a syntax tree."""

    def __init__(self, numbers: dict[int, int]) -> None:
        self._numbers = numbers

    def visit(self, node: ast.AST) -> Any:
        """Return a node with notes; for an assignment, return the statements that replace it."""
        if isinstance(node, ast.JoinedStr | ast.Delete):
            return node
        test = getattr(node, "test", None)
        for name, value in ast.iter_fields(node):
            if name in _UNCHANGED:
                continue
            if name == "func" and isinstance(value, ast.Attribute):
                value.value = self.visit(value.value)  # the call itself has a note
            elif isinstance(value, ast.AST):
                setattr(node, name, self.visit(value))
            elif isinstance(value, list):
                visited = [self.visit(each) if isinstance(each, ast.AST) else each for each in value]
                setattr(node, name, [one for each in visited for one in (each if isinstance(each, list) else [each])])
        if test is not None and not isinstance(test, _NOTED):
            node.test = self._call("value", test, node.test)  # type: ignore[attr-defined]
        return self._with_note(node)

    def _with_note(self, node: ast.AST) -> Any:  # noqa: C901  the cases are tried one after the other
        match node:
            case ast.Call(func=ast.Name(id=name)) if name in _OF_FRAMES:
                return node
            case ast.Call():
                noted = self._call("", node, node.func, *node.args)
                noted.keywords = node.keywords
                return noted
            case _ if isinstance(node, _NOTED) and isinstance(getattr(node, "ctx", None), ast.Load | None):
                return self._call("value", node, node)
            case ast.NamedExpr():
                node.value = self._call("bind", node, node.value)
            case ast.Return(value=ast.expr() as value):
                node.value = self._call("return", node, value)
            case ast.comprehension():
                node.ifs.insert(0, ast.Compare(self._bound(node), [ast.IsNot()], [ast.Constant(...)]))
            case ast.Lambda() if not any(isinstance(each, ast.Yield | ast.YieldFrom) for each in ast.walk(node.body)):
                both = ast.Tuple([self._bound(node, "enter"), node.body], ast.Load())
                node.body = ast.copy_location(ast.Subscript(both, ast.Constant(1), ast.Load()), node)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                after = 1 if ast.get_docstring(node, clean=False) is not None else 0
                node.body.insert(after, ast.copy_location(ast.Expr(self._bound(node, "enter")), node.body[0]))
            case ast.For() | ast.AsyncFor() | ast.With() | ast.AsyncWith():
                node.body.insert(0, ast.copy_location(ast.Expr(self._bound(node)), node))
            case ast.Assign() | ast.AnnAssign(value=ast.expr()) | ast.AugAssign():
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                notes = [self._bound(node), *(call for each in targets for call in self._stored(node, each))]
                return [node, *(ast.copy_location(ast.Expr(each), node) for each in notes)]
        return node

    def _call(self, kind: str, node: ast.AST, *args: ast.expr) -> ast.Call:
        name, kinds = ("__noted__", [ast.Constant(kind)]) if kind else ("__noted_call__", [])
        call = ast.Call(ast.Name(name, ast.Load()), [*kinds, ast.Constant(self._numbers[id(node)]), *args], [])
        return ast.copy_location(call, node if hasattr(node, "lineno") else getattr(node, "target", node))

    def _bound(self, node: ast.AST, kind: str = "bind") -> ast.Call:
        return self._call(kind, node, *(ast.Name(each, ast.Load()) for each in bound_names(node)))

    def _stored(self, node: ast.stmt, target: ast.expr) -> Iterator[ast.Call]:
        """Yield the note of a store. Its owner and its key are evaluated twice, so they must have no effects."""
        match target:
            case ast.Attribute(value=owner, attr=name) if _is_plain(owner):
                yield self._call("store", node, _reloaded(owner), ast.Constant(name))
            case ast.Subscript(value=owner, slice=key) if _is_plain(owner) and _is_plain(key):
                yield self._call("store", node, _reloaded(owner), _reloaded(key))


def _is_plain(node: ast.expr) -> bool:
    """Return whether an expression consists only of names, constants, attributes and signs."""
    parts = (each for each in ast.walk(node) if isinstance(each, ast.expr))
    return all(isinstance(each, ast.Name | ast.Constant | ast.Attribute | ast.UnaryOp) for each in parts)


def _reloaded(node: ast.expr) -> ast.expr:
    return ast.parse(ast.unparse(node), mode="eval").body
