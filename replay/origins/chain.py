"""Follows values back through the notes of a run: to the lines of the plan that made them, and to what they read."""

from __future__ import annotations

import ast
import inspect
import math
from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from itertools import chain as joined, islice, pairwise
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder.plan_lines import called_name
from recorder.records.tracebacks import result_or
from recorder.tracing.call_stack import described
from replay.history.line_forms import own_nodes
from replay.origins.noting import FUNCTIONS, Held, Note, ValueNotes, bound_names
from replay.origins.origin import Origin

if TYPE_CHECKING:
    Facts: TypeAlias = Iterator[Origin]

_MAX_FACTS: Final = 400  # maximum number of facts about a value
_MAX_SEARCHED: Final = 64  # maximum number of evaluations of an expression that are searched
_MAX_BEFORE: Final = 2  # maximum number of statements before a call that are listed
_TAKING: Final = ("pop", "popitem", "popleft", "setdefault")  # methods that change a container and also return an item
#: Ranks of facts by their kind, which add to those of their lines: see :mod:`replay.history.line_forms`.
_KINDS: Final = {"call": -1.6, "value": 1.2, "returned": -1.0, "condition": -1.0}
_WRITTEN: Final = -2.4  # for calls with numbers; half of it for calls with texts alone
_ITERATOR: Final = -0.9
_ITERATORS: Final = ("'<generator", "<zip", "<map", "<filter")
_SCOPES: Final = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda, ast.ClassDef)
_IN_LINE: Final = ("<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>")
_EXITS: Final = ast.Return | ast.Break | ast.Continue
_LEFT: Final = {ast.Return: "returned", ast.Break: "ended the loop", ast.Continue: "began the next iteration"}
_MAX_CHANGES: Final = 3  # maximum number of changes of a container that are listed
_PLAIN: Final = (bool, int, float, str, type(None), list, tuple, dict)
_COMPREHENSIONS: Final = ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp


class Evaluation(NamedTuple):
    """Where and when an expression was evaluated."""

    frame: int
    time: int


