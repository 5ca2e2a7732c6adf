"""Find in the source of a plan the lines that may have made the values of a line, and lines that look like a slip.

Slips are guesses: no rule knows the failure. A name leads to its assignments, a call to the return statements of the
plan's function. An attribute or a container leads to the lines that store values in it. Nothing is run.
"""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from heapq import heappop, heappush
from typing import Any, Final, TypeAlias

from recorder.plan_lines import called_name, last_name, stored, syntax_nodes
from replay.history.line_forms import line_ranks, own_nodes

_FUNCTIONS: Final = ast.FunctionDef | ast.AsyncFunctionDef
_DECLARING: Final = _FUNCTIONS | ast.ClassDef | ast.Import | ast.ImportFrom
_LEAVING: Final = ast.Continue | ast.Break | ast.Return | ast.Raise
_CHANGING: Final = ("pop", "popleft", "remove", "clear", "append", "add", "extend", "insert", "update", "setdefault")
_STORING: Final = (*_CHANGING, "set_value")
_STEP: Final = 0.01  # increase of the rank from a line to a line whose values flow into it
_CONDITION: Final = 1.1  # increase of the rank from a line to a condition, or to a statement before it
_START: Final = -1.6  # rank of a line that was given, and once more if it has numbers
_FAILED: Final = 0.7  # rank of the line that failed
_BEFORE: Final = 2  # maximum number of statements before a line that are considered
_ODD: Final = 20.0  # decrease of the rank of a line that looks like a slip
_MOST: Final = 100  # maximum number of lines that are followed
_TRIVIAL: Final = (0, 1)  # numbers that are hardly ever mistyped


class Flow:
    """The flow of values between the statements of a file."""

    def __init__(self, text: str) -> None:
        self._statements: list[tuple[ast.stmt, str]] = []  # statements by function; outer ones first
        self._made: dict[tuple[str, str], set[int]] = defaultdict(set)  # lines that set a name, by function and name
        self._returns: dict[str, set[int]] = defaultdict(set)
        self._conditions: dict[int, set[int]] = defaultdict(set)  # lines of conditions, by line of statement
        self._before: dict[int, list[int]] = {}  # for each statement's line, the lines of the statements just before it
        self._odd = {line for line, words in oddities(text).items() if is_strong(words)}
        self._forms = line_ranks(text)
        for node in syntax_nodes(text)[:1]:
            self._visit(node, "", ())

    def _visit(self, node: ast.AST, function: str, conditions: tuple[int, ...]) -> None:
        if isinstance(node, _FUNCTIONS):
            function = node.name
            # the calls of a function make the values of its parameters
            self._made |= {(function, each.arg): set() for each in ast.walk(node.args) if isinstance(each, ast.arg)}
            for given in (*node.args.defaults, *filter(None, node.args.kw_defaults)):
                self._returns[function].add(given.lineno)
        if isinstance(node, ast.stmt):
            self._statements.append((node, function))
            self._conditions[node.lineno] |= {*conditions}
            for name in _stored(node):
                self._made[function, name].add(node.lineno)
                self._made["", name] |= {node.lineno} if name.startswith(".") else set()
            if isinstance(node, ast.Return):
                self._returns[function].add(node.lineno)
        if isinstance(node, ast.If | ast.While):
            conditions = (*conditions, node.lineno)
        guards: dict[ast.AST, tuple[int, ...]] = {}
        for _, block in ast.iter_fields(node):
            statements = [each for each in block if isinstance(each, ast.stmt)] if isinstance(block, list) else []
            lines = [each.lineno for each in statements if not isinstance(each, _DECLARING) and not _is_idle(each)]
            self._before |= {line: lines[max(at - _BEFORE, 0) : at] for at, line in enumerate(lines)}
            guards |= _guards(statements)
        for child in ast.iter_child_nodes(node):
            self._visit(child, function, (*conditions, *guards.get(child, ())))

    def lines(self, starts: Mapping[int, float], failed: int = 0) -> list[int]:
        """Return the lines whose values flow into some lines, the most probable first.

        Args:
            starts: lines with their ranks.
            failed: the line that failed.
        """
        ranks: dict[int, float] = {}
        waiting = sorted((rank, line) for line, rank in starts.items())
        while waiting and len(ranks) < _MOST:
            rank, line = heappop(waiting)
            if line in ranks:
                continue
            found = next(
                (each for each in reversed(self._statements) if each[0].lineno <= line <= (each[0].end_lineno or 0)),
                None,
            )
            if found is None or (_is_idle(found[0]) and line not in starts):
                continue
            numbers = any(_number(node) not in (None, *_TRIVIAL) for node in own_nodes(found[0]))
            given = _START * (1 + numbers) if line in starts else 0.0
            ranks[line] = rank + self._forms.get(line, 0.0) + given + _FAILED * (line == failed)
            for source in self._sources(*found):
                if source not in ranks:
                    heappush(waiting, (rank + _STEP, source))
            before = self._before.get(found[0].lineno, ()) if line in starts else ()
            for condition in (*self._conditions[found[0].lineno], *before):
                heappush(waiting, (rank + _CONDITION, condition))
        functions = {function for each, function in self._statements if each.lineno in ranks}
        others = {each.lineno for each, function in self._statements if function in functions} - {*ranks}
        ranks |= dict.fromkeys(self._odd & others, 0.0)
        ranks |= {line: ranks[line] - _ODD for line in self._odd & ranks.keys()}
        return sorted(ranks, key=lambda line: ranks[line])

    def _sources(self, statement: ast.stmt, function: str) -> Iterator[int]:
        for node in own_nodes(statement):
            loaded = isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load)
            for name in (_named(node), f"{_named(node)}[]") if loaded else ():
                yield from self._made.get((function, name), self._made.get(("", name), ()))
                yield from self._returns.get(name.removeprefix("."), ())


