"""ValueNotes the values of a running plan: of names, calls, attributes, items, conditions and returns.

The plan's files are compiled with calls of :class:`ValueNotes` around these expressions. Values, lines and names of the plan
stay the same, so the plan makes the same records.
"""

from __future__ import annotations

import ast
import builtins
import sys
from contextvars import ContextVar
from importlib.machinery import SourceFileLoader
from itertools import count
from types import AsyncGeneratorType, CoroutineType, FrameType, GeneratorType, TracebackType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import CodeType

_KINDS: Final = ("call", "value", "bind", "store", "enter", "return")
_CALL, _VALUE, _BIND, _STORE, _ENTER, _RETURN = (f"__noted_{kind}__" for kind in _KINDS)
#: Functions that look at the frame of their caller.
_OF_FRAMES: Final = frozenset({"super", "locals", "globals", "vars", "eval", "exec", "dir", "breakpoint"})
_UNHELD: Final = (GeneratorType, CoroutineType, AsyncGeneratorType, FrameType, TracebackType, BaseException)
_MAX_ITEMS: Final = 64  # largest number of items of a container that is copied
_MAX_DEPTH: Final = 4
_MAX_NOTES: Final = 1_000_000
#: Parts of nodes that stay as they are: targets, types and patterns.
_UNCHANGED: Final = frozenset({"target", "targets", "optional_vars", "annotation", "returns", "pattern", "ctx", "op"})
#: Expressions that have a note if their value is used.
NOTED: Final = (
    ast.Call
    | ast.Attribute
    | ast.Subscript
    | ast.BinOp
    | ast.UnaryOp
    | ast.BoolOp
    | ast.Compare
    | ast.IfExp
    | ast.ListComp
)
FUNCTIONS: Final = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


class Held:
    """A value at a moment: the value itself, and a copy if it is a container that may change later."""

    __slots__ = ("copy", "ref")

    def __init__(self, value: Any) -> None:
        kind = type(value)
        self.ref = f"<{kind.__name__}>" if issubclass(kind, _UNHELD) else value
        self.copy = _copied(self.ref)


def _copied(value: Any, depth: int = 0) -> Any:
    kind = type(value)
    if kind in (list, tuple) and len(value) <= _MAX_ITEMS and depth < _MAX_DEPTH:
        return kind(_copied(each, depth + 1) for each in value)
    if kind is dict and len(value) <= _MAX_ITEMS and depth < _MAX_DEPTH:
        return {key: _copied(each, depth + 1) for key, each in list(value.items())}
    if kind.__module__ == "numpy" and hasattr(value, "tolist") and value.size <= _MAX_ITEMS:
        return value.tolist()
    return value


class Note:
    """What happened at a node of the plan's source."""

    __slots__ = (
        "end",
        "frame",
        "function",
        "kind",
        "last_step",
        "number",
        "parent",
        "result",
        "step",
        "time",
        "values",
    )

    def __init__(self, kind: str, number: int, frame: int, parent: Note | None, step: int, time: int) -> None:
        self.kind = kind  # "call", "value", "bind", "store" or "return"
        self.number = number  # of the node
        self.frame = frame  # number of the frame
        self.parent = parent  # the call around it
        self.step, self.time = step, time
        self.values: tuple[Held, ...] = ()  # values of the names; object, key and value of a store
        self.function: Any = None
        self.result: Held | None = None  # None if a call hasn't returned
        self.end, self.last_step = sys.maxsize, step


