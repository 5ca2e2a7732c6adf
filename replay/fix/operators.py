"""Small changes of a syntax node: each is the inverse of a typical mistake, and has a cost."""

from __future__ import annotations

import ast
import builtins
import copy
import math
import re
from collections.abc import Iterator
from difflib import get_close_matches
from itertools import repeat
from string import digits
from typing import Final

from pycram import bullet_world_reasoning, failures
from pycram.bullet_world import BulletWorld, Object
from pycram.event import Event
from pycram.fluent import Fluent
from recorder.plan_lines import called_name, last_name, stored, written_number
from replay.fix.plan_syntax import Change, PlanSyntax, instead, loads, written_numbers
from replay.history.oddities import MUTABLE

_FACTORS: Final = (0.01, 0.001, math.pi / 180, 100.0, 0.1, 10.0)  # for wrong units and decimal points
_FEW: Final = 2  # whole numbers up to this number are counts, not lengths
_MANY: Final = 4.0  # a number that is so much larger than all others has another unit
_RIGHT_ANGLES: Final = 15.0  # multiples of this number are likely angles in degrees
_PASSED: Final = 0.3  # additional cost of a number for a function of the plan, which may convert it
_AXIS: Final = re.compile(r"(?:.*_)?[xyz]")
_ANGLE: Final = re.compile(r".*(?:deg|angle|yaw|pitch|roll|theta|turn|heading|rotation).*", re.IGNORECASE)
_SIZE: Final = re.compile(r"height|high|tall|width|wide|depth|length|long|thick|diameter|extent|size", re.IGNORECASE)
_RADIANS: Final = {"radians": "radians", "math.radians": "math"}  # functions by the imported name
_LAZY: Final = ("zip", "map", "filter", "islice", "chain", "enumerate", "reversed", "product", "permutations", "reader")
_PARTS: Final = r"^[^(]*\b{}\b[^(=]*( = | in ).*\b(split|splitlines|reader)\("  # parts of a text
_CONVERTING: Final = ("float", "int", "str", "print")
_KEEPING: Final = ast.Assign | ast.AnnAssign | ast.Return | ast.keyword | ast.Tuple
_JUMPS: Final = ast.Return | ast.Break | ast.Continue | ast.Pass
#: Each row: functions, methods or attributes that are confused.
_SIMILAR: Final = (
    "strip lstrip rstrip removeprefix removesuffix, floor ceil round int, any all, min max, sin cos, append extend, "
    "copy deepcopy, par seq try_in_order try_all pursue, keys values items, sorted reversed, startswith endswith, find "
    "rfind, union intersection difference, combinations permutations, pop popleft, issubset issuperset, name type, "
    "partition rpartition, lower upper, falling rising, zip zip_longest, discard remove, cached_property property"
)
#: Of these, names that stand for the opposite: only the success of the run supports their exchange.
_OPPOSITE: Final = {"any", "all", "min", "max", "sin", "cos", "pop", "popleft", "par", "sorted", "falling", "rising"}
_MEANT: Final = {name: row.split() for row in _SIMILAR.split(", ") for name in row.split()}
#: Each row: a cost, and patterns with what is meant instead. K and L are constants, X is none, H is a size, N isn't a
#: truth value, other letters are any expressions.
#: "?" marks exchanges after which a wrong value may happen to be right: only the success of the run supports them.
_RULES: Final = """
0.15; groupby(A, key=B) | groupby(sorted(A, key=B), key=B); groupby(A, B) | groupby(sorted(A, key=B), B)
0.15; dict.fromkeys(A, B) | {key: B for key in A}; V = A.sort(key=B) | V = sorted(A, key=B); A.get(B) or C | A.get(B, C)
0.15; A.original_pose[1] | A.get_orientation(); A.get(B, set()) | A.setdefault(B, set()); A.original_pose | A.get_pose()
0.15; Fluent(False, name=A) | Fluent(name=A); A.set_value(False) | A.set_value(None); (A // B, A // B) | (A // B, A % B)
0.15; A.original_pose[0] | A.get_position(); Fluent(False, A) | Fluent(None, A); A.get(B, []) | A.setdefault(B, [])
0.15; A.get(B, {}) | A.setdefault(B, {}); (A % B, A % B) | (A // B, A % B); groupby(A) | groupby(sorted(A))
0.15; [X] * B | [X for _ in range(B)]; A.rstrip(K) | A.removesuffix(K); A.lstrip(K) | A.removeprefix(K)
0.15; V = A.append(B) | A.append(B); A.appendleft(B) | A.append(B); V = A.sort() | V = sorted(A); A.find(B) | B in A
0.15; A.insert(0, B) | A.append(B); A == K or L | A in (K, L); not A.get(B) | B not in A; Fluent(False) | Fluent()
0.15; int(A / B) | int(A // B)
0.3; range(X) | range(1, X) | range(X + 1) | range(X - 1); range(X, A) | range(X - 1, A) | range(X, A + 1)
0.3; atan2(A, B) | atan2(B, A) | 2 * atan2(A, B); range(1, A) | range(A) | range(1, A + 1); range(1, A + 1) | range(A)
0.3; math.degrees(A) | math.radians(A); A[K] - B[K] | (A[K] - B[K]) / 2; N or B | B if N is None else N
0.3; A // (B - K) | A / (B - K); dict(A, **B) | {**B, **A}; A.attach(B) | B.attach(A); {**A, **B} | {**B, **A}
0.3; range(A + 1) | range(A); range(A - 1) | range(A); degrees(A) | radians(A); not N | N is None
0.3; A + B * sin(C) | A - B * sin(C); A - B * sin(C) | A + B * sin(C); A + B if C else D | A + (B if C else D)
0.3; A + sin(C) * B | A - sin(C) * B; A - sin(C) * B | A + sin(C) * B; A - B if C else D | A - (B if C else D)
0.3; A + B * math.sin(C) | A - B * math.sin(C); A - B * math.sin(C) | A + B * math.sin(C); A.type | A
0.3; A + math.sin(C) * B | A - math.sin(C) * B; A - math.sin(C) * B | A + math.sin(C) * B
0.3; N.wait_for() | (N == True).wait_for(); accumulate(A) | accumulate(A, initial=0)
0.3?; A * 0.001 | A * 0.01; math.radians(A) | A; A / 1000 | A / 100; A / 100 | A / 1000; radians(A) | A; degrees(A) | A
0.35; A.set_value(K) | A.set_value(A.get_value() + K); (A - B) // C | (A - B) / C; A + B / C | (A + B) / C
0.35; A - B / C | (A - B) / C; A + B * C | (A + B) * C; A - B * C | (A - B) * C; A / B + C | A / (B + C)
0.35; A / B - C | A / (B - C); A * B + C | A * (B + C); A * B - C | A * (B - C); A / B * C | A / (B * C)
0.4; A[B:C] | A[:] | A[B:C + 1] | A[B - 1:C]; A[B:] | A[:] | A[B - 1:] | A[B + 1:]; A[:B] | A[:] | A[:B + 1] | A[:B - 1]
0.4; A or B and C | (A or B) and C; K - A ** L | K - 2 * A ** L; A - B < C | abs(A - B) < C; A - B + C | A - (B + C)
0.4; A + H | A + H / 2; A - H | A - H / 2; H + A | H / 2 + A; round(A, K) | A; A[0] | A[-1]; A[-1] | A[0]
0.43; F(A, B, C) | F(B, A, C) | F(A, C, B); F(A, B) | F(B, A)
0.45; set(A) | list(A) | sorted(A); A.startswith(B) | A == B; A.endswith(B) | A == B; int(A) | A
0.5; enumerate(A) | enumerate(A, 1); A.copy() | copy.deepcopy(A); A[X] | A[X - 1] | A[X + 1]; round(A) | A | round(A, 2)
0.5; A, *B = C | *B, A = C; return | continue; continue | break; A += B | A = B
0.5?; A not in B | A in B; A += B | A -= B; sorted(A) | A; abs(A) | A; A + K | A; A - K | A; not A | A; True | False
0.55?; A in B | A not in B; A is B | A is not B; A is not B | A is B; A <= B | A >= B; A >= B | A <= B; A == B | A != B
0.55?; A != B | A == B; A < B | A > B; A > B | A < B; False | True
0.58; A == B | A is B | abs(A - B) < 0.001; break | continue; A is B | A == B; A in B | A == B; A < B | A <= B
0.58; A > B | A >= B; A <= B | A < B; A >= B | A > B
0.65; A and B and C | A or B or C; A or B or C | A and B and C; A and B | A or B; A or B | A and B
0.65?; A.append(B) | A.insert(0, B); A / B | A * B | A // B; A // B | A / B | A % B; A - X | (A - X) / 2; A % B | A // B
0.65?; A and B | A | B; A or B | A | B
0.65?; A.pop() | A.pop(0); A.pop(0) | A.pop(); A - X | X - A; A + B | A - B; A - B | A + B; A * B | A / B
"""
_PARSED: Final = [
    (float(cost.rstrip("?")), "?" in cost, ast.parse(old).body[0], news)
    for cost, *rules in (row.split("; ") for row in _RULES.split("\n")[1:-1])
    for old, *news in (rule.split(" | ") for rule in rules)
]
_CLASSES: Final = (str, list, dict, set, Object, BulletWorld, Event, Fluent)
_METHODS: Final = {name for each in _CLASSES for name, value in vars(each).items() if callable(value)}
#: Functions and methods that only return a value.
_PURE: Final = {*vars(str), "copy", "deepcopy", "sorted", "union", "intersection", "round"} - {"index", "count"}
_VALUES: Final = ast.If | ast.While | ast.IfExp | ast.BoolOp | ast.UnaryOp | ast.Compare | ast.BinOp | ast.For
_COMPOUND: Final = ast.BinOp | ast.UnaryOp | ast.BoolOp | ast.Compare | ast.Attribute | ast.IfExp
_KEYS: Final = ("lambda each: each[1]", "lambda each: each[0]", "len", "int", "str.lower")
FAR: Final = 1.0  # cost of an edit that is larger than a typical mistake