def _guards(block: Sequence[ast.stmt]) -> dict[ast.AST, tuple[int, ...]]:
    """Return for each statement of a block the lines of conditions before it that may leave the block."""
    leaving = [each for each in block if isinstance(each, ast.If) and isinstance(each.body[-1], _LEAVING)]
    return {each: tuple(guard.lineno for guard in leaving if guard.lineno < each.lineno) for each in block}


def _is_idle(statement: ast.stmt) -> bool:
    """Return whether no value flows out of a statement: a docstring, a print, or an assertion that held."""
    alone = statement.value if isinstance(statement, ast.Expr) else statement
    return isinstance(alone, ast.Constant | ast.Assert) or called_name(alone) == "print"


def _stored(statement: ast.stmt) -> Iterator[str]:
    """Yield the names that a statement makes or changes; ``.x`` stands for an attribute, ``x[]`` for the items of x."""
    for node in own_nodes(statement):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _STORING:
            yield f"{_named(node.func.value)}[]"
        elif isinstance(node, ast.Name | ast.Attribute | ast.Subscript) and isinstance(node.ctx, ast.Store):
            yield f"{_named(node.value)}[]" if isinstance(node, ast.Subscript) else _named(node)


def _named(node: ast.AST) -> str:
    return f".{node.attr}" if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


Found: TypeAlias = Iterator[tuple[ast.AST, str]]

UNUSED: Final = "is never used"
_MUTABLE: Final = ast.List | ast.Dict | ast.Set | ast.ListComp | ast.DictComp
_WITHOUT_RESULT: Final = ("append", "extend", "insert", "remove", "reverse", "sort", "clear", "add", "shuffle")
_READING: Final = ("get_position", "get_pose", "get_orientation", "get_joint_position")
_MEAN: Final = re.compile("mean|middle|mid|average|cent(er|re)")
_LARGEST_ANGLE: Final = 6.3  # larger angles are in degrees


class _Source:
    """The nodes of a file, with facts that rules need."""

    def __init__(self, nodes: Sequence[Any]) -> None:
        self.nodes, self.module = nodes, nodes[0]
        self.around = {id(part): node for node in nodes for part in ast.iter_child_nodes(node)}
        self.functions = {node.name: node for node in self.all(_FUNCTIONS)}
        self.loaded = Counter(_loaded(self.module))
        fields = (block for node in nodes for _, block in ast.iter_fields(node) if isinstance(block, list))
        self.blocks = [block for block in fields if block and isinstance(block[0], ast.stmt)]

    def all(self, kind: Any) -> list[Any]:
        return [node for node in self.nodes if isinstance(node, kind)]

    def function_of(self, node: Any) -> Any:
        """Return the function or module around a node."""
        while not isinstance(node := self.around.get(id(node), self.module), _FUNCTIONS | ast.Module):
            pass
        return node

    def calls(self, node: Any, *names: str) -> list[ast.Call]:
        """Return the calls of functions and methods in a node, and in the plan's functions that it calls."""
        inner = [self.functions[called_name(each)] for each in _calls(node) if called_name(each) in self.functions]
        return [each for part in (node, *inner) for each in _calls(part, *names)]


