"""Small changes of a syntax node: each is the inverse of a typical mistake, and has a cost."""

from __future__ import annotations

import ast
import copy
import math
import re
from collections.abc import Iterator
from typing import Final, NamedTuple

from recorder.plan_lines import called_name, last_name, stored
from replay.fix.plan_syntax import PlanSyntax, loads, written_number, written_numbers

_FACTORS: Final = (0.01, 0.001, math.pi / 180, 100.0, 0.1, 10.0)  # for wrong units and decimal points
#: Each row: an operator, and those that it replaces by mistake.
_ROWS: Final = (
    "Add Sub, Sub Add, Mult Div, Div FloorDiv Mult, FloorDiv Div Mod, Mod FloorDiv, And Or, Or And, Lt Gt LtE, "
    "Gt Lt GtE, LtE GtE Lt, GtE LtE Gt, Eq NotEq, NotEq Eq, Is IsNot, IsNot Is, In NotIn, NotIn In"
)
_OPPOSITE: Final = {row.split()[0]: row.split()[1:] for row in _ROWS.split(", ")}
_FEW: Final = 2  # whole numbers up to this number are counts, not lengths
_MANY: Final = 4.0  # a number that is so much larger than all others has another unit
_RIGHT_ANGLES: Final = 15.0  # multiples of this number are likely angles in degrees
_PASSED: Final = 0.3  # additional cost of a number for a function of the plan, which may convert it
_AXIS: Final = re.compile(r"(?:.*_)?[xyz]")
_ANGLE: Final = re.compile(r".*(?:deg|angle|yaw|pitch|roll|theta|turn|heading|rotation).*", re.IGNORECASE)
_RADIANS: Final = {"radians": "radians", "math.radians": "math"}  # functions by the imported name
_MUTABLE: Final = ast.List | ast.Dict | ast.Set | ast.ListComp | ast.DictComp
_JUMPS: Final = ast.Return | ast.Break | ast.Continue | ast.Pass
_OTHERS: Final = {"min": "max", "max": "min", "sin": "cos", "cos": "sin", "any": "all", "all": "any"}
FAR: Final = 1.0  # cost of an edit that is larger than a typical mistake


class Change(NamedTuple):
    """New texts at places of the source."""

    what: str  # the change, in words
    cost: float
    parts: tuple[tuple[ast.AST | tuple[int, int], str], ...]  # nodes, or places in bytes
    asks: bool = False  # whether a value or name changes, rather than how values are computed
    chance: bool = False  # whether only the success of the run supports it
    kind: str = ""  # name of the operator


def _to(node: ast.AST, new: str, cost: float, what: str = "", *, asks: bool = False, chance: bool = False) -> Change:
    return Change(what or f"{new} instead of {ast.unparse(node)}", cost, ((node, new),), asks, chance)