class Tracer:
    """Follows values back, in the notes of a run."""

    def __init__(self, notes: ValueNotes) -> None:
        self._notes = notes
        self._numbers = {id(node): number for number, (_, node) in enumerate(notes.nodes)}
        self._around = {
            id(part): node for _, node in notes.nodes for part in ast.iter_child_nodes(node) if hasattr(part, "_fields")
        }
        self._of_node: dict[int, list[Note]] = defaultdict(list)
        self._binds: dict[tuple[int, str], list[tuple[Note, int]]] = defaultdict(list)
        self._returns: dict[int, Note] = {}
        self._modules: dict[str, int] = {}  # number of the module's frame, for each file
        self._changes: dict[int, list[Note]] = defaultdict(list)  # changes by id of the changed object
        self._made: dict[int, Note] = {}  # the first call that returned an object, by the object's id
        self._entered: dict[int, Note] = {}  # the beginning of a function of the plan, by the time of its call
        self._inner: dict[int, list[Note]] = defaultdict(list)  # the calls within a call, by the time of the outer call
        for note in notes.all:
            self._sort_in(note)
        self._seen: set[tuple[int, str]] = set()
        self._count = 0
        self._latest: tuple[set[int], int] = set(), -1  # numbers of a statement's nodes, and when it began last

    def _sort_in(self, note: Note) -> None:
        self._of_node[note.number].append(note)
        node = self._node(note)
        code = self._notes.codes[note.frame]
        if code.co_name == "<module>":
            self._modules.setdefault(code.co_filename, note.frame)
        if note.parent is not None and (note.kind == "return" or isinstance(node, ast.Lambda)):
            self._returns[note.parent.time] = note
        if note.kind == "bind":
            for at, name in enumerate(bound_names(node)):
                self._binds[note.frame, name].append((note, at))
            if note.parent is not None and isinstance(node, FUNCTIONS):
                self._entered.setdefault(note.parent.time, note)
        elif note.kind == "store":
            self._changes[id(note.values[0].ref)].append(note)
        elif note.kind == "call":
            self._sort_in_call(note, node)

    def _sort_in_call(self, note: Note, node: ast.Call) -> None:
        changes = isinstance(self._around.get(id(node)), ast.Expr) or getattr(node.func, "attr", "") in _TAKING
        if changes and (owner := _receiver(note)) is not None:
            self._changes[id(owner)].append(note)
        if note.parent is not None:
            self._inner[note.parent.time].append(note)
        if note.result is not None:
            self._made.setdefault(id(note.result.ref), note)

    def _node(self, note: Note) -> Any:
        return self._notes.nodes[note.number][1]

    def _file(self, node: ast.AST) -> str:
        return self._notes.nodes[self._numbers[id(node)]][0]

    def _parents(self, node: ast.AST) -> Iterator[ast.AST]:
        around = self._around.get(id(node))
        while around is not None:
            yield around
            around = self._around.get(id(around))

    def _fact(
        self, kind: str, node: ast.AST, name: str, value: Held | None, step: int, parts: Iterable[Origin] = (),
        *, body: str = "", remark: str = "",
    ) -> Origin:  # fmt: skip
        file, line = self._file(node), getattr(node, "lineno", 0)
        text = self._notes.texts[file][line - 1].strip() if line else ""
        self._count += 1
        words, number = ("", None) if value is None else (shown(value.copy), _numbers_in(value.copy))
        constants = [each for each in (node, *own_nodes(node)) if isinstance(each, ast.Constant | ast.operator)]
        numbers = any(not isinstance(getattr(each, "value", 0), str | None) for each in constants)
        own = (bool(constants) + numbers) / 2
        rank = self._notes.ranks[file].get(line, 0.0) + _KINDS.get(kind, 0.0) + _ITERATOR * words.startswith(_ITERATORS)
        rank += _WRITTEN * own * (kind == "call")
        return Origin(kind, name, words, number, file, line, text, step, own, rank, body, remark, tuple(parts))

    # --- where a run was ------------------------------------------------------------------------------------------

    def call(self, note: Note) -> Origin:
        """Return a call of the plan, with its arguments, and the conditions that led to it."""
        self._begin()
        node, place = self._node(note), Evaluation(note.frame, note.time)
        facts = [*self._arguments(node, place), *self._path(node, place, note.parent)]
        return self._fact("call", node, ast.unparse(node.func), note.result, note.step, facts)

    def line(self, file: str, line: int, frame: int) -> Origin | None:
        """Return the statement at a line that raised an error, with the values that the statement used."""
        self._begin()
        every = ast.walk(self._notes.trees[file])
        found = [each for each in every if isinstance(each, ast.stmt) and each.lineno <= line <= (each.end_lineno or 0)]
        if not found:
            return None
        statement, place = found[-1], Evaluation(frame, len(self._notes.all))
        within = {self._numbers[id(each)] for each in ast.walk(statement) if id(each) in self._numbers}
        others = (note.time for note in reversed(self._notes.all) if note.frame == frame and note.number not in within)
        self._latest = within, next(others, -1)  # parts that weren't reached have notes from earlier
        inner = ast.iter_child_nodes(statement) if hasattr(statement, "body") else ()
        parts = [each for each in inner if not isinstance(each, ast.stmt)] or [statement]
        facts = [fact for each in parts for fact in self._inputs(each, place)]
        entered = next((note for note in self._entered.values() if note.frame == frame), None)
        facts += self._path(statement, place, None if entered is None else entered.parent)
        return self._fact("call", statement, "", None, self._notes.step, facts)

    def _begin(self) -> None:
        self._seen.clear()
        self._count, self._latest = 0, (set(), -1)

    def _path(self, node: ast.AST, place: Evaluation, outer: Note | None) -> Facts:
        """Yield the conditions around a node, and what the statements before it did; then the same for outer calls."""
        while True:
            yield from self._conditions(node, place)
            yield from self._before(node, place)
            if outer is None:
                return
            node, place, outer = self._node(outer), Evaluation(outer.frame, outer.time), outer.parent

    def _before(self, node: ast.AST, place: Evaluation) -> Facts:
        """Yield facts about the statements just before a node in its function, nearest first."""
        listed = 0
        for inner, around in pairwise((node, *self._parents(node))):
            if isinstance(inner, FUNCTIONS | ast.ClassDef):
                return
            bodies = (body for _, body in ast.iter_fields(around) if isinstance(body, list) and inner in body)
            block: list[Any] = next(bodies, []) if isinstance(inner, ast.stmt) else []
            for each in reversed(block[: block.index(inner)] if block else []):
                facts = [*self._done(each, place)]
                yield from facts
                listed += bool(facts)
                if listed >= _MAX_BEFORE:
                    return

    def _done(self, statement: ast.stmt, place: Evaluation) -> Facts:
        """Yield the calls of a statement; or its branch, a loop that didn't run, or an error that it handled."""
        called = getattr(statement, "value", None)
        if isinstance(called, ast.Call) and (note := self._noted(called, place)) and note.function is not print:
            handled = next((each for each in self._parents(statement) if isinstance(each, ast.Try)), None)
            raised = handled is not None and handled.handlers and not note.values and note.end < place.time
            remark = f"raised an error, and line {handled.handlers[0].lineno} continued" if handled and raised else ""
            name = ast.unparse(called.func)
            parts = joined(self._within(note), self._arguments(called, Evaluation(note.frame, note.time)))
            yield self._fact("before", called, name, note.result, note.step, parts, remark=remark)
        elif isinstance(statement, ast.If | ast.While | ast.For):
            untaken = [*self._untaken(statement, place)]
            yield from untaken or (fact for each in statement.body[-1:] for fact in self._done(each, place))
        elif isinstance(statement, ast.Try):
            yield from (fact for each in statement.body[-_MAX_BEFORE:] for fact in self._done(each, place))

    def _within(self, note: Note) -> Facts:
        """Yield the branches of a called function in which something was left out, and its last call."""
        entered = self._entered.get(note.time)
        if entered is None or self._is_known(note.time, "within"):
            return
        # a function that a branch runs goes on after the call that added the branch
        last = next((each.time for each in reversed(self._notes.all) if each.frame == entered.frame), 0)
        at = Evaluation(entered.frame, max(note.end, last + 1))
        for each in ast.walk(self._node(entered)):
            if isinstance(each, ast.If | ast.While | ast.For):
                yield from self._untaken(each, at)
        for call in [each for each in self._inner[note.time] if each.function is not print][-1:]:
            parts = self._arguments(self._node(call), Evaluation(call.frame, call.time))
            yield self._fact("before", self._node(call), "", None, call.step, joined(parts, self._within(call)))

    def _untaken(self, statement: ast.If | ast.While | ast.For, place: Evaluation) -> Facts:
        """Yield the condition of statements whose calls didn't run: in a branch, in a loop, or after an exit."""
        looped = isinstance(statement, ast.For)
        test = statement.iter if isinstance(statement, ast.For) else statement.test
        evaluated = self._noted(test, place)
        held = self.value(test, place) if evaluated is None else evaluated.result
        if held is None:
            return
        if isinstance(statement, ast.For):
            ran = self._noted(statement, place)
            taken = ran is not None and (_truth(held.ref) if evaluated is None else evaluated.time < ran.time)
        else:
            taken = _truth(held.copy)
        before = [each for each in self._of_node[self._numbers[id(test)]] if evaluated and each.time < evaluated.time]
        if isinstance(statement, ast.While) and not taken:  # a loop ends in this way even if it ran
            taken = bool(before) and before[-1].frame == place.frame
        left, done = (statement.orelse, statement.body) if taken else (statement.body, statement.orelse)
        other = next((each for each in reversed(before) if each.result and _truth(each.result.copy) is not taken), None)
        unlike = f"unlike at step {other.step}, " if other is not None and not looped else ""
        if done and isinstance(done[-1], _EXITS) and not looped:
            remark = f"{unlike}line {done[-1].lineno} {_LEFT[type(done[-1])]}"
        elif any(isinstance(each, ast.Call) for body in left for each in ast.walk(body)):
            first, last = left[0].lineno, left[-1].end_lineno
            lines = f"line {first}" if first == last else f"lines {first} to {last}"
            remark = f"{'the loop was empty: ' * (not isinstance(statement, ast.If))}{unlike}{lines} didn't run"
        else:
            return
        if not self._is_known(self._numbers[id(test)], f"path {place.frame}"):
            parts = self._inputs(test, place)
            kind = "item" if looped else "condition"
            yield self._fact(kind, test, ast.unparse(test), held, self._notes.step, parts, remark=remark)

    def _conditions(self, node: ast.AST, place: Evaluation) -> Facts:
        """Yield the conditions of the branches and loops around a node, and its blocks, innermost first."""
        inner: ast.AST = node
        for around in self._parents(node):
            if isinstance(around, FUNCTIONS | ast.ClassDef):
                return
            if isinstance(around, ast.If | ast.While | ast.IfExp) and inner is not around.test:
                yield from self._condition(around.test, place)
            elif isinstance(around, ast.With | ast.AsyncWith) and isinstance(inner, ast.stmt):
                for each in (item.context_expr for item in around.items):
                    text, parts = ast.unparse(each), self._inputs(each, place)
                    if not text.startswith("BulletWorld") and not self._is_known(id(each), "block"):
                        yield self._fact("condition", each, text, None, place.time, parts)
            inner = around

    def _condition(self, test: ast.expr, place: Evaluation) -> Facts:
        held = None if "__name__" in ast.unparse(test) else self.value(test, place)
        if held is not None and not self._is_known(self._numbers[id(test)], str(place.frame)):
            parts = self._inputs(test, place)
            odd = self._odd(ast.UnaryOp(ast.Not(), test), place) or self._oddity(test, place)
            yield self._fact("condition", test, ast.unparse(test), held, self._notes.step, parts, remark=odd)

    def _is_known(self, number: int, name: str) -> bool:
        known = (number, name) in self._seen or self._count >= _MAX_FACTS
        self._seen.add((number, name))
        return known

    # --- values ---------------------------------------------------------------------------------------------------

    def _noted(self, node: ast.AST, place: Evaluation) -> Note | None:
        """Return the last note of a node at a place; comprehensions and functions inside have other frames."""
        number, since = self._numbers[id(node)], self._latest[1]
        notes = self._of_node.get(number, [])
        until = bisect_right(notes, place.time, key=lambda note: note.time)
        inner = any(isinstance(each, _COMPREHENSIONS | ast.Lambda) for each in self._parents(node))
        inner = inner or isinstance(node, FUNCTIONS)
        some = notes[max(until - _MAX_SEARCHED, 0) : until]
        found = next((note for note in reversed(some) if inner or note.frame == place.frame), None)
        return None if found is None or (number in self._latest[0] and found.time < since) else found

    def value(self, node: ast.AST, place: Evaluation) -> Held | None:
        """Return the value of an expression at a place; None if unknown."""
        if isinstance(node, ast.Constant):
            return Held(node.value)
        if isinstance(node, ast.Name):
            bound = self._bind(node, place)
            return None if bound is None else bound[0].values[bound[1]]
        if isinstance(node, ast.List | ast.Tuple):
            parts = [self.value(each, place) for each in node.elts]
            return None if None in parts else Held([each.copy for each in parts if each is not None])
        note = self._noted(node, place)
        return None if note is None else note.result

    def _bind(self, node: ast.Name, place: Evaluation) -> tuple[Note, int] | None:
        """Return the note that contains a name's value, and the value's index in the note."""
        for around in self._parents(node):
            if isinstance(around, _COMPREHENSIONS):
                for each in around.generators:
                    if node.id in bound_names(each) and (note := self._noted(each, place)) is not None:
                        return note, bound_names(each).index(node.id)
            elif isinstance(around, FUNCTIONS | ast.Module):
                entered = None if isinstance(around, ast.Module) else self._noted(around, place)
                for frame in (place.frame, entered.frame if entered is not None else -1):
                    if (found := self._last(frame, node.id, place.time)) is not None:
                        return found
        return self._in_module(self._file(node), node.id, place.time)

    def _last(self, frame: int, name: str, time: int) -> tuple[Note, int] | None:
        binds = self._binds.get((frame, name), [])
        until = bisect_right(binds, time, key=lambda bind: bind[0].time)
        return binds[until - 1] if until else None

    def _in_module(self, file: str, name: str, time: int) -> tuple[Note, int] | None:
        found = self._last(self._modules.get(file, -1), name, time)
        tree = self._notes.trees.get(file)
        for node in ast.walk(tree) if tree is not None and found is None else ():
            if isinstance(node, ast.ImportFrom) and node.module:
                original = next((each.name for each in node.names if (each.asname or each.name) == name), "")
                stem = node.module.rpartition(".")[2]
                other = next((each for each in self._notes.trees if each.endswith(f"{stem}.py")), "")
                if original and other and other != file:
                    return self._in_module(other, original, time)
        return found

    # --- what a value was made from ----------------------------------------------------------------------------------

    def _inputs(self, node: ast.AST, place: Evaluation) -> Facts:
        """Yield the facts about the parts of an expression."""
        if self._count >= _MAX_FACTS or (isinstance(node, ast.Lambda | ast.stmt) and hasattr(node, "body")):
            return
        following: dict[type, Callable[[Any, Evaluation], Facts]] = {
            ast.Name: self._name, ast.Attribute: self._attribute, ast.Subscript: self._item, ast.Call: self._called,
        }  # fmt: skip
        if type(node) in following and isinstance(getattr(node, "ctx", None), ast.Load | None):
            yield from following[type(node)](node, place)
        elif isinstance(node, ast.BoolOp):
            for operand in node.values:
                yield from self._inputs(operand, place)
                held = self.value(operand, place)
                if held is None or (type(held.copy) in _PLAIN and bool(held.copy) is isinstance(node.op, ast.Or)):
                    return  # the other parts weren't evaluated
        elif isinstance(node, ast.IfExp):
            test = self.value(node.test, place)
            yield from self._condition(node.test, place)
            yield from self._inputs(node.body if test is None or test.copy else node.orelse, place)
        else:
            for each in ast.iter_child_nodes(node):
                inner = (each.iter, *each.ifs) if isinstance(each, ast.comprehension) else (each,)
                yield from joined.from_iterable(self._inputs(part, place) for part in inner)

    def _name(self, node: ast.Name, place: Evaluation) -> Facts:
        bound = self._bind(node, place)
        yield from self._bound(node.id, *bound, place) if bound is not None else ()

    def _bound(self, name: str, note: Note, at: int, place: Evaluation) -> Facts:
        """Yield how a variable got its value, and later changes of the value."""
        node, held = self._node(note), note.values[at]
        if isinstance(held.ref, ModuleType | type | FunctionType) or self._is_known(note.time, name):
            return
        before = Evaluation(note.frame, note.time)
        parts = [*self._changed(held.ref, note.time, place.time), *self._conditions(node, before)]
        if isinstance(node, FUNCTIONS):
            yield from self._argument(name, note, held, parts)
            return
        kind, source, remark = "value", getattr(node, "value", None), self._remark(name, note, place)
        located = node.target if isinstance(node, ast.comprehension) else node
        if isinstance(node, ast.For | ast.AsyncFor | ast.comprehension):
            kind, source = "item", node.iter
            written = {value: self.value(value, before) for _, value in self._written(node.iter, before)[0]}
            elements = [each for each, value in written.items() if value and _same(value.copy, held.copy)]
            if len(elements) == 1 and " changes while " not in remark:
                located = source = elements[0]
        elif isinstance(node, ast.With | ast.AsyncWith):
            source = node.items[0].context_expr
        elif isinstance(node, ast.AugAssign):
            earlier = self._last(note.frame, name, note.time - 1)
            parts += self._bound(name, *earlier, before) if earlier is not None else ()
        elif isinstance(node, ast.Assign):
            source = _matching(node.targets[0], node.value, name)
        made = () if source is None else self._inputs(source, before)
        remark = self._oddity(source, before) or remark
        yield self._fact(kind, located, name, held, note.step, joined(parts, made), remark=remark)

    def _remark(self, name: str, note: Note, place: Evaluation) -> str:
        node, code = self._node(note), self._notes.codes[note.frame]
        reader = self._notes.codes[place.frame].co_name
        if isinstance(node, ast.For):
            runs = [each.time for each in self._of_node[note.number] if each.frame == note.frame]
            held = self.value(node.iter, Evaluation(note.frame, runs[0]))
            changes = [] if held is None else self._changes[id(held.ref)]
            late = next((each for each in changes if runs[0] < each.time < runs[-1]), None)
            if late is not None:
                return f"{ast.unparse(node.iter)} changes while the loop runs, at line {self._node(late).lineno}"
            if note.frame != place.frame and reader not in _IN_LINE:
                return "as the loop left it"
        if isinstance(node, ast.Assign):
            function = node.value.func if isinstance(node.value, ast.Call) else None
            called = function.value if isinstance(function, ast.Attribute) else None
            held = None if called is None else self.value(called, Evaluation(note.frame, note.time))
            later = [] if held is None else [each for each in self._changes[id(held.ref)] if each.frame != note.frame]
            late = next((each for each in later if note.time < each.time < place.time), None)
            if late is not None and type(held.ref).__module__.startswith("pycram.fluents"):  # type: ignore[union-attr]
                return f"{ast.unparse(called)} was set since then, at line {self._node(late).lineno}"  # type: ignore[arg-type]
            if self._is_replaced(name, note, node):
                return "replaces the value of the iteration before"
        outer = self._in_module(self._file(node), name, place.time) if code.co_name != "<module>" else None
        if outer is not None and outer[0] is not note and name in bound_names(node):
            return f"hides {name} of line {getattr(self._node(outer[0]), 'lineno', 0)}"
        return ""

    def _is_replaced(self, name: str, note: Note, node: ast.Assign) -> bool:
        """Return whether an iteration of a loop replaces a value that the name had before the loop."""
        loop = next((each for each in self._parents(node) if isinstance(each, (ast.For, ast.While, *_SCOPES))), None)
        binds = [each for each, _ in self._binds[note.frame, name] if each.time < note.time]
        if not isinstance(loop, ast.For | ast.While) or not binds or binds[-1].number != note.number:
            return False
        reads = (each for each in ast.walk(loop) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load))
        return any(each.number != note.number for each in binds) and all(each.id != name for each in reads)

    def _oddity(self, source: ast.AST | None, place: Evaluation) -> str:
        """Return what is unusual about the values in an expression, in words; "" for nothing."""
        found = (self._odd(each, place) for each in (ast.walk(source) if source is not None else ()))
        return next(filter(None, found), "")

    def _odd(self, node: ast.AST, place: Evaluation) -> str:
        match node:
            case ast.BinOp(op=ast.FloorDiv()):
                one, other = self._number(node.left, place), self._number(node.right, place)
                if one is not None and other and one % other:
                    return f"{ast.unparse(node)} rounds {shown(one / other)} down"
            case ast.Call(func=ast.Name(id="int"), args=[part]):
                number = self._number(part, place)
                if number is not None and number < 0 and number % 1:
                    return f"{ast.unparse(node)} rounds {shown(number)} up"
            case ast.BoolOp(op=ast.Or(), values=[part, *_]) | ast.UnaryOp(op=ast.Not(), operand=part):
                if self._number(part, place) == 0:
                    return f"{ast.unparse(part)} is 0, which counts as missing here"
            case ast.Call() if called_name(node) in ("sorted", "sort", "min", "max"):
                keys = [each.value.body for each in node.keywords if isinstance(each.value, ast.Lambda)]
                notes = (note for key in keys for note in self._of_node[self._numbers[id(key)]])
                values = [note.result.copy for note in notes if note.result is not None]
                if _holds(lambda: sorted(values) != sorted(values, key=float), otherwise=False):
                    return f"{ast.unparse(keys[0])} is text, not a number: {min(values)!r} comes before {max(values)!r}"
        return ""

    def _number(self, node: ast.AST, place: Evaluation) -> float | None:
        held = self.value(node, place)
        number = None if held is None else _numbers_in(held.copy)
        return None if isinstance(number, list) else number

    def _argument(self, name: str, note: Note, held: Held, changes: list[Origin]) -> Facts:
        node, call = self._node(note), note.parent
        if call is None:
            return
        passed, before = self._node(call), Evaluation(call.frame, call.time)
        direct = _runs(call.function, self._notes.codes[note.frame])
        given = _given(passed, call.function, name) if direct else []
        default = _default(node, name)
        inner = joined.from_iterable(self._inputs(each, before) for each in given)
        if direct and default is not None and not given:
            changes = [*changes, *self._changed(held.ref, -1, note.time)]
            made = self._inputs(default, Evaluation(note.frame, note.time))
            kept = "kept from earlier calls" if changes else ""
            yield self._fact("default", default, name, held, note.step, joined(changes, made), remark=kept)
        elif len(given) == 1 and isinstance(given[0], ast.Name) and given[0].id == name:
            yield from joined(changes, inner)  # the caller has the same name for this value
        else:
            located = given[0] if len(given) == 1 else passed
            yield self._fact("argument", located, name, held, note.step, joined(changes, inner))

    def _changed(self, ref: Any, since: int, until: int, key: Any = None) -> Facts:
        if isinstance(ref, bool | int | float | str | tuple | type(None) | ModuleType | BulletWorld):
            return
        notes = [note for note in self._changes.get(id(ref), ()) if since < note.time and note.time < until]
        if key is not None:
            notes = [note for note in notes if note.kind == "call" or _same(note.values[1].copy, key)]
        for note in notes[: -_MAX_CHANGES - 1 : -1]:
            node = self._node(note)
            if self._is_known(note.time, "change"):
                continue
            called = note.kind == "call"
            at = Evaluation(note.frame, note.time)
            inner = self._arguments(node, at, receiver=False) if called else self._inputs(node.value, at)
            target = node.func.value if called else getattr(node, "target", None) or node.targets[0]
            inner, odd = joined(inner, self._conditions(node, at)), self._oddity(node, at)
            yield self._fact("change", node, ast.unparse(target), None, note.step, inner, remark=odd)

    def _arguments(self, node: ast.Call, place: Evaluation, *, receiver: bool = True) -> Facts:
        for each in (*node.args, *node.keywords):
            yield from self._inputs(each, place)
        if receiver and isinstance(node.func, ast.Attribute):
            yield from self._inputs(node.func.value, place)

    def _called(self, node: ast.Call, place: Evaluation) -> Facts:
        """Yield the value that a call returned, or that was made from its arguments."""
        note = self._noted(node, place)
        if note is None:
            yield from self._arguments(node, place, receiver=False)
            return
        function, owner = note.function, _receiver(note)
        module = str(getattr(function, "__module__", "") or type(owner).__module__)
        name = ast.unparse(node)
        if (returned := self._returns.get(note.time)) is not None:
            if not self._is_known(returned.time, "return"):
                place = Evaluation(returned.frame, note.end)
                made = self._node(returned)
                made = made.body if isinstance(made, ast.Lambda) else made.value
                parts = joined(self._inputs(made, place), self._conditions(self._node(returned), place))
                odd = self._oddity(made, place)
                yield self._fact("returned", self._node(returned), name, note.result, note.last_step, parts, remark=odd)
            return
        inner = self._arguments(node, Evaluation(note.frame, note.time))
        if isinstance(owner, Object) and note.result is not None and _numbers_in(note.result.copy) is not None:
            yield self._fact("read", node, name, note.result, note.last_step, inner, body=owner.name)
        elif module.startswith(("pycram.reasoning", "pycram.bullet_world_reasoning")) or name.startswith("perform("):
            yield self._fact("answer", node, name, note.result, note.last_step, inner)
        else:
            yield from inner

    def _attribute(self, node: ast.Attribute, place: Evaluation) -> Facts:
        note, owner = self._noted(node, place), self.value(node.value, place)
        held = None if note is None else note.result
        if owner is None or held is None or note is None:
            yield from self._inputs(node.value, place)
            return
        name = ast.unparse(node)
        if isinstance(owner.ref, ModuleType):
            bound = self._in_module(str(owner.ref.__file__), node.attr, place.time)
            yield from self._bound(name, *bound, place) if bound is not None else ()
            return
        if isinstance(owner.ref, Object):
            if _numbers_in(held.copy) is not None:
                inner = self._inputs(node.value, place)
                yield self._fact("read", node, name, held, note.step, inner, body=owner.ref.name)
            return
        stores = [each for each in self._changed(owner.ref, -1, place.time, node.attr) if each.kind == "change"]
        yield from stores[:1] or self._field(node, name, owner.ref, held, place)
        yield from self._inputs(node.value, place)

    def _field(self, node: ast.Attribute, name: str, owner: Any, held: Held, place: Evaluation) -> Facts:
        """Yield how an attribute of an object of the plan, or of a class, got its value."""
        made = self._made.get(id(owner))
        if made is not None and isinstance(made.function, type):
            given = _given(self._node(made), made.function, node.attr)
            if len(given) == 1:
                parts = self._inputs(given[0], Evaluation(made.frame, made.time))
                yield self._fact("value", given[0], name, held, made.step, parts)
                return
        names = {each.__name__ for each in (owner if isinstance(owner, type) else type(owner)).__mro__}
        for file, each in self._notes.nodes:
            if isinstance(each, ast.ClassDef) and each.name in names and file:
                for statement in each.body:
                    if node.attr in bound_names(statement) and getattr(statement, "value", None) is not None:
                        parts = self._inputs(statement, Evaluation(-1, place.time))
                        yield self._fact("default" if made else "value", statement, name, held, -1, parts)
                        return

    def _item(self, node: ast.Subscript, place: Evaluation) -> Facts:
        note, owner, key = self._noted(node, place), self.value(node.value, place), self.value(node.slice, place)
        parts = [node.value, node.slice]
        if owner is not None and key is not None and note is not None and note.result is not None:
            changed = [*self._changed(owner.ref, -1, place.time, key.copy)][:1]
            written, at = self._written(node.value, place)
            element = next((value for each, value in reversed(written) if _same(each, key.copy)), None)
            if changed:
                yield from changed
                parts = [node.slice]
            elif element is not None and not self._is_known(self._numbers[id(element)], ast.unparse(node)):
                name, remark = ast.unparse(node), ""
                if not isinstance(node.slice, ast.Constant | ast.UnaryOp):
                    name += f", {ast.unparse(node.slice)} = {shown(key.copy)}"
                    backwards = type(key.copy) is int and key.copy < 0
                    remark = f"{ast.unparse(node.slice)} counts from the end" if backwards else ""
                changes = self._changed(note.result.ref, at.time, place.time)
                made = joined(changes, self._inputs(node.slice, place), self._inputs(element, at))
                yield self._fact("item", element, name, note.result, note.step, made, remark=remark)
                return
        elif owner is not None:  # the container has no such item
            yield from islice(self._changed(owner.ref, -1, place.time), _MAX_BEFORE)
        for each in parts:
            yield from self._inputs(each, place)

    def _written(self, node: Any, at: Evaluation) -> tuple[list[tuple[Any, ast.expr]], Evaluation]:
        """Return the keys and elements of a container as they are in the source, and the container's evaluation."""
        while isinstance(node, ast.Name) and (bound := self._bind(node, at)) is not None:
            at, node = Evaluation(bound[0].frame, bound[0].time - 1), getattr(self._node(bound[0]), "value", None)
        if isinstance(node, ast.List | ast.Tuple):
            return [*enumerate(node.elts), *enumerate(node.elts, -len(node.elts))], at
        found = zip(node.keys, node.values, strict=True) if isinstance(node, ast.Dict) else ()
        return [(held.copy, value) for key, value in found if key and (held := self.value(key, at))], at