@lru_cache(maxsize=8)
def oddities(text: str) -> dict[int, str]:
    """Return what looks like a slip in the lines of a source, in words by the number of the line."""
    nodes = syntax_nodes(text)
    if not nodes:
        return {}
    source, found = _Source(nodes), dict[int, str]()
    for rule in _RULES:
        for node, words in rule(source):
            found.setdefault(getattr(node, "lineno", 0), words)
    return found


def is_strong(words: str) -> bool:
    """Return whether a slip is likely; plans often have names that they don't use."""
    return bool(words) and not words.endswith(UNUSED)


def _loaded(node: Any) -> list[str]:
    """Return the names and attributes that a node reads."""
    return [
        last_name(each)
        for each in ast.walk(node)
        if isinstance(getattr(each, "ctx", None), ast.Load) and last_name(each)
    ]


def _names(node: Any) -> set[str]:
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load)}


def _calls(node: Any, *names: str) -> list[ast.Call]:
    return [each for each in ast.walk(node) if isinstance(each, ast.Call) and (not names or called_name(each) in names)]


def _changed(node: Any) -> set[str]:
    """Return the names whose containers a node changes."""
    return {last_name(getattr(each.func, "value", None)) for each in _calls(node, *_CHANGING)} - {""}


def _number(node: Any) -> float | None:
    value = getattr(node.operand if isinstance(node, ast.UnaryOp) else node, "value", None)
    return float(value) if isinstance(value, int | float) else None


# --- rules ----------------------------------------------------------------------------------------------------------


def _of_one_node(source: _Source) -> Found:
    yield from ((node, words) for node in source.nodes if (words := _slip(node)))


def _slip(node: Any) -> str:  # noqa: PLR0911  one case after the other
    """Return what looks like a slip in a node alone; "" otherwise."""
    match node:
        case ast.BinOp(op=ast.Mult(), left=ast.List(elts=items)) if any(isinstance(each, _MUTABLE) for each in items):
            return "all items are one and the same object"
        case ast.Expr(value=ast.Attribute() | ast.Name() | ast.Compare()):
            return "this line has no effect"
        case ast.Assign(value=ast.Call(func=ast.Attribute(attr=name))) if name in _WITHOUT_RESULT:
            return f"{name}() returns None"
        case ast.BoolOp(values=[ast.Compare(), *others]) if any(isinstance(each, ast.Constant) for each in others):
            return "a constant decides this condition"
        case ast.Dict(keys=keys) if len({ast.dump(each) for each in keys if each}) < len(
            [each for each in keys if each]
        ):
            return "a key is given twice"
        case ast.For(iter=ast.Name(id=name)) if name in _changed(node):
            return f"the loop changes {name} while it iterates over it"
        case ast.List(elts=[first, _, _, last]) if _calls(first, "cos") and _calls(last, "sin"):
            return "w comes first here, and last in PyCRAM"
    return ""


def _of_loops(source: _Source) -> Found:
    """Yield errors that are ignored, and loops that end too early or too late."""
    ended = [node for node in source.all(ast.For) if isinstance(node.body[-1], ast.Return | ast.Break)]
    retries = {id(part): node for node in ended for part in ast.walk(node) if isinstance(part, ast.Continue)}
    for node in source.all(ast.ExceptHandler):
        if all(isinstance(each, ast.Pass | ast.Continue) and id(each) not in retries for each in node.body):
            yield node.body[0], "an error is ignored here"
    for node in source.all(ast.For):
        last, ends = node.body[-1], any(isinstance(each, ast.Break | ast.Return | ast.Raise) for each in ast.walk(node))
        if len(node.body) > 1 and node in ended and node not in retries.values():
            yield last, "this ends the loop in its first iteration"
        kept = (stored(node) - stored(node.target)) & _names(source.function_of(node))
        if isinstance(last, ast.Try) and last.handlers and not ends and kept:
            yield last.body[-1], "the loop continues after a success"
        for late in (each for each in ast.walk(node) if isinstance(each, ast.Lambda)):
            for name in sorted(_names(late.body) & stored(node.target) - {each.arg for each in late.args.args}):
                yield late, f"it reads {name} when it is called, as the loop left it"