class ValueNotes:
    """The notes of a run, in order."""

    def __init__(self, is_plan: Callable[[str], bool]) -> None:
        self.all: list[Note] = []
        self.nodes: list[tuple[str, ast.AST]] = []  # file and node by number; these trees are as written
        self.trees: dict[str, ast.Module] = {}  # by file
        self.texts: dict[str, list[str]] = {}  # lines by file
        self.codes: list[CodeType] = []  # code by number of the frame
        self.step = -1  # the last step of the run
        self._is_plan = is_plan
        self._frames: dict[int, int] = {}  # numbers of frames by their ids
        self._serial = count()
        self._current: ContextVar[Note | None] = ContextVar("noted_call", default=None)

    @property
    def current(self) -> Note | None:
        """The innermost running call of the plan, also around a branch or thread."""
        return self._current.get()

    def install(self) -> None:
        """Compile the plan's files with notes from now on."""
        for kind in _KINDS:
            setattr(builtins, f"__noted_{kind}__", getattr(self, f"note_{kind}"))
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
            if not self._is_plan(path):
                return cached(loader, name)
            return loader.source_to_code(loader.get_data(path), path)

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
        self.trees[file], self.texts[file] = written, text.splitlines()
        noted: ast.Module = _Noting(numbers).visit(tree)
        return ast.fix_missing_locations(noted)

    def frame_of(self, frame: FrameType) -> int:
        """Return the number of a frame."""
        number = self._frames.get(id(frame))
        if number is None or self.codes[number] is not frame.f_code:
            number = self._new(frame)
        return number

    def _new(self, frame: FrameType) -> int:
        number = self._frames[id(frame)] = next(self._serial)
        self.codes.append(frame.f_code)
        return number

    def _note(self, kind: str, number: int, frame: FrameType) -> Note:
        note = Note(kind, number, self.frame_of(frame), self._current.get(), self.step, len(self.all))
        if len(self.all) < _MAX_NOTES:
            self.all.append(note)
        return note

    # --- called by the plan -------------------------------------------------------------------------------------------

    def note_call(self, number: int, function: Any, /, *args: Any, **kwargs: Any) -> Any:
        """Call a function of the plan."""
        note = self._note("call", number, sys._getframe(1))  # noqa: SLF001  inspect.currentframe() gives no other
        note.function = function
        self._current.set(note)
        try:
            result = function(*args, **kwargs)
        finally:
            self._current.set(note.parent)
            note.end, note.last_step = len(self.all), self.step
        note.result = Held(result)
        return result

    def note_value(self, number: int, value: Any, /) -> Any:
        """Note the value of an expression."""
        self._note("value", number, sys._getframe(1)).result = Held(value)  # noqa: SLF001  as above
        return value

    def note_return(self, number: int, value: Any, /) -> Any:
        """Note the value that a function returns."""
        self._note("return", number, sys._getframe(1)).result = Held(value)  # noqa: SLF001  as above
        return value

    def note_bind(self, number: int, /, *values: Any) -> Any:
        """Note the values that names have got; return the last value."""
        self._note("bind", number, sys._getframe(1)).values = tuple(map(Held, values))  # noqa: SLF001  as above
        return values[-1] if values else None

    def note_store(self, number: int, owner: Any, key: Any, /) -> None:
        """Note that an attribute or an item was set."""
        self._note("store", number, sys._getframe(1)).values = (Held(owner), Held(key))  # noqa: SLF001  as above

    def note_enter(self, number: int, /, *values: Any) -> None:
        """Note the arguments of a function that begins."""
        frame = sys._getframe(1)  # noqa: SLF001  as above
        self._new(frame)
        self._note("bind", number, frame).values = tuple(map(Held, values))


def bound_names(node: ast.AST) -> list[str]:
    """Return the names that a node binds, in the order of the values in its notes."""
    if isinstance(node, FUNCTIONS):
        given = node.args
        every = [*given.posonlyargs, *given.args, given.vararg, *given.kwonlyargs, given.kwarg]
        return [each.arg for each in every if each is not None]
    targets: Sequence[ast.AST | None] = ()
    match node:
        case ast.Assign():
            targets = node.targets
        case ast.With() | ast.AsyncWith():
            targets = [item.optional_vars for item in node.items]
        case ast.AnnAssign() | ast.AugAssign() | ast.For() | ast.AsyncFor() | ast.comprehension() | ast.NamedExpr():
            targets = [node.target]
    found = (each for target in targets if target is not None for each in ast.walk(target))
    return [each.id for each in found if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)]


