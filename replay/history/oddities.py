"""Find in the source of a plan lines that look like a slip. These are guesses: no rule knows the failure."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any, Final, TypeAlias

from recorder.plan_lines import called_name, last_name, stored, syntax_nodes, written_number

FUNCTIONS: Final = ast.FunctionDef | ast.AsyncFunctionDef
DECLARING: Final = FUNCTIONS | ast.ClassDef | ast.Import | ast.ImportFrom
CHANGING: Final = ("pop", "popleft", "remove", "clear", "append", "add", "extend", "insert", "update", "setdefault")
Found: TypeAlias = Iterator[tuple[ast.AST, str]]

UNUSED: Final = "is never used"
MUTABLE: Final = ast.List | ast.Dict | ast.Set | ast.ListComp | ast.DictComp
_ITERATORS: Final = ("map", "zip", "filter", "islice", "reversed", "chain")
_BLOCKS: Final = ("par", "seq", "pursue", "try_in_order", "try_all")
_CACHES: Final = ("cache", "lru_cache", "cached_property")
_HALF: Final = re.compile(r"/ \d|\* 0\.5|half")
_WITHOUT_RESULT: Final = ("append", "extend", "insert", "remove", "reverse", "sort", "clear", "add", "shuffle")
_READING: Final = ("get_position", "get_pose", "get_orientation", "get_joint_position")
_MEAN: Final = re.compile("mean|middle|mid|average|cent(er|re)")
_LARGEST_ANGLE: Final = 6.3  # larger angles are in degrees


class _Source:
    """The nodes of a file, with facts that rules need."""

    def __init__(self, nodes: Sequence[Any]) -> None:
        self.nodes, self.module = nodes, nodes[0]
        self.around = {id(part): node for node in nodes for part in ast.iter_child_nodes(node)}
        self.functions = {node.name: node for node in self.all(FUNCTIONS)}
        self.loaded = Counter(_loaded(self.module))
        fields = (block for node in nodes for _, block in ast.iter_fields(node) if isinstance(block, list))
        self.blocks = [block for block in fields if block and isinstance(block[0], ast.stmt)]

    def all(self, kind: Any) -> list[Any]:
        return [node for node in self.nodes if isinstance(node, kind)]

    def function_of(self, node: Any) -> Any:
        """Return the function or module around a node."""
        while not isinstance(node := self.around.get(id(node), self.module), FUNCTIONS | ast.Module):
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
    return {last_name(getattr(each.func, "value", None)) for each in _calls(node, *CHANGING)} - {""}


def _size(node: Any) -> float | None:
    """Return the number that a node writes, without its sign; None for other nodes."""
    return written_number(getattr(node, "operand", node))


# --- rules ----------------------------------------------------------------------------------------------------------


def _of_one_node(source: _Source) -> Found:
    yield from ((node, words) for node in source.nodes if (words := _slip(node)))


def _slip(node: Any) -> str:  # noqa: C901, PLR0911  one case after the other
    """Return what looks like a slip in a node alone; "" otherwise."""
    match node:
        case ast.BinOp(op=ast.Mult(), left=ast.List(elts=items)) if any(map(_is_mutable, items)):
            return "all items are one and the same object"
        case ast.Call(func=ast.Attribute(attr="fromkeys"), args=[_, value]) if _is_mutable(value):
            return "all keys share one and the same value"
        case ast.Call(func=ast.Attribute(attr="strip" | "lstrip" | "rstrip"), args=[ast.Constant(str(text))]):
            return f"it strips single characters, not the text {text!r}" if re.search(r"\w.|.\w", text) else ""
        case ast.Call(args=[ast.Name() | ast.Attribute() | ast.Call() as data, *_]) if called_name(node) == "groupby":
            return "groupby() joins only neighbours" if called_name(data) != "sorted" else ""
        case ast.Call(args=[one, other]) if called_name(node) == "atan2" and _axes(one, other) == "xy":
            return "atan2() takes y first"
        case ast.Expr(value=ast.Attribute() | ast.Name() | ast.Compare()):
            return "this line has no effect"
        case ast.Assign(value=ast.Call(func=ast.Attribute(attr=name))) if name in _WITHOUT_RESULT:
            return f"{name}() returns None"
        case ast.BoolOp(values=[ast.Compare(), *others]) if any(isinstance(each, ast.Constant) for each in others):
            return "a constant decides this condition"
        case ast.Dict(keys=keys) if len({*map(ast.dump, filter(None, keys))}) < len([*filter(None, keys)]):
            return "a key is given twice"
        case ast.For(iter=ast.Name(id=name)) if name in _changed(node):
            return f"the loop changes {name} while it iterates over it"
        case ast.List(elts=[first, _, _, last]) if _calls(first, "cos") and _calls(last, "sin"):
            return "w comes first here, and last in PyCRAM"
    return ""


def _is_mutable(node: Any) -> bool:
    made = isinstance(node, ast.BinOp) and isinstance(node.left, ast.List)
    return made or isinstance(node, MUTABLE) or called_name(node) in ("list", "dict", "set", "deque")


def _axes(*nodes: Any) -> str:
    """Return the axes after which some expressions are named, or whose items they read."""
    texts = (ast.unparse(node.left if isinstance(node, ast.BinOp) else node) for node in nodes)
    found = (re.search(r"(?:^|[_.d])([xyz])$|\[([012])\]$", text) for text in texts)
    return "".join(match[1] or "xyz"[int(match[2])] for match in found if match)


def _iterators(source: _Source) -> Found:
    """Yield iterators that are used twice, and all() and any() that leave out effects."""
    lazy = {source.function_of(each).name: each.value for each in source.all(ast.Return) if _is_lazy(each.value)}
    for node in source.all(ast.Assign):
        name, scope = last_name(node.targets[0]), source.function_of(node)
        made = lazy.get(called_name(node.value), node.value)
        if _is_lazy(made) and name in stored(node):
            loads = [each for each in ast.walk(scope) if name in _names(each) and isinstance(each, ast.Name)]
            taken = {id(each) for call in _calls(scope, "next") for each in ast.walk(call)}
            if sum(id(each) not in taken for each in loads) > 1:
                yield made, f"{name} is used up after its first use"
    for call in _calls(source.module, "any", "all"):
        if call.args and isinstance(call.args[0], ast.GeneratorExp) and source.calls(call.args[0], "perform"):
            yield call, f"{called_name(call)}() leaves the others out once it knows the answer"


def _is_lazy(node: Any) -> bool:
    return isinstance(node, ast.GeneratorExp) or (isinstance(node, ast.Call) and last_name(node.func) in _ITERATORS)


def _kept(source: _Source) -> Found:
    """Yield caches of functions that read the world, and local variables instead of an attribute."""
    for node in source.functions.values():
        caches = [each for each in node.decorator_list if last_name(getattr(each, "func", each)) in _CACHES]
        if caches and source.calls(node, *_READING):
            yield caches[0], f"{node.name}() keeps its first answer, although the world changes"
        fields = {last_name(each) for each in source.all(ast.Attribute) if last_name(each.value) == "self"}
        shared = (each.names for each in ast.walk(node) if isinstance(each, ast.Nonlocal | ast.Global))
        read = _names(node).union(*shared)
        for each in (each for each in ast.walk(node) if isinstance(each, ast.Assign)):
            for name in sorted((stored(each) & fields) - read):
                yield each, f"{name} is a local variable here, not self.{name}"


def _in_blocks(source: _Source) -> Found:
    """Yield plain calls in a block of the plan language, which run before the block's motions."""
    for node in source.all(ast.With):
        if not {last_name(each.context_expr) for each in node.items} & {*_BLOCKS}:
            continue
        added = False
        names = {last_name(each.optional_vars) for each in node.items}
        for each in node.body:
            calls = [call for call in _calls(each) if called_name(call) in ("perform", "print", *names)]
            if added and not calls and _calls(each) and isinstance(each, ast.Assign | ast.Expr):
                yield each, f"it runs before the motions of the block of line {node.lineno}"
            added |= bool(calls)