def _parameters(source: _Source) -> Found:
    """Yield defaults that calls share, parameters that a loop replaces, and arguments in another order."""
    for node in source.functions.values():
        given = [each.arg for each in (*node.args.posonlyargs, *node.args.args)]
        for name, value in zip(given[::-1], node.args.defaults[::-1], strict=False):
            if isinstance(value, _MUTABLE) and name in _changed(node):
                yield value, f"all calls of {node.name} share the default of {name}"
        for loop in (each for each in ast.walk(node) if isinstance(each, ast.For)):
            yield from (
                (loop, f"the loop replaces the parameter {name}") for name in sorted({*given} & stored(loop.target))
            )
        for call in _calls(source.module, node.name):
            others = {
                (one, last_name(other)) for one, other in zip(given, call.args, strict=False) if one != last_name(other)
            }
            if len(others) > 1 and {one for one, _ in others} == {other for _, other in others}:
                yield call, f"the parameters are {', '.join(given)}"


def _halved(source: _Source) -> Found:
    """Yield means whose last part alone is divided."""
    for name, node in source.functions.items():
        for each in ast.walk(node) if _MEAN.search(name) else ():
            match each:
                case ast.BinOp(op=ast.Add(), left=ast.Name(), right=ast.BinOp(op=ast.Div(), left=ast.Name(id=one))):
                    yield each, f"only {one} is divided"


def _bounds(source: _Source) -> Found:
    for node in source.all(ast.For | ast.comprehension):
        if called_name(node.iter) != "range" or not node.iter.args:
            continue
        body = node if isinstance(node, ast.For) else source.around[id(node)]
        name, first, last = last_name(node.target), node.iter.args[0], node.iter.args[:2][-1]
        parts = [each for each in ast.walk(body) if isinstance(each, ast.BinOp | ast.Subscript)]
        used = [
            each
            for each in parts
            if name in (last_name(getattr(each, part, None)) for part in ("left", "right", "slice"))
        ]
        if any(isinstance(getattr(each, "op", None), ast.Add | ast.Sub) for each in used):
            continue
        if first is not last and _number(first) == 1 and used:
            yield node.iter, "the loop begins at 1, and the first index is 0"
        elif isinstance(last, ast.BinOp) and _calls(last.left, "len"):
            yield node.iter, f"the loop {'leaves out' if isinstance(last.op, ast.Sub) else 'goes beyond'} the last item"


def _unreached(source: _Source) -> Found:
    """Yield branches that take all cases of the next branch."""
    members = {
        last_name(target): {*map(ast.dump, filter(None, getattr(node.value, "keys", getattr(node.value, "elts", ()))))}
        for node in source.all(ast.Assign)
        for target in node.targets
    }
    for node in source.all(ast.If):
        match node.orelse:
            case [ast.If(test=ast.Compare(ops=[op], comparators=[other]) as test)] if isinstance(
                node.test, ast.Compare
            ):
                if ast.dump(test.left) == ast.dump(node.test.left) and type(op) is type(node.test.ops[0]):
                    wide, (one, two) = node.test.comparators[0], map(_number, (node.test.comparators[0], other))
                    contained = isinstance(op, ast.In) and set() < members.get(last_name(other), set()) <= members.get(
                        last_name(wide), set()
                    )
                    if one is not None and two is not None and isinstance(op, ast.Gt | ast.GtE | ast.Lt | ast.LtE):
                        contained = one <= two if isinstance(op, ast.Gt | ast.GtE) else one >= two
                    if contained:
                        yield node.body[0], f"line {node.lineno} also matches all cases of line {test.lineno}"


def _not_reset(source: _Source) -> Found:
    """Yield names that are set once before a loop, and changed by a loop within it."""
    for block in source.blocks:
        for at, loop in ((at, each) for at, each in enumerate(block) if isinstance(each, ast.For | ast.While)):
            inner = [each for each in ast.walk(loop) if isinstance(each, ast.For | ast.While) and each is not loop]
            changed = {
                last_name(each.target) for part in inner for each in ast.walk(part) if isinstance(each, ast.AugAssign)
            }
            changed |= {name for each in inner if isinstance(each, ast.While) for name in _changed(each)}
            changed -= {name for each in ast.walk(loop) if isinstance(each, ast.Assign) for name in stored(each)}
            changed &= {name for call in _calls(loop) for name in _names(call)}
            for before in (each for each in block[:at] if isinstance(each, ast.Assign)):
                for name in sorted(changed & stored(before)):
                    yield before, f"{name} isn't set again in each iteration of line {loop.lineno}"