def _number(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    value = written_number(node)
    if value is None:
        return
    is_count = isinstance(value, int) and value <= _FEW and node in plan.counts
    usual = max((each for each in plan.numbers if each != value), default=math.inf)
    for number, factor in enumerate(_FACTORS if value and not is_count and node not in plan.turns else ()):
        new = f"{value * factor:.6g}"  # without rounding errors, for the comparison too
        is_unit = value in plan.numbers and value >= _MANY * usual and float(new) <= usual
        is_unit |= factor == _FACTORS[2] and not value % _RIGHT_ANGLES
        cost = 0.25 + 0.05 * number if is_unit else 0.3 + 0.1 * number + 0.4 * (number > 2)
        cost += _PASSED * (called_name(plan.parents[node]) in plan.functions)
        what = f"{value} times {factor:.3g}"
        yield _to(node, new, cost, what, asks=not is_unit, chance=not is_unit)
    if value and (isinstance(value, float) or node not in plan.counts | plan.turns):
        yield _to(node, f"{-value!r}", 0.46, f"the sign of {value}", asks=True)
    if isinstance(value, int) and node in plan.counts and called_name(plan.parents[node]) != "range":
        for other in (value - 1, value + 1):
            yield _to(node, repr(other), 0.45, asks=True)


def _frame(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a position in the world instead of a position relative to the robot."""
    position = written_numbers(node)
    for base in plan.bases if len(position) == 3 and position[2] else ():
        new = f"[{', '.join(f'{one + other:.6g}' for one, other in zip(position, base, strict=True))}]"
        yield _to(node, new, 0.4, f"{new}: {ast.unparse(node)} seen from {base}", asks=True, chance=True)


def _spare_world(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield the plan without a second world that it doesn't use: the newest world is the current one."""
    match node:
        case ast.Assign([ast.Name(name)], ast.Call(ast.Name("BulletWorld"))) if name in plan.unused:
            place = plan.offset(node.lineno), plan.offset((node.end_lineno or node.lineno) + 1)
            if len(plan.names["BulletWorld"]) > 1:
                yield Change(f"without the unused world {name}", 0.2, ((place, ""),))


def _lost_update(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a value that is added to the earlier value."""
    match node:
        case ast.Assign([ast.Name(name)], value) if plan.in_loop(node):
            if written_number(value) or (name in plan.literals and isinstance(value, ast.Call)):
                yield _to(node, f"{name} += {ast.unparse(value)}", 0.3)
        case ast.Call(ast.Attribute(fluent, "set_value"), [number]) if written_number(number):
            yield _to(number, f"{ast.unparse(fluent)}.get_value() + {ast.unparse(number)}", 0.35)


def _bounds(node: ast.AST, _: PlanSyntax) -> Iterator[Change]:
    """Yield other first and last items."""
    match node:
        case ast.Call(args=[_, *_]) if called_name(node) == "range" and not node.keywords:
            first, last, *step = ["0" for _ in node.args[:1] if not node.args[1:]] + [*map(ast.unparse, node.args)]
            core, other = re.sub(r" [+-] 1$", "", last), {"0": "1", "1": "0"}.get(first)
            news = [(other or first, core)] if core != last else []
            news += [(other or f"{first} - 1", last), (first, core if news else f"{last} + 1"), (first, f"{last} - 1")]
            for at, (start, stop) in enumerate(news):
                new = stop if start == "0" and not step else ", ".join((start, stop, *step))
                yield _to(node, f"range({new})", 0.3 + 0.08 * at)
        case ast.Call(args=[listed, *start]) if called_name(node) == "enumerate":
            yield _to(node, f"enumerate({ast.unparse(listed)}{'' if start or node.keywords else ', 1'})", 0.5)
        case ast.Subscript(listed, ast.Slice()):
            yield _to(node, f"{ast.unparse(listed)}[:]", 0.4)
        case ast.Subscript(_, ast.Constant(0) | ast.UnaryOp(ast.USub(), ast.Constant(1)) as at):
            yield _to(at, "-1" if isinstance(at, ast.Constant) else "0", 0.4)


def _grouping(node: ast.AST, _: PlanSyntax) -> Iterator[Change]:
    """Yield other parentheses."""
    new: list[ast.expr] = []
    match node:
        case ast.BinOp(left, op, right):
            if isinstance(right, ast.BinOp) and not _is_same(op, right.op):
                new.append(ast.BinOp(ast.BinOp(left, op, right.left), right.op, right.right))
            if isinstance(left, ast.BinOp) and not _is_same(left.op, op):
                new.append(ast.BinOp(left.left, left.op, ast.BinOp(left.right, op, right)))
        case ast.BoolOp(ast.Or(), [*before, ast.BoolOp(values=[first, *rest])]):
            new.append(ast.BoolOp(ast.And(), [ast.BoolOp(ast.Or(), [*before, first]), *rest]))
    yield from (_to(node, f"({ast.unparse(each)})", 0.35 + 0.05 * isinstance(each, ast.BoolOp)) for each in new)


def _is_same(*operators: ast.operator) -> bool:
    """Return whether parentheses don't matter between the first and the second operator."""
    one, other = (type(each).__name__ for each in operators)
    return f"{one} {other}" in ("Add Add", "Add Sub", "Mult Mult", "Mult Div")


def _angle(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield an angle in the other unit."""
    if isinstance(node, ast.Call) and called_name(node) in ("radians", "degrees"):
        yield _to(node, f"({ast.unparse(node.args[0])})", 0.4)
    elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
        parent = plan.parents[node]
        named = _ANGLE.fullmatch(ast.unparse(node)) is not None and node not in plan.called
        turned = called_name(parent) in ("sin", "cos", "tan") and node in getattr(parent, "args", ())
        if (named or turned) and called_name(parent) not in ("radians", "degrees"):
            function = next((each for each, name in _RADIANS.items() if name in plan.defined), "0.0174533 * ")
            yield _to(node, f"{function}({ast.unparse(node)})", 0.35)


def _aliasing(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a copy of a container instead of a second name, and as many containers as items."""
    match node:
        case ast.BinOp(ast.List([item]), ast.Mult(), times) | ast.BinOp(times, ast.Mult(), ast.List([item])) if (
            not isinstance(item, ast.Constant)
        ):
            yield _to(node, f"[{ast.unparse(item)} for _ in range({ast.unparse(times)})]", 0.2)
        case ast.Call(args=[keys, value]) if called_name(node) == "fromkeys":
            yield _to(node, f"{{key: {ast.unparse(value)} for key in {ast.unparse(keys)}}}", 0.2)
        case ast.Assign(value=value) | ast.Return(value) if isinstance(value, ast.Name | ast.Subscript | ast.Attribute):
            if any(isinstance(each, ast.Name) and each.id in plan.literals for each in ast.walk(value)):
                text = ast.unparse(value)
                yield _to(value, f"{plan.literals[text]}({text})" if text in plan.literals else f"{text}.copy()", 0.5)


def _default(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a default value that each call makes anew."""
    if not isinstance(node, ast.FunctionDef):
        return
    given = node.args
    pairs = [*zip([*given.posonlyargs, *given.args][::-1], given.defaults[::-1], strict=False)]
    pairs += [(name, value) for name, value in zip(given.kwonlyargs, given.kw_defaults, strict=True) if value]
    for name, value in pairs:
        if isinstance(value, _MUTABLE | ast.Call | ast.Attribute | ast.Subscript):
            start = node.body[ast.get_docstring(node) is not None and len(node.body) > 1]
            made = f"{name.arg} = {ast.unparse(value)} if {name.arg} is None else {name.arg}"
            text = f"{made}\n{' ' * start.col_offset}{plan.segment(start)}"
            yield Change(f"{ast.unparse(value)} for each call", 0.2, ((value, "None"), (start, text)))


def _late(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a function that keeps the variables of the loop around it."""
    if isinstance(node, ast.Lambda | ast.FunctionDef) and not node.args.vararg and not node.args.kwonlyargs:
        loops = [each for each in plan.around(node) if isinstance(each, ast.For | ast.comprehension)]
        loops += [each for around in plan.around(node) for each in getattr(around, "generators", ())]
        names = set[str]().union(*(stored(each.target) for each in loops)) - {each.arg for each in node.args.args}
        body = node.body if isinstance(node.body, list) else [node.body]
        used = sorted(name for name in names if any(loads(each, {name}) for each in body))
        if used:
            other = copy.deepcopy(node)
            other.args.args += [ast.arg(name) for name in used]
            other.args.defaults += [ast.Name(name, ast.Load()) for name in used]
            new = ast.unparse(other).replace("\n", f"\n{' ' * node.col_offset}")
            yield _to(node, new, 0.25, f"{', '.join(used)} of each iteration")


def _shadowing(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a loop whose variable has a name of its own."""
    if not isinstance(node, ast.For):
        return
    for name in sorted(stored(node.target)):
        uses = [each for each in ast.walk(plan.scope(node)) if isinstance(each, ast.Name | ast.arg)]
        names = [each for each in uses if name in (getattr(each, "id", ""), getattr(each, "arg", ""))]
        earlier = [each for each in names if each.lineno < node.lineno and not loads(each, {name})]
        if earlier and any(each.lineno > (node.end_lineno or 0) for each in names):
            parts = tuple(
                (each, f"{name}_2") for each in {*ast.walk(node)}.intersection(names) if isinstance(each, ast.Name)
            )
            yield Change(f"{name}_2 instead of {name} in the loop of line {node.lineno}", 0.3, parts)


def _branches(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield the branches of a condition in the other order."""
    match node:
        case ast.If(test, [*body], [ast.If(second, [*others]) as other]) if other.col_offset == node.col_offset:
            ends = (test, test), (second, second), (body[0], body[-1]), (others[0], others[-1])
            new = (plan.segment(*ends[at]) for at in (1, 0, 3, 2))
            parts = tuple(zip((plan.span(*each) for each in ends), new, strict=True))
            yield Change(f"the condition of line {other.lineno} before that of line {node.lineno}", 0.3, parts)


def _handling(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield handlers that don't swallow an error, and loops that end after a success."""
    if isinstance(node, ast.ExceptHandler) and not any(isinstance(each, ast.Raise) for each in ast.walk(node)):
        attempt = plan.parents[node]
        ends: list[tuple[ast.stmt, tuple[str, ...], float]] = [(node.body[-1], ("continue", "break", "raise"), 0.2)]
        ends += [(attempt.body[-1], ("break",), 0.25)] if isinstance(attempt, ast.Try) else []
        for last, jumps, cost in ends:
            for jump in jumps if plan.in_loop(node) else jumps[2:]:
                old = plan.segment(last)
                new = jump if isinstance(last, _JUMPS) else f"{old}\n{' ' * last.col_offset}{jump}"
                if new != old:
                    yield _to(last, new, cost, f"{jump} after line {last.end_lineno}")
    elif isinstance(node, ast.Break | ast.Continue):
        yield _to(node, "continue" if isinstance(node, ast.Break) else "break", 0.55)


def _calls(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield the call of a method instead of an attribute, and calls with a forgotten world."""
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load) and node not in plan.called:
        owner = ast.unparse(node.value)
        if any(isinstance(each, ast.Attribute) and each.attr == node.attr for each in plan.called):
            yield _to(node, f"{ast.unparse(node)}()", 0.3)
        for method in plan.functions.values() if owner != "self" else ():
            stores = (each for each in ast.walk(method) if isinstance(each, ast.Attribute) and each.attr == node.attr)
            returns = any(isinstance(each, ast.Return) and each.value for each in ast.walk(method))
            is_method = [each.arg for each in method.args.args] == ["self"] and method.name != "__init__"
            if is_method and returns and any(isinstance(each.ctx, ast.Store) for each in stores):
                yield _to(node, f"{owner}.{method.name}()", 0.35)
    elif called_name(node) == "Object" and isinstance(node, ast.Call):
        worlds = sorted(plan.names["BulletWorld"]) if "world" not in {each.arg for each in node.keywords} else []
        for world in worlds if len(worlds) > 1 else ():
            yield _to(node, f"{plan.segment(node)[:-1]}, world={world})", 0.4, f"world={world}")
    elif node in plan.called and (name := last_name(node)) in _OTHERS:
        yield _to(node, ast.unparse(node).removesuffix(name) + _OTHERS[name], 0.55)


def _structure(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield other forms of an expression: operators, order of items, and the opposite of a condition."""
    match node:
        case ast.BinOp(op=op) | ast.BoolOp(op=op) | ast.Compare(ops=[op]):
            for name in _OPPOSITE.get(type(op).__name__, ()):
                other, sign, compares = copy.copy(node), getattr(ast, name)(), isinstance(node, ast.Compare)
                vars(other).update({"ops": [sign]} if compares else {"op": sign})
                what = "" if compares else f"{ast.unparse(node)} with another operator"
                is_scale = {name, type(op).__name__} == {"Mult", "Div"}
                around = plan.parents[node]
                skips = compares and isinstance(around, ast.If) and isinstance(around.body[-1], ast.Continue)
                new = ast.unparse(other) if compares else f"({ast.unparse(other)})"
                yield _to(node, new, 0.65 - 0.1 * compares - 0.25 * skips, what, chance=is_scale)
            if (
                isinstance(node, ast.BinOp)
                and isinstance(op, ast.Add | ast.Sub)
                and isinstance(node.right, ast.Constant)
            ):
                yield _to(node, f"({ast.unparse(node.left)})", 0.5)
        case ast.List([_, _, *_] as items) | ast.Tuple([_, _, *_] as items) if len(items) <= 4:
            turned = [[*items[1:], items[0]], [items[-1], *items[:-1]]] if len(items) == 4 else []
            swapped = [[*items[:at], items[at + 1], items[at], *items[at + 2 :]] for at in range(len(items) - 1)]
            for at, order in enumerate((*turned, *swapped)):
                swaps, new = at >= len(turned), ast.unparse(type(node)(order, ast.Load()))
                yield _to(node, new, 0.42 if swaps else 0.35 + 0.1 * at, asks=True, chance=swaps)
        case ast.Call(keywords=given) if any(each.arg == "orientation" for each in given):
            kept = [each for each in given if each.arg != "orientation"]
            yield _to(node, ast.unparse(ast.Call(node.func, node.args, kept)), FAR, "without orientation")
        case ast.UnaryOp(ast.Not(), operand):
            yield _to(node, f"({ast.unparse(operand)})", 0.56, f"without not: {ast.unparse(node)}")
        case ast.Name("par", ast.Load()):
            yield _to(node, "seq", 0.57)
    is_test = getattr(plan.parents.get(node), "test", None) is node
    if is_test and not isinstance(node, ast.Compare | ast.BoolOp | ast.UnaryOp):
        yield _to(node, f"not ({ast.unparse(node)})", 0.56)


def _undefined(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield objects instead of an undefined name."""
    if isinstance(node, ast.Name) and node not in plan.called and node.id not in plan.known.union(*plan.local.values()):
        yield from (
            _to(node, name, 0.2 + 0.01 * at) for at, name in enumerate(sorted(plan.names["Object"] - plan.fixed))
        )


def _never_held(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield pick-ups of an object that is placed, but never picked up; the latest first."""
    if called_name(node) == "place" and isinstance(node, ast.Call) and "pick_up" in plan.defined:
        slots = {each.arg: plan.segment(each) for each in node.keywords if each.arg in ("object", "arm")}
        picks = (each.keywords for each in plan.nodes if isinstance(each, ast.Call) and called_name(each) == "pick_up")
        is_held = any(slots.get("object", "") in map(plan.segment, given) for given in picks)
        statement = next(each for each in plan.around(node) if isinstance(each, ast.stmt))
        block = plan.block(statement)
        for at, each in enumerate(block[block.index(statement) :: -1] if not is_held else ()):
            place = plan.offset(each.lineno), plan.offset(each.lineno)
            new = f"{' ' * each.col_offset}perform(pick_up({', '.join(slots.values())}))\n"
            yield Change(f"{new.strip()} before line {each.lineno}", 0.3 + 0.02 * at, ((place, new),))


def _copied(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield an object without a use instead of one that stands twice in a list; the later one is likelier wrong."""
    texts = [getattr(each, "value", each) for each in getattr(node, "elts", ())]
    for at, text in [*enumerate(texts)][::-1]:
        for name in sorted(plan.forgotten) if isinstance(text, str) and texts.count(text) > 1 else ():
            yield _to(node.elts[at], repr(name), 0.05 - 0.001 * at)  # type: ignore[attr-defined]


def similar_name(node: ast.Name, plan: PlanSyntax) -> Iterator[Change]:
    """Yield other variables with the same role."""
    fitting = set[str]().union(*(each for each in plan.names.values() if node.id in each))
    for name in sorted(fitting - {node.id} - (set() if node.id in plan.fixed else plan.fixed)):
        chance = bool(_AXIS.fullmatch(name) and _AXIS.fullmatch(node.id))
        yield _to(node, name, 0.6, asks=name in plan.constants, chance=chance)


_OPERATORS: Final = (
    *(_number, _frame, _bounds, _grouping, _angle, _aliasing, _calls, _structure, _undefined, _copied, _never_held),
    *(_default, _late, _shadowing, _branches, _handling, _spare_world, _lost_update),
)


def changes(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield the changes of a node."""
    return (change._replace(kind=each.__name__) for each in _OPERATORS for change in each(node, plan))
