"""Small edits of a plan, each at one place: candidates for a repair.

An edit changes a syntax node (:mod:`.operators`), moves a statement, or inserts a wait or another call of the plan.
No edit removes a statement (except an unused world), or changes an assertion or what only assertions use, so a repair
can't succeed by dropping the plan's goal.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from recorder.plan_lines import called_name, stored
from replay.fix.operators import FAR, changes, forgotten_call, similar_name
from replay.fix.plan_syntax import READING, Change, PlanSyntax, asserts, loads
from replay.history.oddities import is_strong, oddities

_STALE: Final = 0.6  # by how much an edit of a line with stale values is likelier
_ODD: Final = 0.15  # additional cost of a change of only one of several equal parts
_IDIOM: Final = 0.3  # largest cost of a mistake that is made alike in all items of a list
_UNUSED: Final = 0.35  # by how much an edit with a name that the plan doesn't use is likelier
_AROUND: Final = 0.1  # additional cost of an edit of the condition or loop around a line
_BLOCKS: Final = ast.For | ast.While | ast.If | ast.With
_JUMPS: Final = ast.Return | ast.Raise | ast.Break | ast.Continue
_SCENE: Final = 0.3  # additional cost of an edit of a loaded object
_WAITS: Final = ("settle()", "simulate(1)")
CERTAIN: Final = 0.2  # largest cost of an edit of what is hardly ever meant
_STRUCTURAL: Final = 0.5  # largest cost of edits that are tried on all lines
#: Calls that aren't inserted: they reach a goal, or make the scene.
_NOT_AGAIN: Final = {
    *("set_gravity", "pick_up", "place", "placing", "picking_up", "transporting", "Object", "BulletWorld")
}


@dataclass(frozen=True, slots=True, order=True)
class Edit:
    """An edited plan."""

    cost: float  # cost: low for probable edits, equal for edits of the same kind
    line: int  # number of the edited line
    what: str  # text of the edit
    text: str  # the whole source after the edit
    asks: bool = False  # whether a value or name changes, rather than the way in which values are computed
    chance: bool = False  # whether only the success of the run supports it
    kind: str = ""  # name of the operator that made it

    def evidence(self, before: str) -> str:
        """Return what supports the edit of a source besides the success of its runs; "" for nothing."""
        if self.kind == "_unit":
            return "" if self.asks else "other numbers of the plan suggest it"
        slip, lines = oddities(before).get(self.line, ""), self.text.splitlines()
        is_inserted = len(lines) > before.count("\n") and before.splitlines()[self.line - 1] in lines
        mends = self.kind != "_number" and not is_inserted and slip not in oddities(self.text).values()
        return f"that line: {slip}" if is_strong(slip) and mends else ""


class Editor:
    """Edits one source file."""

    def __init__(self, text: str) -> None:
        self.plan = PlanSyntax(text)
        self.changes = self._changes()
        self.points: list[list[float]] = []  # lists of numbers in the failure; their edits come first
        #: The lines of handlers that swallow errors.
        handlers = (node for node in self.plan.nodes if isinstance(node, ast.ExceptHandler))
        self.handlers = [node.lineno for node in handlers if not any(map(asserts, ast.walk(node)))]

    def edits(self, line: int, alternatives: Iterable[Iterable[str]] = (), *, stale: bool = False) -> Iterator[Edit]:
        """Yield the edits of a line.

        Args:
            line: its number.
            alternatives: sets of texts that can replace each other, such as names of arms.
            stale: whether the line uses values that were true only earlier, so that its statement comes too early.
        """
        sets = [set(each) for each in alternatives]
        plan = self.plan
        nodes = [node for node in plan.nodes if getattr(node, "lineno", 0) == line]
        used = {each for point, numbers in plan.lists if numbers in self.points for each in ast.walk(point)}
        for node in sorted(nodes, key=lambda node: node not in used):
            if node in plan.goals:  # a function in a condition is always true
                yield from (self._edit(each, line) for each in forgotten_call(node, plan) if each.cost < CERTAIN)
                continue
            for change in (*self._names(node, sets), *self.changes[node]):
                likely = _STALE * (stale and change.what.endswith("()")) + _UNUSED * self._is_forgotten(change)
                yield self._edit(change, line, _SCENE * (node in plan.scene) - likely)
            if isinstance(node, ast.stmt):
                around = plan.parents[node]
                for change in self.changes[around] if isinstance(around, ast.If | ast.For) else ():
                    yield self._edit(change, around.lineno, _AROUND)  # type: ignore[attr-defined]
                yield from (self._edit(each, line, -_STALE * stale) for each in self._moves(node))

    def structural(self) -> Iterator[Edit]:
        """Yield the likeliest edits of the whole plan that change how values are computed, not the values."""
        for node in self.plan.nodes:
            moves = self._moves(node) if isinstance(node, ast.stmt) and node not in self.plan.goals else ()
            for each in (*self.changes[node], *moves):
                if each.cost <= _STRUCTURAL and not each.asks and not each.chance:
                    yield self._edit(each, node.lineno)  # type: ignore[attr-defined]

    def _changes(self) -> dict[ast.AST, list[Change]]:
        """Return the changes of nodes; equal expressions change together, and a change of only one of them is odd."""
        found = {node: [*changes(node, self.plan)] if node not in self.plan.goals else [] for node in self.plan.nodes}
        alike: dict[object, list[tuple[list[Change], Change]]] = defaultdict(list)
        for node, each in [(node, each) for node, made in found.items() for each in made if not each.asks]:
            (place, new), *others = each.parts
            if isinstance(place, ast.expr) and not isinstance(place, ast.Constant) and not others:
                old, around = ast.unparse(place), self.plan.parents[place]
                is_rule = isinstance(around, ast.Tuple | ast.List) and each.kind[:1] != "_"
                where = around if is_rule else self.plan.scope(place) if old in new else place.lineno
                alike[where, each.kind, *((old, new) if not is_rule else ())].append((found[node], each))
        for twins in (each for each in alike.values() if len(each) > 1):
            parts = tuple(part for _, each in twins for part in each.parts)
            for own, each in twins:
                odd = _ODD * (each.cost <= _IDIOM or each.kind[:1] == "_")  # items may have different operators
                own[own.index(each)] = each._replace(cost=each.cost + odd, chance=bool(odd) or each.chance)
                own.append(each._replace(cost=each.cost - odd, parts=parts, what=f"{each.what}, {len(twins)} times"))
        return found

    def insertions(self, line: int) -> Iterator[Edit]:
        """Yield the plan with a wait, or a call that the plan makes elsewhere, before a line."""
        plan = self.plan
        measuring = (node for node in plan.nodes if node in plan.goals and isinstance(node, ast.stmt))
        line = next((node.lineno for node in measuring if node.lineno <= line <= (node.end_lineno or 0)), line)
        indent = re.match(r"\s*", plan.lines[line - 1])[0]  # type: ignore[index]
        waits = [(f"{each}.{call}", FAR) for each in sorted(plan.names["BulletWorld"])[:1] for call in _WAITS]
        place = plan.offset(line), plan.offset(line)
        for call, cost in (*waits, *self._other_calls(line)):
            yield self._edit(Change(f"{call} before line {line}", cost, ((place, f"{indent}{call}\n"),)), line)

    def _other_calls(self, line: int) -> Iterator[tuple[str, float]]:
        """Yield calls of the plan's other statements, also with other names in the same role."""
        plan = self.plan
        here = next((node for node in plan.nodes[::-1] if getattr(node, "lineno", 0) == line), plan.tree)
        known = plan.local[plan.tree] | plan.local[plan.scope(here)] | plan.defined | {*plan.functions}
        found: dict[str, float] = {}
        calls = [node.value for node in plan.nodes if isinstance(node, ast.Expr) and node.value not in plan.goals]
        for call in (each for each in calls if isinstance(each, ast.Call) and each.lineno != line and plan.acts(each)):
            if call.end_lineno != call.lineno or _NOT_AGAIN & {*map(called_name, ast.walk(call))}:
                continue
            cost = 0.9 + 0.1 * (isinstance(call.func, ast.Attribute) and call.func.attr != "perform")
            found.setdefault(plan.segment(call), cost)
            names = [each for each in ast.walk(call) if isinstance(each, ast.Name) and each not in plan.called]
            for change in (change for each in names for change in similar_name(each, plan)):
                text = plan.replaced(change.parts, call)
                more = 0.3 - 2 * _UNUSED * self._is_forgotten(change)
                found[text] = min(found.get(text, FAR + 1), cost + more)
        for text, cost in found.items():
            if {each.id for each in ast.walk(ast.parse(text)) if isinstance(each, ast.Name)} <= known:
                yield text, cost

    def _is_forgotten(self, change: Change) -> bool:
        """Return whether a change uses a name that the plan defines, but doesn't use."""
        return any(set(re.findall(r"\w+", new)) & self.plan.unused for _, new in change.parts)

    def _names(self, node: ast.AST, sets: Sequence[set[str]]) -> Iterator[Change]:
        plan = self.plan
        if node in plan.scene:
            return
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            fitting = set[str]().union(*(each for each in (*sets, *plan.strings.values()) if node.value in each))
            around = plan.parents[node]
            listed = [*ast.iter_child_nodes(around)] if isinstance(around, ast.List | ast.Tuple | ast.IfExp) else []
            others = {each.value for each in listed if isinstance(each, ast.Constant)}
            for text in sorted(fitting - {node.value} - plan.fixed):
                what = f"{text!r} instead of {node.value!r}"
                chance = text in others or (isinstance(around, ast.keyword) and plan.scope(node) is plan.tree)
                yield Change(what, 0.4, ((node, repr(text)),), asks=True, chance=chance)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield from similar_name(node, plan)

    def _moves(self, statement: ast.stmt) -> Iterator[Change]:
        """Yield moves of a statement: in its block, to a use of its values, or into or out of a loop."""
        plan = self.plan
        block, parent = plan.block(statement), plan.parents[statement]
        if len(block) < 2 or isinstance(statement, ast.Import | ast.ImportFrom | ast.FunctionDef | ast.ClassDef):
            return
        at = block.index(statement)
        made = stored(statement) if isinstance(statement, ast.Assign) else set[str]()
        reads = bool(made) and plan.acts(statement, READING)
        uses = [to for to in range(at + 1, len(block)) if loads(block[to], made)]
        for to in dict.fromkeys((at + 1, at - 1, at + 2, at - 2, *(each - 1 for each in uses[:1] if each > at + 3))):
            crossed = block[min(at, to) : max(at, to) + 1]
            needed = [(statement, each) if to < at else (each, statement) for each in crossed if each is not statement]
            undefined = any(loads(one, stored(other)) and not isinstance(other, ast.For) for one, other in needed)
            evades = any(map(self._is_check, crossed)) or (to > at and not plan.goals.isdisjoint(crossed))
            evades |= any(isinstance(each, _JUMPS) for each in crossed)  # what comes behind it would never run
            if 0 <= to < len(block) and not undefined and not evades:
                is_early = reads and to + 1 in uses[:1] and any(map(plan.acts, crossed[1:]))
                is_late = reads and to == at - 1 and plan.acts(block[to])
                cost = 0.3 if is_early else 0.45 if is_late else 0.7
                yield self._moved(statement, block[to], cost, f"line {block[to].lineno}", after=to > at)
        between = block[at + 1 : uses[0]] if uses else []
        stays = getattr(statement, "value", None) in plan.scene or any(map(self._is_check, between))
        stays |= len(uses) > 1 and isinstance(block[uses[0]], ast.For | ast.While)  # the loop collects for later
        inner = block[uses[0]] if uses and not stays else None
        while inner is not None and isinstance(inner, ast.For | ast.While | ast.With):
            moved = self._moved(statement, inner.body[0], 0.4, "")
            yield moved._replace(what=f"line {statement.lineno} into the block of line {inner.lineno}")
            inner = next((each for each in inner.body if loads(each, made)), None)
        is_last = at == len(block) - 1
        if isinstance(parent, ast.For | ast.While) and statement in parent.body and at == 0 and made:
            yield self._moved(statement, parent, 0.45, "the loop")
        early = isinstance(parent, ast.With) and reads and not uses  # the block acts only at its end
        if (is_last or early) and isinstance(parent, _BLOCKS) and not self._is_check(statement):
            ends, loops = isinstance(statement, _JUMPS), isinstance(parent, ast.For | ast.While)
            cost = 0.3 if early else 0.6 if not ends else 0.4 if loops else 0.15
            if not ends or plan.block(parent)[-1] is parent:
                yield self._moved(statement, parent, cost, "the block", after=True)
        above = block[at - 1] if at and not self._is_check(statement) else None
        if isinstance(above, _BLOCKS) and not (self._is_check(above) or isinstance(above.body[-1], _JUMPS)):
            last, counts = above.body[-1], isinstance(statement, ast.AugAssign) and loads(above, stored(statement))
            yield self._moved(statement, last, 0.2 if counts else 0.5, f"line {last.lineno}, in its block", after=True)

    def _is_check(self, statement: ast.stmt) -> bool:
        """Return whether a statement contains an assertion, directly or in a called function."""
        names = (getattr(each, "id", "") for each in ast.walk(statement))
        return any(map(asserts, ast.walk(statement))) or not self.plan.checks.isdisjoint(names)

    def _moved(self, statement: ast.stmt, other: ast.stmt, cost: float, where: str, *, after: bool = False) -> Change:
        """Return the move of a statement before or after another one."""
        plan, start, shift = self.plan, statement.lineno, statement.col_offset
        end, indent = statement.end_lineno or start, " " * other.col_offset
        lines = (f"{indent}{line[shift:]}" if line.strip() else line for line in plan.lines[start - 1 : end])
        to = plan.offset((other.end_lineno or other.lineno) + 1 if after else other.lineno)
        what = f"line {start} {'after' if after else 'before'} {where}"
        return Change(what, cost, (((plan.offset(start), plan.offset(end + 1)), ""), ((to, to), "".join(lines))))

    def _edit(self, change: Change, line: int, more: float = 0) -> Edit:
        text = self.plan.replaced(change.parts)
        return Edit(change.cost + more, line, change.what, text, change.asks, change.chance, change.kind)