def _half_angles(source: _Source) -> Found:
    for node in source.all(ast.List | ast.Tuple):
        turns = [call.args[0] for call in _calls(node, "sin", "cos") if call.args]
        if len(node.elts) == 4 and len(turns) == 2 and len({*map(ast.dump, turns)}) == 1:
            every = ast.walk(source.function_of(node))
            made = [each for each in every if isinstance(each, ast.Assign) and _names(turns[0]) & stored(each)]
            if not _HALF.search("".join(map(ast.unparse, (*turns, *made)))):
                yield node, "a quaternion has the sine and cosine of half of the angle"


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
            if isinstance(value, MUTABLE) and name in _changed(node):
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
        sides = [(each, getattr(each, part, None)) for each in parts for part in ("left", "right", "slice")]
        used = [each for each, side in sides if last_name(side) == name]
        if any(isinstance(getattr(each, "op", None), ast.Add | ast.Sub) for each in used):
            continue
        if first is not last and _size(first) == 1 and used:
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
                    wide, (one, two) = node.test.comparators[0], map(_size, (node.test.comparators[0], other))
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
        isinstance(each, DECLARING | ast.Assign | ast.AnnAssign) or isinstance(getattr(each, "value", 0), ast.Constant)
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
        large = any((_size(each) or 0.0) > _LARGEST_ANGLE for each in given)
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
    *(_halved, _unused, _unused_names, _degrees, _order, _iterators, _kept, _in_blocks, _half_angles),
)