class _Noting(ast.NodeTransformer):
    """Adds calls of :class:`ValueNotes` to a tree."""

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
                value.value = self.visit(value.value)  # the call has a note
            elif isinstance(value, ast.AST):
                setattr(node, name, self.visit(value))
            elif isinstance(value, list):
                visited = [self.visit(each) if isinstance(each, ast.AST) else each for each in value]
                setattr(node, name, [one for each in visited for one in (each if isinstance(each, list) else [each])])
        if test is not None and not isinstance(test, NOTED):
            node.test = self._call(_VALUE, test, node.test)  # type: ignore[attr-defined]
        return self._with_note(node)

    def _with_note(self, node: ast.AST) -> Any:  # noqa: C901  one case after the other
        match node:
            case ast.Call(func=ast.Name(id=name)) if name in _OF_FRAMES:
                return node
            case ast.Call():
                call = self._call(_CALL, node, node.func, *node.args)
                call.keywords = node.keywords
                return call
            case _ if isinstance(node, NOTED) and isinstance(getattr(node, "ctx", None), ast.Load | None):
                return self._call(_VALUE, node, node)
            case ast.NamedExpr():
                node.value = self._call(_BIND, node, node.value)
            case ast.Return(value=ast.expr() as value):
                node.value = self._call(_RETURN, node, value)
            case ast.comprehension():
                node.ifs.insert(0, ast.Compare(self._bound(node), [ast.IsNot()], [ast.Constant(...)]))
            case ast.Lambda() if not any(isinstance(each, ast.Yield | ast.YieldFrom) for each in ast.walk(node.body)):
                both = ast.Tuple([self._bound(node, _ENTER), node.body], ast.Load())
                node.body = ast.copy_location(ast.Subscript(both, ast.Constant(1), ast.Load()), node)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                after = 1 if ast.get_docstring(node, clean=False) is not None else 0
                node.body.insert(after, ast.copy_location(ast.Expr(self._bound(node, _ENTER)), node.body[0]))
            case ast.For() | ast.AsyncFor() | ast.With() | ast.AsyncWith():
                node.body.insert(0, ast.copy_location(ast.Expr(self._bound(node)), node))
            case ast.Assign() | ast.AnnAssign(value=ast.expr()) | ast.AugAssign():
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                notes = [self._bound(node), *(call for each in targets for call in self._stored(node, each))]
                return [node, *(ast.copy_location(ast.Expr(each), node) for each in notes)]
        return node

    def _call(self, name: str, node: ast.AST, *args: ast.expr) -> ast.Call:
        call = ast.Call(ast.Name(name, ast.Load()), [ast.Constant(self._numbers[id(node)]), *args], [])
        return ast.copy_location(call, node if hasattr(node, "lineno") else getattr(node, "target", node))

    def _bound(self, node: ast.AST, name: str = _BIND) -> ast.Call:
        return self._call(name, node, *(ast.Name(each, ast.Load()) for each in bound_names(node)))

    def _stored(self, node: ast.stmt, target: ast.expr) -> Iterator[ast.Call]:
        """Yield the note of an attribute or item that is set, if its owner and its key may be evaluated twice."""
        match target:
            case ast.Attribute(value=owner, attr=name) if _is_plain(owner):
                yield self._call(_STORE, node, _reloaded(owner), ast.Constant(name))
            case ast.Subscript(value=owner, slice=key) if _is_plain(owner) and _is_plain(key):
                yield self._call(_STORE, node, _reloaded(owner), _reloaded(key))


def _is_plain(node: ast.expr) -> bool:
    """Return whether an expression has only names, constants, attributes and signs."""
    parts = (each for each in ast.walk(node) if isinstance(each, ast.expr))
    return all(isinstance(each, ast.Name | ast.Constant | ast.Attribute | ast.UnaryOp) for each in parts)


def _reloaded(node: ast.expr) -> ast.expr:
    return ast.parse(ast.unparse(node), mode="eval").body