def _number(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    value = written_number(node)
    if value is None:
        return
    is_count = isinstance(value, int) and value <= _FEW and node in plan.counts
    usual = max((each for each in plan.numbers if each != value), default=math.inf)
    for number, factor in enumerate(_FACTORS if value and not is_count and node not in plan.turns else ()):
        new = f"{value * factor:.6g}"  # without rounding errors, for the comparison too
        is_unit = value in plan.numbers and value >= _MANY * usual and float(new) <= usual
        is_unit &= not isinstance(getattr(plan.parents[node], "op", None), ast.Mult | ast.Div)  # numbers without a unit
        is_unit |= factor == _FACTORS[2] and not value % _RIGHT_ANGLES
        cost = 0.25 + 0.05 * number if is_unit else 0.3 + 0.1 * number + 0.4 * (number > 2)
        cost += _PASSED * (called_name(plan.parents[node]) in plan.functions)
        what = f"{value} times {factor:.3g}"
        is_unclear = isinstance(plan.parents[node], ast.Dict) and math.radians(value) <= usual  # maybe an angle
        change = instead(node, new, cost, what, asks=not is_unit, chance=not is_unit or is_unclear)
        yield change._replace(kind="_unit" if is_unit else "")
    if value and (isinstance(value, float) or node not in plan.counts | plan.turns):
        yield instead(node, f"{-value!r}", 0.46, f"the sign of {value}", asks=True)
    if isinstance(value, int) and node in plan.counts and called_name(plan.parents[node]) != "range":
        is_index = isinstance(plan.parents[node], ast.Subscript)
        for other in (value - 1, value + 1):
            yield instead(node, repr(other), 0.45 + 0.06 * is_index + 0.03 * (other > value), asks=not is_index)


def _frame(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a position in the world instead of a position relative to the robot."""
    position = written_numbers(node)
    for base in plan.bases if len(position) == 3 and position[2] else ():
        new = f"[{', '.join(f'{one + other:.6g}' for one, other in zip(position, base, strict=True))}]"
        yield instead(node, new, 0.4, f"{new}: {ast.unparse(node)} seen from {base}", asks=True, chance=True)


def _assigned(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a value that is added or copied, and the plan without an unused world: the newest world is current."""
    match node:
        case ast.Assign([ast.Name(name)], ast.Call(ast.Name("BulletWorld"))) if name in plan.unused:
            place = plan.offset(node.lineno), plan.offset((node.end_lineno or node.lineno) + 1)
            if len(plan.names["BulletWorld"]) > 1:
                yield Change(f"without the unused world {name}", 0.2, ((place, ""),))
        case ast.Assign([ast.Name(name) as target]) if name in plan.fields and not loads(plan.scope(node), {name}):
            yield instead(target, f"self.{name}", 0.15)
        case ast.Assign([ast.Name(name)], ast.Constant() | ast.Call() as value) if plan.in_loop(node):
            if written_number(value) or (name in plan.literals and isinstance(value, ast.Call)):
                yield instead(node, f"{name} += {ast.unparse(value)}", 0.3)
        case ast.Assign(value=value) | ast.Return(value) if isinstance(value, ast.Name | ast.Subscript | ast.Attribute):
            if any(isinstance(each, ast.Name) and each.id in plan.literals for each in ast.walk(value)):
                text = ast.unparse(value)
                new = f"{plan.literals[text]}({text})" if text in plan.literals else f"{text}.copy()"
                yield instead(value, new, 0.5)


def _angle(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield an angle in the other unit, and half of it."""
    parent = plan.parents.get(node, plan.tree)
    turned = called_name(parent) in ("sin", "cos", "tan") and isinstance(node, ast.expr) and node in parent.args  # type: ignore[attr-defined]
    if turned and not isinstance(plan.parents[parent], ast.BinOp):  # in a quaternion, not in a point of a circle
        yield instead(node, ast.unparse(ast.BinOp(node, ast.Div(), ast.Constant(2))), 0.3)  # type: ignore[arg-type]
    if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
        named = _ANGLE.fullmatch(ast.unparse(node)) is not None and node not in plan.called
        if (named or turned) and called_name(parent) not in ("radians", "degrees"):
            function = next((each for each, name in _RADIANS.items() if name in plan.defined), "0.0174533 * ")
            yield instead(node, f"{function}({ast.unparse(node)})", 0.35)


def _default(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a default value that each call makes anew."""
    if not isinstance(node, ast.FunctionDef):
        return
    given = node.args
    pairs = [*zip([*given.posonlyargs, *given.args][::-1], given.defaults[::-1], strict=False)]
    pairs += [(name, value) for name, value in zip(given.kwonlyargs, given.kw_defaults, strict=True) if value]
    for name, value in pairs:
        if isinstance(value, MUTABLE | ast.Call | ast.Attribute | ast.Subscript):
            start = node.body[ast.get_docstring(node) is not None and len(node.body) > 1]
            made = f"{name.arg} = {ast.unparse(value)} if {name.arg} is None else {name.arg}"
            text = f"{made}\n{' ' * start.col_offset}{plan.segment(start)}"
            yield Change(f"{ast.unparse(value)} for each call", 0.2, ((value, "None"), (start, text)))


def _late(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a function that keeps the variables of the loop around it."""
    if isinstance(node, ast.Lambda | ast.FunctionDef) and not node.args.vararg and not node.args.kwonlyargs:
        loops = [each for each in plan.around(node) if isinstance(each, ast.For | ast.comprehension)]
        loops += [each for around in plan.around(node) for each in getattr(around, "generators", ())]
        made = (stored(each if isinstance(each, ast.For) else each.target) for each in loops)
        names = set[str]().union(*made) - {each.arg for each in node.args.args}
        body = node.body if isinstance(node.body, list) else [node.body]
        used = sorted(name for name in names if any(loads(each, {name}) for each in body))
        if used:
            other = copy.deepcopy(node)
            other.args.args += [ast.arg(name) for name in used]
            other.args.defaults += [ast.Name(name, ast.Load()) for name in used]
            new = ast.unparse(other).replace("\n", f"\n{' ' * node.col_offset}")
            yield instead(node, new, 0.25, f"{', '.join(used)} of each iteration")


def _shadowing(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield a loop whose variable has a name of its own."""
    if not isinstance(node, ast.For):
        return
    for name in sorted(stored(node.target)):
        uses = [each for each in ast.walk(plan.scope(node)) if isinstance(each, ast.Name | ast.arg)]
        names = [each for each in uses if name in (getattr(each, "id", ""), getattr(each, "arg", ""))]
        earlier = [each for each in names if each.lineno < node.lineno and not loads(each, {name})]
        if earlier and any(each.lineno > (node.end_lineno or 0) for each in names):
            inside = (each for each in ast.walk(node) if each in names and isinstance(each, ast.Name))
            parts = tuple((each, f"{name}_2") for each in inside)
            yield Change(f"{name}_2 instead of {name} in the loop of line {node.lineno}", 0.3, parts)


def _handling(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield handlers that don't swallow an error, and loops that end after a success."""
    if isinstance(node, ast.ExceptHandler) and not any(isinstance(each, ast.Raise) for each in ast.walk(node)):
        for at, name in enumerate(sorted(plan.defined & {*vars(failures)})):
            yield instead(node.type or node, name, 0.3 + 0.02 * at)
        attempt = plan.parents[node]
        ends: list[tuple[ast.stmt, tuple[str, ...], float]] = [(node.body[-1], ("continue", "break", "raise"), 0.2)]
        ends += [(attempt.body[-1], ("break",), 0.25)] if isinstance(attempt, ast.Try) else []
        for last, jumps, cost in ends:
            for jump in jumps if plan.in_loop(node) else jumps[2:]:
                old = plan.segment(last)
                new = jump if isinstance(last, _JUMPS) else f"{old}\n{' ' * last.col_offset}{jump}"
                if new != old:
                    yield instead(last, new, cost, f"{jump} after line {last.end_lineno}")


def _calls(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield calls with a forgotten world."""
    if called_name(node) == "Object" and isinstance(node, ast.Call):
        worlds = sorted(plan.names["BulletWorld"]) if "world" not in {each.arg for each in node.keywords} else []
        for world in worlds if len(worlds) > 1 else ():
            yield instead(node, f"{plan.segment(node)[:-1]}, world={world})", 0.4, f"world={world}")


def _near_names(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield functions, methods and attributes that are confused, imported if necessary."""
    name = last_name(node) if isinstance(getattr(node, "ctx", None), ast.Load) else ""
    alias = next((each for each in plan.nodes if isinstance(each, ast.alias) and each.name == name), None)
    for at, other in enumerate(each for each in _MEANT.get(name, ()) if each != name):
        owner = ast.unparse(node.value) if isinstance(node, ast.Attribute) else ""
        is_global = not owner or (owner in plan.defined and other in vars(builtins))
        imports = ((alias, f"{name}, {other}"),) if alias and not owner and other not in plan.known else ()
        if alias or owner or name in vars(builtins):
            cost = 0.5 + 0.05 * at - 0.1 * isinstance(plan.parents[node], ast.withitem)
            change = instead(node, other if is_global else f"{owner}.{other}", cost, chance=name in _OPPOSITE)
            yield change._replace(parts=(*change.parts, *imports))


def forgotten_call(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield the call of a function instead of the function, and the reverse."""
    name, around = last_name(node), plan.parents.get(node)
    if isinstance(getattr(node, "ctx", None), ast.Load) and node not in plan.called and name not in plan.fields:
        is_method = name in _METHODS or any(getattr(each, "attr", "") == name for each in plan.called)
        if isinstance(around, ast.Expr) or name in plan.functions or (is_method and isinstance(node, ast.Attribute)):
            yield instead(node, f"{ast.unparse(node)}()", 0.15 if isinstance(around, _VALUES | ast.Expr) else 0.35)
    elif isinstance(node, ast.Call) and called_name(node) in plan.fields and not node.args:
        yield instead(node, ast.unparse(node.func), 0.15)
    elif called_name(node) in plan.functions and isinstance(around, ast.Call | ast.keyword | ast.AugAssign):
        has_arguments = isinstance(node, ast.Call) and (node.args or node.keywords)
        new = f"lambda: {ast.unparse(node)}" if has_arguments else ast.unparse(node).removesuffix("()")
        yield instead(node, new, 0.3 if plan.acts(node) else 0.6)


def _results(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield an assignment of a dropped result, and a function that returns its result."""
    match node:
        case ast.Expr(ast.Call(function, arguments) as call):
            name, owner = last_name(function), getattr(function, "value", None)
            if arguments and (owner is None or ast.unparse(owner) in plan.defined):
                owner = arguments[0]
            is_pure = name in _PURE or (name in plan.returning and not plan.acts(node))
            if is_pure and isinstance(owner, ast.Name | ast.Attribute | ast.Subscript):
                yield instead(node, f"{ast.unparse(owner)} = {ast.unparse(call)}", 0.3 - 0.15 * (name in _PURE))
        case ast.FunctionDef(name=name, body=[*_, last]) if name not in plan.returning:
            users = {type(plan.parents[each]) for each in plan.nodes if called_name(each) == name}
            names = [f"{plan.segment(last)}\n{' ' * last.col_offset}return {each}" for each in sorted(stored(node))]
            value = [f"return {plan.segment(last)}"] if isinstance(last, ast.Expr) else []
            for at, new in enumerate((*value, *names) if users - {ast.Expr, ast.Lambda} else ()):
                yield instead(last, new, 0.15 + 0.05 * at)


def _sorting(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield items in other orders."""
    if isinstance(node, ast.Call) and called_name(node) in ("sorted", "sort", "min", "max") and len(node.args) < 2:
        given = {str(each.arg): ast.unparse(each.value) for each in node.keywords}
        keys = [ast.unparse(each.value) for each in plan.nodes if isinstance(each, ast.keyword) and each.arg == "key"]
        keys += [*(f"lambda each: each.{field}" for field in sorted(plan.fields)), *_KEYS]
        orders = [{**given, "reverse": str(given.get("reverse") != "True")}] if "sort" in called_name(node) else []
        for at, slots in enumerate((*orders, *({**given, "key": key} for key in dict.fromkeys(keys)))):
            text = ", ".join((*map(ast.unparse, node.args), *(f"{each}={slots[each]}" for each in slots)))
            new = f"{ast.unparse(node.func)}({text.removesuffix(', reverse=False')})"
            yield instead(node, new, 0.4 + 0.06 * at, chance=slots in orders)


def _rules(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield what the table of rules has for a node."""
    around = plan.parents.get(node)
    skips = isinstance(around, ast.If) and around.test is node and isinstance(around.body[-1], ast.Continue)
    names = plan.parameters.get(called_name(node), [])
    given = [ast.unparse(each) for each in getattr(node, "args", ())] if isinstance(node, ast.Call) else []
    has_order = bool(names) and not any(map(str.__eq__, names, given))  # else an argument has its parameter's name
    is_method = isinstance(getattr(node, "func", None), ast.Attribute) and called_name(node) not in plan.functions
    has_order |= called_name(node) in vars(bullet_world_reasoning) or (is_method and all(map(str.isidentifier, given)))
    has_order &= sum(each[0].isidentifier() for each in given) > 1  # others are literals
    for cost, doubtful, pattern, news in _PARSED:
        found: dict[str, str] = {}
        if _matches(getattr(pattern, "value", None) if isinstance(pattern, ast.Expr) else pattern, node, found):
            is_key = isinstance(node, ast.Subscript) and plan.literals.get(found["A"]) == "dict"
            is_key |= isinstance(getattr(node, "slice", None), ast.BinOp)  # its numbers are shifted already
            for at, new in enumerate(news if not is_key and ("F" not in found or has_order) else ()):
                made = ast.parse(re.sub(r"\b[A-Z]\b", lambda each: f"({found[each[0]]})", new)).body[0]  # noqa: B023
                value, text = getattr(made, "value", None), ast.unparse(made)
                opens = isinstance(around, _COMPOUND) and isinstance(value, _COMPOUND) and type(value) is not type(node)
                chance = doubtful and not skips
                change = instead(node, f"({text})" if opens else text, cost + 0.03 * at - 0.25 * skips, chance=chance)
                yield change._replace(kind=new)


def _matches(pattern: object, node: object, found: dict[str, str]) -> bool:
    """Return whether a node has the form of a pattern; the texts of its parts are put into ``found``."""
    if isinstance(pattern, ast.Name) and pattern.id.isupper() and isinstance(node, ast.expr):
        is_same = found.setdefault(pattern.id, ast.unparse(node)) == ast.unparse(node)
        is_same = is_same and (pattern.id != "H" or _SIZE.search(ast.unparse(node)) is not None)
        excluded = _VALUES if pattern.id in "HN" else (ast.Constant, ast.Slice, ast.Starred)[pattern.id != "X" :]
        return is_same and not isinstance(node, excluded) and (pattern.id not in "KL" or isinstance(node, ast.Constant))
    if isinstance(pattern, list) and isinstance(node, list):
        return len(pattern) == len(node) and all(map(_matches, pattern, node, repeat(found)))
    if type(pattern) is not type(node) or not isinstance(pattern, ast.AST):
        return type(pattern) is type(node) and pattern == node  # False is 0
    names = [each for each in pattern._fields if each != "ctx"]
    return all(_matches(getattr(pattern, each), getattr(node, each), found) for each in names)


def _python(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:  # noqa: C901, PLR0912  one case for each mistake
    """Yield lists of values that are read twice, numbers instead of texts, and functions without cache."""
    around, text = plan.parents.get(node, plan.tree), ast.unparse(node) if isinstance(node, ast.expr) else ""
    match node:
        case ast.FunctionDef(decorator_list=[ast.Name() | ast.Attribute() | ast.Call() as cache]):
            if (called_name(cache) or last_name(cache)) in ("lru_cache", "cache"):
                place = plan.offset(cache.lineno), plan.offset((cache.end_lineno or 0) + 1)
                yield Change(f"{node.name} without cache", 0.15, ((place, ""),))
        case ast.For(iter=items):
            changing = (each for each in ast.walk(node) if called_name(each) in ("remove", "pop", "append"))
            if any(ast.unparse(each).startswith(f"{ast.unparse(items)}.") for each in changing):
                yield instead(items, f"list({ast.unparse(items)})", 0.15)
        case ast.Constant(str(word)) if not isinstance(around, ast.JoinedStr):
            if {*re.findall(r"{(\w+)[^{}]*}", word)} & plan.known.union(*plan.local.values()):
                yield instead(node, f"f{plan.segment(node)}", 0.15)
            if plan.words.count(word) == 1 and (node not in plan.scene or isinstance(around, ast.Dict)):
                others = {each for each in plan.words if each.strip(digits) != word.strip(digits)}
                yield from (instead(node, repr(each), 0.15) for each in get_close_matches(word, others, 2, 0.75))
        case ast.GeneratorExp() if called_name(around) in ("any", "all") and plan.acts(node):
            yield instead(around, f"{called_name(around)}([{text[1:-1]}])", 0.1)
        case ast.GeneratorExp() | ast.Call() if isinstance(around, _KEEPING):
            is_lazy = called_name(node) in (*_LAZY, *plan.generators)
            name = ast.unparse(getattr(around, "targets", [node])[0])
            if len(re.findall(rf"\b{re.escape(name)}\b", plan.text)) != 2:  # else it is read once
                yield from [instead(node, f"list({text})", 0.15)] if is_lazy else ()
                yield from [instead(node, f"[{text[1:-1]}]", 0.15)] if isinstance(node, ast.GeneratorExp) else ()
        case ast.Assign([target], value):
            if re.search(rf"\b(next|iter)\({re.escape(ast.unparse(target))}[,)]", plan.text):
                yield instead(value, f"iter({ast.unparse(value)})", 0.15)
            match plan.block(node)[plan.block(node).index(node) + 1 :]:  # a value that should be restored later
                case [ast.Assign([ast.Attribute() as other], ast.Name(same)), *_] if same == ast.unparse(value):
                    yield instead(value, ast.unparse(other), 0.15)
        case ast.While(ast.Compare(left, [ast.Lt() | ast.LtE()], [right]), [*_, ast.AugAssign(value=step) as last]):
            if ast.unparse(last.target) == ast.unparse(left):  # sums aren't exact
                yield instead(right, f"{ast.unparse(right)} - {ast.unparse(step)} / 2", 0.2)
        case ast.Name(ctx=ast.Load()) | ast.Subscript(ctx=ast.Load()) if called_name(around) not in _CONVERTING:
            is_field = "csv" in plan.defined and isinstance(getattr(getattr(node, "slice", None), "value", None), str)
            name = re.escape(text.partition("[")[0])
            if is_field or re.search(_PARTS.format(name), plan.text, re.MULTILINE):
                cost = 0.15 if isinstance(around, ast.Lambda | ast.Compare | ast.BinOp | _KEEPING) else 0.3
                news = f"float({text})", f"int({text})", f"{text}.strip()", f"{text}.lower()"
                yield from (instead(node, new, cost + 0.01 * at) for at, new in enumerate(news))
    forms = set[str]().union(*(plan.forms[role] for role in plan.roles[node] if not isinstance(node, ast.Call)))
    yield from (instead(node, f"{form}({text})", 0.15) for form in sorted(forms))


def _blocks(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield branches instead of plain code in a block, performed designators, and containers that aren't shared."""
    match node:
        case ast.With(items=[ast.withitem(ast.Name("par" | "seq" | "pursue" | "try_all") as block, name)]):
            called = ast.unparse(name) if name else "block"
            for call in (each.value for each in node.body if isinstance(each, ast.Expr)):
                if isinstance(call, ast.Call) and ast.unparse(call.func) not in ("perform", "print", called):
                    new = f"{called}({', '.join(map(ast.unparse, (call.func, *call.args, *call.keywords)))})"
                    parts = ((call, new), *(() if name else ((block, f"{block.id} as block"),)))
                    yield Change(f"{new} instead of {ast.unparse(call)}", 0.2, parts)
        case ast.Expr(ast.Call(ast.Name(name)) as call):
            if re.search(rf"from pycram\.\w+_designators import .*\b{name}\b", plan.text):
                yield instead(call, f"perform({ast.unparse(call)})", 0.1)
        case ast.FunctionDef(name="__init__", body=[first, *_]):
            for each in plan.block(node):
                if isinstance(each, ast.Assign) and isinstance(each.value, MUTABLE):
                    new, start = f"self.{ast.unparse(each)}\n{' ' * first.col_offset}", plan.span(first, first)[0]
                    line = plan.offset(each.lineno), plan.offset((each.end_lineno or 0) + 1)
                    yield Change(f"{ast.unparse(each)} for each object", 0.15, ((line, ""), ((start, start), new)))


def _slots(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield calls with a slot of another call, or of a variable with the same name; and other attributes."""
    if isinstance(node, ast.Call) and all(each.arg for each in node.keywords):
        name, given = called_name(node), {each.arg for each in node.keywords}
        names = plan.parameters.get(name, [])[len(node.args) :]
        news = [ast.keyword(each, ast.Name(each)) for each in names if each in plan.local[plan.scope(node)]]
        others = (each.keywords for each in plan.nodes if isinstance(each, ast.Call) and called_name(each) == name)
        news += [each for keywords in others for each in keywords]
        calls = (ast.Call(node.func, node.args, [*node.keywords, each]) for each in news if each.arg not in given)
        for at, new in enumerate(dict.fromkeys(map(ast.unparse, calls))):
            yield instead(node, new, 0.42 + 0.05 * at)
    elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load) and node not in plan.called:
        fields = set[str]().union(*(each for each in plan.classes if node.attr in each))
        is_key = getattr(plan.parents[node], "key", None) is node  # objects with equal keys replace each other
        for at, name in enumerate(sorted(fields - {node.attr})):
            new, chance = f"{ast.unparse(node.value)}.{name}", all(map(_AXIS.fullmatch, (name, node.attr)))
            yield instead(node, new, (0.2 if is_key else 0.5) + 0.05 * at, chance=chance)


def _structure(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield other forms of an expression: operators, order of items, and the opposite of a condition."""
    match node:
        case ast.List([_, _, *_] as items) | ast.Tuple([_, _, *_] as items) if len(items) <= 4:
            turned = [[*items[1:], items[0]], [items[-1], *items[:-1]]] if len(items) == 4 else []
            swapped = [[*items[:at], items[at + 1], items[at], *items[at + 2 :]] for at in range(len(items) - 1)]
            swapped += [items[::-1]] if len(items) == 3 else []
            for at, order in enumerate((*turned, *swapped)):
                swaps, new = at >= len(turned), ast.unparse(type(node)(order, ast.Load()))
                by_chance = swaps and isinstance(node.ctx, ast.Load)
                yield instead(node, new, 0.42 if swaps else 0.35 + 0.1 * at, asks=True, chance=by_chance)
        case ast.Dict([_, _], [one, other]):
            exchanged = ((one, plan.segment(other)), (other, plan.segment(one)))
            yield Change(f"{exchanged[1][1]} and {exchanged[0][1]} exchanged", 0.42, exchanged, asks=True, chance=True)
        case ast.If(test, [*body], [ast.If(second, [*others]) as other]) if other.col_offset == node.col_offset:
            ends = (test, test), (second, second), (body[0], body[-1]), (others[0], others[-1])
            news = (plan.segment(*ends[at]) for at in (1, 0, 3, 2))
            parts = tuple(zip((plan.span(*each) for each in ends), news, strict=True))
            yield Change(f"the condition of line {other.lineno} before that of line {node.lineno}", 0.3, parts)
    is_test = getattr(plan.parents.get(node), "test", None) is node
    if is_test and not isinstance(node, ast.Compare | ast.BoolOp | ast.UnaryOp):
        yield instead(node, f"not ({ast.unparse(node)})", 0.56)
        yield instead(node, f"{ast.unparse(node)} is not None", 0.4)


def _objects(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield objects instead of an undefined name, and an unused object instead of the later copy in a list."""
    if isinstance(node, ast.Name) and node not in plan.called and node.id not in plan.known.union(*plan.local.values()):
        for at, name in enumerate(sorted(plan.names["Object"] - plan.fixed)):
            yield instead(node, name, 0.2 + 0.01 * at)
    texts = [getattr(each, "value", each) for each in getattr(node, "elts", ())]
    for at, text in [*enumerate(texts)][::-1]:
        for name in sorted(plan.forgotten) if isinstance(text, str) and texts.count(text) > 1 else ():
            yield instead(node.elts[at], repr(name), 0.05 - 0.001 * at)  # type: ignore[attr-defined]


def similar_name(node: ast.Name, plan: PlanSyntax) -> Iterator[Change]:
    """Yield other variables with the same role."""
    fitting = set[str]().union(*(each for each in plan.names.values() if node.id in each)) - plan.later(node)
    for name in sorted(fitting - {node.id, "_"} - (set() if node.id in plan.fixed else plan.fixed)):
        chance = bool(_AXIS.fullmatch(name) and _AXIS.fullmatch(node.id))
        yield instead(node, name, 0.6, asks=name in plan.constants, chance=chance)


_OPERATORS: Final = (
    *(_number, _frame, _angle, _assigned, _calls, _structure, _objects),
    *(_default, _late, _shadowing, _handling, _near_names, forgotten_call),
    *(_results, _sorting, _rules, _python, _blocks, _slots),
)


def changes(node: ast.AST, plan: PlanSyntax) -> Iterator[Change]:
    """Yield the changes of a node."""
    return (change._replace(kind=change.kind or each.__name__) for each in _OPERATORS for change in each(node, plan))