def nearest(origin: Origin, count: int) -> dict[str, Any]:
    """Return an origin as JSON data, with the parts that are nearest to it."""
    chosen, waiting = {id(origin)}, deque([origin])
    while waiting and len(chosen) < count:
        parts = waiting.popleft().parts[: count - len(chosen)]
        chosen.update(map(id, parts))
        waiting.extend(parts)

    def data(each: Origin) -> dict[str, Any]:
        facts = {name: getattr(each, name) for name in each.__slots__}
        return {**facts, "parts": [data(part) for part in each.parts if id(part) in chosen]}

    return data(origin)


def shown(value: Any) -> str:
    """Return a short text of a value: numbers are cut to 4 digits."""
    if type(value) is float:
        return f"{value:.4g}" if math.isfinite(value) and abs(value) < 1e4 else repr(value)
    if type(value) in (list, tuple) and len(value) <= 8:
        return f"[{', '.join(map(shown, value))}]" if type(value) is list else f"({', '.join(map(shown, value))})"
    text = described(value)
    name = getattr(value, "name", None) if text.startswith("<Object ") else None
    return str(name or (text if len(text) <= 60 else f"{text[:57]}..."))


def _numbers_in(value: Any) -> Any:
    """Return a number, or a list of numbers; None for other values."""
    if type(value) in (int, float):
        return value if math.isfinite(value) else None
    if type(value) in (list, tuple) and value:
        numbers = [_numbers_in(each) for each in value]
        return None if None in numbers else numbers
    return None


