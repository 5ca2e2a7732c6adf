"""A property or the plan's own check failed: the change that wrote the compared value."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from recorder import geometry
from recorder.plan_lines import syntax_nodes
from recorder.records import Mutation
from replay.explain.causes import trials
from replay.explain.causes.case import HANDLER, Cause, CausingChange, FailureCase
from replay.explain.causes.trials import Trial
from replay.history.blame import Blame, blame, commanded
from replay.history.source import Line
from replay.report import phrases
from replay.report.question import written
from replay.state.fold import state_at

if TYPE_CHECKING:
    from recorder.geometry import Pose

_AXES: Final = ("x", "y", "z")
_READS: Final = {"get_position": _AXES, "get_pose": _AXES, "get_orientation": ("turn",) * 4}
_WROTE: Final = 0.05  # a simulation that changes a compared value by less (m, rad) didn't write it
_ASIDE: Final = 0.01  # by so much a trial changes a compared coordinate, m
_DEPTH: Final = 3  # definitions of names that are followed
_SEARCHED: Final = 200  # this many changes are searched for other objects
_OBJECT: Final = re.compile(r"<Object ([^<>]+)>")


@dataclass(frozen=True, slots=True)
class Written(Cause):
    """A change wrote the value that a property or the plan compares."""

    kind = "written"
    untestable = "a fork can only take back the last change, and no loading"
    body: str
    part: str  # "x", "y", "z" or "turn"; "" for the whole pose
    value: float | None  # compared value in m; None for "turn" and ""
    change: CausingChange
    others: tuple[CausingChange, ...]  # if the change is the object's loading: later changes of other objects

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Written]:
        """Yield the last change of each compared value, latest change first."""
        found: list[Written] = []
        for name, part in dict.fromkeys(compared(case)) if case.world is not None else ():
            last = _writer(case, name, part)
            if last is None or last.how in ("physics", "before", "removed") or not isinstance(last.record, Mutation):
                continue
            change = case.change(last.record, name, last.how, size=(last.distance, last.angle))
            if change.task is None or change.task.kind not in ("motion", HANDLER):
                change = replace(change, line=case.line_of(last.record))
            others = tuple(_others(case, change.step)) if last.how == "load" else ()
            value = _coordinate(last.after, part)
            steps = tuple(sorted({*(each.step for each in others), change.step, case.step}))
            if (name, change.step) not in [(each.body, each.change.step) for each in found]:
                found.append(Written(steps, name, part, value, change, others))
        yield from sorted(found, key=lambda each: -each.change.step)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trial without the last of the changes; a loading has none, because the plan needs the object."""
        last = next(Written.find(case), self)
        if self.change.how != "load" and last.change.step == self.change.step:
            yield from (replace(trial, compares=True) for trial in self._without(case))

    def _without(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials without the change, with the former pose, and with another value."""
        if self.change.how == "command" and self.change.task is None:
            skip = f"set_position(object={written(self.body)})=skip"
            yield Trial(self.change.step - 1, f"{self.body} isn't moved", answers=(skip,))
        yield from trials.put_back(case, self.change)
        if self.part in _AXES and case.world is not None and self.body in case.world.bodies:
            now = state_at(case.log, self.change.step).worlds[case.world.name].bodies[self.body].position
            near = [at + _ASIDE * (axis == self.part) for axis, at in zip(_AXES, now, strict=True)]
            yield from trials.placed(case, self.body, near, self.change.step)

    def _words(self) -> Iterator[str]:
        if self.value is not None:
            what = f"{self.body}.{self.part} is {phrases.number(self.value)} since"
        else:
            what = f"{self.body}'s {'orientation' if self.part else 'pose'} is from"
        yield f"{what} step {self.change.step}: {self.change}"
        for each in self.others:
            yield f"{each.row}; {self.body} was not"


def _writer(case: FailureCase, name: str, part: str) -> Blame | None:
    """Return the last change of a part of a pose that is more than settling; None for an unknown body."""
    step = case.data.get("step")
    last = case.blame(name)
    if isinstance(step, int) and 0 <= step < case.step and last is not None:
        last = blame(case.log, name, step, last.world)
    while last is not None and last.how == "physics" and last.earlier is not None and not _wrote(last, part):
        last = blame(case.log, name, last.record.seq - 1, last.world)
    return last


def _wrote(change: Blame, part: str) -> bool:
    before, after = change.before, change.after
    if not isinstance(before, tuple) or not isinstance(after, tuple):
        return True
    turned = geometry.angle(before[1], after[1]) if part in ("turn", "") else 0.0
    moved = [abs(a - b) for axis, a, b in zip(_AXES, before[0], after[0], strict=True) if part in (axis, "")]
    return max([turned, *moved]) >= _WROTE


def _coordinate(pose: Pose | float | None, part: str) -> float | None:
    return pose[0][_AXES.index(part)] if isinstance(pose, tuple) and part in _AXES else None


def _others(case: FailureCase, since: int) -> Iterator[CausingChange]:
    """Yield one command for each line that moved other objects since a step, and not this object."""
    moved: dict[tuple[str, int], list[Mutation]] = {}
    for number, record in enumerate(case.log.backwards(case.step, Mutation)):
        if record.seq <= since or number >= _SEARCHED:
            break
        if record.HasField("move_body") and case.free_body(commanded(record)) is not None and case.is_here(record):
            moved.setdefault((record.source_file, record.source_line), []).append(record)
    for records in moved.values():
        yield case.change(records[-1], commanded(records[-1]), "command")


# --- what is compared ------------------------------------------------------------------------------------------------


def compared(case: FailureCase) -> Iterator[tuple[str, str]]:
    """Yield the bodies and parts of poses that a property or a check of the plan compares."""
    bodies = case.world.bodies if case.world is not None else {}
    if case.failure.type == "PropertyViolated":
        for name in bodies:
            for each in re.finditer(rf"(?<![\w.]){re.escape(name)}(?:\.(\w+))?(?!\w)", str(case.data.get("property"))):
                if case.free_body(name) is not None or each[1]:
                    yield name, each[1] if each[1] in _AXES else ""
        return
    error = next(reversed(case.traced), None)
    if error is None or not error.own or not error.lines or case.motion is not None:
        return
    line = error.lines[-1]
    frames = {(each.file, each.line): each.variables for each in case.failure.frames}
    values = {each.name: each.value for each in frames.get((line.file, line.number), ())}
    robot = case.world.robot if case.world is not None else ""
    for owner, part in _reads(syntax_nodes(case.source.text(line.file)), line):
        named = [robot] if isinstance(owner, ast.Attribute) and owner.attr == "robot" else _objects(owner, values)
        if len(named) != 1 and part:
            named = [name for name in case.mentioned if name in named] or list(case.mentioned)
        if part or len(named) == 1:
            yield from ((name, part) for name in named if name == robot or case.free_body(name) is not None)


def _reads(nodes: Sequence[ast.AST], line: Line) -> Iterator[tuple[ast.expr, str]]:
    """Yield the owners and the parts of the poses that flow into a check of the plan."""
    around = [
        each for each in nodes if isinstance(each, ast.stmt) and each.lineno <= line.number <= (each.end_lineno or 0)
    ]
    outer = [at for at, each in enumerate(around) if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)]
    around = around[outer[-1] :] if outer else around
    if not around or not isinstance(around[-1], ast.Assert | ast.Raise):
        return
    functions = [
        each for each in nodes if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef) and each not in around
    ]
    others = {id(each) for function in functions for each in ast.walk(function)}
    scope = [each for each in (ast.walk(around[0]) if outer else nodes) if isinstance(each, ast.Assign)]
    scope = sorted((each for each in scope if outer or id(each) not in others), key=lambda each: each.lineno)
    tests = [each.test for each in around if isinstance(each, ast.Assert | ast.If)][-1:]
    waiting: list[tuple[ast.AST, str | None, int]] = [(test, None, _DEPTH) for test in tests]
    seen: set[str] = set()
    for node, wanted, depth in waiting:  # the list grows
        for each in ast.walk(node):
            if isinstance(each, ast.Call) and isinstance(each.func, ast.Attribute) and each.func.attr in _READS:
                yield each.func.value, wanted if wanted is not None else _part(node, each)
            elif isinstance(each, ast.Call):
                yield from ((given, "") for given in each.args if isinstance(given, ast.Name))
            elif isinstance(each, ast.Name) and each.id not in seen and depth:
                seen.add(each.id)
                made = [other for other in scope if other.lineno < line.number and _binds(other, each.id)]
                last = made[-1:]
                waiting += [(other.value, _unpacked(other, each.id) or _item(node, each), depth - 1) for other in last]


def _binds(statement: ast.Assign, name: str) -> bool:
    return any(isinstance(each, ast.Name) and each.id == name for part in statement.targets for each in ast.walk(part))


def _unpacked(statement: ast.Assign, name: str) -> str | None:
    """Return the part of a position that a statement unpacks into a name; None if it unpacks nothing."""
    target, value = statement.targets[0], statement.value
    called = value.func.attr if isinstance(value, ast.Call) and isinstance(value.func, ast.Attribute) else ""
    if isinstance(target, ast.Tuple) and called in _READS:
        at = next(at for at, each in enumerate(target.elts) if isinstance(each, ast.Name) and each.id == name)
        return _READS[called][at] if at < len(_READS[called]) else ""
    return None


def _part(node: ast.AST, call: ast.Call) -> str:
    """Return the part of a pose that an expression takes from a call."""
    parts = _READS[call.func.attr] if isinstance(call.func, ast.Attribute) else ()
    found = _item(node, call, parts)
    return found if found is not None else parts[0] if parts and len(set(parts)) == 1 else ""


def _item(node: ast.AST, inner: ast.expr, parts: Sequence[str] = _AXES) -> str | None:
    for each in ast.walk(node):
        if isinstance(each, ast.Subscript) and each.value is inner and isinstance(each.slice, ast.Constant):
            at = each.slice.value
            return parts[at] if isinstance(at, int) and -len(parts) <= at < len(parts) else None
    return None


def _objects(owner: ast.expr, values: Mapping[str, str]) -> list[str]:
    """Return the names of the objects in the recorded variables that an expression reads."""
    if isinstance(owner, ast.Subscript) and isinstance(owner.value, ast.Name):
        key = values.get(ast.unparse(owner.slice), ast.unparse(owner.slice))
        return re.findall(rf"{re.escape(key)}: <Object ([^<>]+)>", values.get(owner.value.id, ""))
    names = [each.id for each in ast.walk(owner) if isinstance(each, ast.Name)]
    return [found for name in names for found in _OBJECT.findall(values.get(name, ""))]