def _unused(source: _Source) -> Found:
    """Yield functions that are never called, and the lines that read what such a method sets."""
    if all(
        isinstance(each, _DECLARING | ast.Assign | ast.AnnAssign) or isinstance(getattr(each, "value", 0), ast.Constant)
        for each in source.module.body
    ):
        return  # other files use a module's names
    for name, node in source.functions.items():
        if not source.loaded[name] and not name.startswith("__") and not node.decorator_list:
            kept = {
                each.attr
                for each in ast.walk(node)
                if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store)
            }
            for each in source.all(ast.Attribute):
                if isinstance(each.ctx, ast.Load) and each.attr in kept and source.function_of(each) is not node:
                    yield each, f"{name}() sets {each.attr} anew, and is never called"
            yield node, f"{name} {UNUSED}"


def _unused_names(source: _Source) -> Found:
    """Yield constants that are never used, and objects used twice, the second time instead of another object."""
    local = Counter(
        each
        for node in source.functions.values()
        for own in [stored(node) | {each.arg for each in ast.walk(node.args) if isinstance(each, ast.arg)}]
        for each in _loaded(node)
        if each in own
    )
    checks = [each for each in source.nodes if isinstance(each, ast.Assert) or called_name(each) == "print"]
    checked = Counter(each for check in checks for each in _loaded(check))
    for node in (each for each in source.module.body if isinstance(each, ast.Assign)):
        read = {name: source.loaded[name] - local[name] for name in stored(node) - {"_"}}
        unused = ", ".join(sorted(name for name, count in read.items() if count <= checked[name]))
        if unused and not any(read.values()) and not _calls(node.value):
            yield node, f"{unused} {UNUSED}"
        again: dict[tuple[str, str], list[ast.Call]] = defaultdict(list)
        for call in _calls(source.module) if unused and len(read) > 1 else ():
            if call.args and last_name(call.args[0]) in read:
                again[called_name(call), last_name(call.args[0])].append(call)
        for (_, name), calls in again.items():
            if len(calls) > 1:
                yield calls[-1], f"{name} again; {unused} isn't used"


def _degrees(source: _Source) -> Found:
    """Yield angles that are in degrees where radians are expected."""
    for call in _calls(source.module, "sin", "cos", "tan"):
        function, names = source.function_of(call), _names(call)
        made = [each for each in ast.walk(function) if isinstance(each, ast.Assign) and names & stored(each)]
        names = names.union(*(_names(each.value) for each in made))
        given = [each for other in _calls(source.module, getattr(function, "name", "-")) for each in other.args]
        large = any((_number(each) or 0.0) > _LARGEST_ANGLE for each in given)
        if (large or any("deg" in name.lower() for name in names)) and not {"radians", "pi"} & {*_loaded(function)}:
            yield call, "the angle is in degrees, not in radians"


def _order(source: _Source) -> Found:
    """Yield simulations before gravity is set, and states that are used after their object may have moved."""
    for block in source.blocks:
        sets = [at for at, each in enumerate(block) if isinstance(each, ast.Expr) and _calls(each, "set_gravity")]
        for each in block[: sets[0]] if sets else ():
            if isinstance(each, ast.Expr) and source.calls(each, "simulate", "settle"):
                yield each, f"this runs before line {block[sets[0]].lineno} sets the gravity"
        for at, read in enumerate(block):
            if not isinstance(read, ast.Assign) or not source.calls(read.value, *_READING):
                continue
            owners, names = _names(read.value) - {*source.functions}, stored(read)
            for between, after in zip(block[at + 1 :], block[at + 2 :], strict=False):
                moves = _calls(between, "wait_for") or (owners & _names(between) and not _calls(between, "print"))
                uses = names & _names(after) and not owners & _names(after) and not isinstance(after, ast.Assert)
                if isinstance(between, ast.Expr) and moves and uses:
                    yield read, f"{', '.join(sorted(names))}: read before line {between.lineno}, used after it"


_RULES: Final[Sequence[Callable[[_Source], Found]]] = (
    *(_of_one_node, _of_loops, _parameters, _bounds, _unreached, _not_reset),
    *(_halved, _unused, _unused_names, _degrees, _order),
)