def _same(one: Any, other: Any) -> bool:
    return one is other or (isinstance(one, _PLAIN) and _holds(lambda: one == other, otherwise=False))


def _truth(value: Any) -> bool:
    return _holds(lambda: value, otherwise=True)


def _holds(test: Callable[[], Any], *, otherwise: bool) -> bool:
    """Return whether a test's result is true; ``otherwise`` if a method of the plan's objects raises an error."""
    return result_or(lambda: bool(test()), lambda _: otherwise)


def _receiver(note: Note) -> Any:
    owner = getattr(note.function, "__self__", None)
    return None if isinstance(owner, ModuleType) else owner


def _runs(function: Any, code: Any) -> bool:
    """Return whether a call of a function directly runs some code."""
    if isinstance(function, type):
        function = function.__init__  # type: ignore[misc]  # of the class that is called
    function = inspect.unwrap(getattr(function, "__func__", function))
    return getattr(function, "__code__", None) is code


def _given(call: ast.Call, function: Any, name: str) -> list[ast.expr]:
    """Return the expressions in a call that may be the source of a parameter's value."""
    first = next((at for at, each in enumerate(call.args) if isinstance(each, ast.Starred)), len(call.args))
    keywords = {each.arg: each.value for each in call.keywords if each.arg is not None}
    try:
        bound = inspect.signature(function).bind_partial(*call.args[:first], **keywords).arguments
    except (TypeError, ValueError):
        return []
    found = bound.get(name)
    if found is None:
        return [*call.args[first:], *(each.value for each in call.keywords if each.arg is None)]
    return [*found] if isinstance(found, tuple) else [*found.values()] if isinstance(found, dict) else [found]


def _default(node: Any, name: str) -> ast.expr | None:
    given = node.args
    names = [each.arg for each in (*given.posonlyargs, *given.args)]
    defaults = dict(zip(reversed(names), reversed(given.defaults), strict=False))
    defaults |= {each.arg: value for each, value in zip(given.kwonlyargs, given.kw_defaults, strict=True) if value}
    return defaults.get(name)


def _matching(target: ast.AST, value: ast.AST, name: str) -> ast.AST:
    """Return the part of an assigned tuple that a variable gets."""
    if isinstance(target, ast.Tuple | ast.List) and isinstance(value, ast.Tuple | ast.List):
        names = [each.id if isinstance(each, ast.Name) else "" for each in target.elts]
        if name in names and len(names) == len(value.elts):
            return value.elts[names.index(name)]
    return value
