"""The plan's own code raised the failure, contains a mistake, or compares a value: the change that wrote the value."""

from __future__ import annotations

import ast
import builtins
import copy
import math
import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final, TypeAlias

from recorder import geometry
from recorder.plan_lines import called_name, syntax_nodes
from recorder.records import Fluent, Mutation, Query, Refusal, Task, argument_values, from_json
from recorder.records.text import is_choice
from recorder.tasks import Node
from replay.explain.causes import trials
from replay.explain.causes.case import HANDLER, Cause, CausingChange, FailureCase
from replay.explain.causes.trials import Trial
from replay.history.blame import Blame, blame, commanded
from replay.history.source import Line
from replay.report import phrases
from replay.report.question import written
from replay.state.state import World

_MAX_ANSWERS: Final = 3
_SEARCHED: Final = 1_000  # number of changes of fluents that are searched
#: ``raise`` or ``assert`` in a line, also after the head of a compound statement.
_RAISES: Final = re.compile(r"(^|[:;]\s*)(raise|assert)\b")
#: PyCRAM's usage errors. Errors that mean a mistake in the plan's line, even if they are raised inside a motion.
USAGE_ERRORS: Final = frozenset(
    (
        "AssetError", "AttachmentError", "BadArgument", "BlockClosed", "ChangeRefused", "Deadlock",
        "DeadlockedBranches", "DesignatorError", "DisplayError", "FollowsTrajectory", "JointLimitError", "LockHeld",
        "Misnested", "NoDescription", "NoProcessModule", "NoResult", "NoWorld", "NotExplorable", "NotProjectable",
        "NotSettable", "NotTrueOrFalse", "ObjectsChanged", "OutlivesTimeout", "PluginFailed", "ReadOnly",
        "ResourceError", "RunsEarly", "SweepRefused", "UnknownName", "UsageError", "WorldClosed",
    )
)  # fmt: skip
_INTERRUPTS: Final = ("KeyboardInterrupt", "TimedOut", "Cancelled")


@dataclass(frozen=True, slots=True)
class Raised(Cause):
    """The plan's own code raised the failure, or has a mistake that Python or PyCRAM rejected."""

    kind = "raised"
    untestable = "nothing that a fork can change is known to decide this line"
    type: str  # type of the exception
    line: Line  # the plan's line
    own: bool  # whether the line is a ``raise`` or ``assert``, rather than a mistake
    task: Node | None  # the task around the line; None if there is none, or if the plan handled the failure of a task
    #: The answers on which the line may depend: the last queries and waits of its task. If the last motion of the task
    #: before these changes failed, the end of that motion comes first. For a ``whenever``, the last change of the
    #: fluents that it follows.
    answers: tuple[Query | Task | Fluent, ...] = ()

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Raised]:
        """Yield the plan's line that raised the failure, or raised another exception because of it."""
        yield from _raised_while_handling(case)
        error = next(reversed(case.traced), None)
        asked = case.source.call_stack(case.motion.started) if case.motion is not None else ()
        lines = error.lines or asked if error is not None else ()
        if error is None or not lines or case.failure.type in (*_INTERRUPTS, "PropertyViolated"):
            return
        in_motion = case.motion is not None
        refused = case.failure.type in USAGE_ERRORS or (is_mistake(case.failure.type) and not in_motion)
        if (in_motion and not error.own and not refused) or not (error.own or refused or case.task is None):
            return
        line = lines[-1] if error.own else case.line(lines) or lines[-1]
        own = error.own and _is_raise(line)
        judged: list[Query | Task | Fluent] = [*_failed_before(case), *answers(case)] if own else []
        if own and case.task is not None and case.task.kind == "whenever":  # the last change of a followed fluent
            searched = islice(case.log.backwards(case.step, Fluent), _SEARCHED)
            judged += islice((each for each in searched if each.name in case.task.name), 1)
        steps = case.steps(*(each.seq for each in (*judged, *_refusals(case))))
        yield Raised(steps, case.failure.type, line, own, case.task, tuple(judged))

    def is_explained(self, found: Sequence[Cause]) -> bool:
        """Return whether the change of the checked value, or the obstacle of the failed call, is known."""
        deeper = "written" if self.own and not self.answers else "in-the-way" if self.type == "NoPlace" else ""
        return any(each.kind == deeper for each in found)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials with other answers, longer waits, or another arm, or without a refused call."""
        if not self.own:
            yield from (each for refusal in _refusals(case) for each in trials.skipped(refusal))
            return
        for each in reversed(self.answers):
            if isinstance(each, Query):
                yield from trials.other_answer(each)
            elif isinstance(each, Task) and each.kind == "wait":
                earlier = (record for record in case.log.backwards(each.seq - 1, Task) if record.task == each.task)
                started = next(record for record in earlier if record.phase == Task.STARTED)
                given = argument_values(started.parameters)
                yield from trials.fulfilled(started, given)
                yield from trials.longer(started, given.get("timeout"))
            elif isinstance(each, Task):
                failed = next((motion for motion in case.failed.motions if motion.id == each.task), None)
                if failed is not None:
                    yield from trials.seen(case, failed)
                    yield from trials.other_arm(case, failed)

    def _words(self) -> Iterator[str]:
        if self.own:
            what = "the plan raised the failure"
        else:
            what = f"a mistake in the plan: {self.type}" if is_mistake(self.type) else f"{self.type} came from a call"
        inside = f", in {phrases.node(self.task)}" if self.task is not None else ""
        yield f"{what} at {phrases.place(self.line)}{inside}: {phrases.short(self.line.text)}"
        for answer in self.answers:
            yield f"before, at step {answer.seq}: {_answer(answer)}"


def _answer(record: Query | Task | Fluent) -> str:
    if isinstance(record, Query):
        reasons = phrases.reasons(record) if record.candidates else ""
        return f"{phrases.question(record)}: {phrases.answer(record)}" + (f"; {reasons}" if reasons else "")
    if isinstance(record, Fluent):
        at = phrases.at(Line(record.source_file, record.source_line)) if record.source_line else ""
        return f"{record.name} became {phrases.value(from_json(record.after_json))}{at}"
    if record.kind != "wait":
        return f"{record.name} failed: {phrases.short(phrases.one_line(record.failure.message))}"
    done = "it became true" if from_json(record.result_json) is True else "it didn't become true in time"
    return f"waited for {record.name}: {done}"


def _is_raise(line: Line) -> bool:
    return _RAISES.search(line.text) is not None


def _raised_while_handling(case: FailureCase) -> Iterator[Raised]:
    """Yield the line that raised another error while the plan handled the task's failure."""
    last = next(reversed(case.exceptions), None)
    end = case.task.motion.finished if case.task is not None else None
    failure = (case.failure.type, case.failure.message)
    waited = last is not None and last.type == "DeadlockedBranches"  # for the failed branch
    if last is None or end is None or not last.lines or waited or (last.type, last.message) == failure:
        return
    if last.own if _is_raise(last.lines[-1]) else is_mistake(last.type):
        line = last.lines[-1] if last.own else case.line(last.lines) or last.lines[-1]
        yield Raised((end.seq,), last.type, line, last.own and _is_raise(line), None, (end,))


def is_mistake(failure: str) -> bool:
    """Return whether a type of failure means that Python or PyCRAM rejects the code in every state of the world."""
    return failure in USAGE_ERRORS or hasattr(builtins, failure)


def _refusals(case: FailureCase) -> Iterator[Refusal]:
    """Yield the last refusal if it is the failure."""
    for refusal in case.log.backwards(case.step, Refusal) if case.log.counts().get("refusal") else ():
        if (refusal.failure.type, refusal.failure.message) == (case.failure.type, case.failure.message):
            yield refusal
        return


def _failed_before(case: FailureCase) -> Iterator[Task]:
    """Yield the end of the last motion in the same task if the motion failed."""
    scope = None if case.task is None else case.task.id
    ended = [each for each in case.failed.motions if each.last_step < case.step]
    ended = [each for each in ended if scope is None or scope in [node.id for node in each.around()]]
    last = max(ended, key=lambda motion: motion.last_step, default=None)
    if last is not None and last.failed and last.finished is not None and case.is_here(last.started):
        yield last.finished


def answers(case: FailureCase) -> Iterator[Query | Task]:
    """Yield the last queries and waits of the same task before the failure, in order."""
    inside = {0} if case.task is None else {case.task.id}
    last = max((motion.last_step for motion in case.failed.motions), default=0)
    start = last if case.task is None else case.task.started.seq
    found: list[Query | Task] = []
    for record in case.log.backwards(case.step, (Query, Task)):
        if record.seq < start or len(found) == _MAX_ANSWERS:
            break
        if isinstance(record, Query) and record.task in inside and not is_choice(record):
            found.append(record)
        elif isinstance(record, Task) and record.phase == Task.FINISHED and record.parent in inside:
            if record.kind != "wait":
                break
            found.append(record)
    yield from reversed(found)


_AXES: Final = ("x", "y", "z")
_ORDERS: Final = {ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge}
_SUMS: Final = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul}
#: Parts of the results of calls that read a body. The parts of a joint's call are in its argument or its subscript.
_READS: Final = {"get_position": _AXES, "get_pose": _AXES, "get_orientation": ("turn",) * 4} | dict.fromkeys(
    ("get_position_and_orientation", "get_AABB", "get_joint_position", "get_joint_positions"), ()
)
_WROTE: Final = 0.05  # a simulation that changes a compared value by less (m, rad) didn't write it
_IN_SPACE: Final = ("", "turn", *_AXES)  # the parts that aren't joints
_TURNS: Final = (math.pi / 2, -math.pi / 2, math.pi)  # angles by which trials turn a body, rad
_BEYOND: Final = 0.1  # distance in m behind a compared bound at which trials place a body
_NO_LINE: Final = Line("", 0)
_FAR: Final = 1.0  # distance in m by which trials move a body if its check has no bounds
_DEPTH: Final = 3  # definitions of names that are followed
_MUTATIONS: Final = 200  # maximum number of changes in which moves of other objects are searched
#: An expression of a check, the wanted part of its value, the number of definitions to follow, and the assignments.
_Checked: TypeAlias = "tuple[ast.AST, str | None, int, Sequence[ast.Assign | ast.For]]"
_OBJECT: Final = re.compile(r"<Object ([^<>]+)>")


@dataclass(frozen=True, slots=True)
class Written(Cause):
    """A change wrote the value that a property or the plan compares."""

    kind = "written"
    untestable = "no value is known that the plan would accept"
    body: str
    part: str  # "x", "y", "z", "turn" or the name of a joint; "" for the whole pose
    value: float | None  # compared value in m or rad; None for "turn" and ""
    change: CausingChange
    others: tuple[CausingChange, ...]  # if the change is the object's loading: later changes of other objects

    @classmethod
    def find(cls, case: FailureCase) -> Iterator[Written]:
        """Yield the last change of each compared value, latest change first."""
        found: list[Written] = []
        for name, part in dict.fromkeys(compared(case)) if case.world is not None else ():
            last = _writer(case, name, part)
            if last is None or last.how in ("before", "removed") or not isinstance(last.record, Mutation):
                continue
            if last.how == "physics" and not last.record.simulate.driven:  # no motion carried the body
                continue
            change = case.blamed(last)
            if change.task is None or change.task.kind not in ("motion", HANDLER):
                change = replace(change, line=case.line_of(last.record))
            is_joint = part not in _IN_SPACE
            others = tuple(_others(case, change.step)) if last.how == "load" and not is_joint else ()
            now = case.world.bodies.get(name) if case.world is not None and last.how == "load" else None
            pose = last.after if now is None else now.joints.get(part) if is_joint else now.pose  # it has settled since
            value = pose if isinstance(pose, float) else pose[0][_AXES.index(part)] if pose and part in _AXES else None
            steps = case.steps(change, *others)
            if (name, change.step) not in [(each.body, each.change.step) for each in found]:
                found.append(Written(steps, name, part, value, change, others))
        yield from sorted(found, key=lambda each: -each.change.step)

    def trials(self, case: FailureCase) -> Iterator[Trial]:
        """Yield the trials without the change, with the body where the plan wants it, and with other values."""
        if self.change.how == "command" and self.change.task is None and not self.change.joint:
            skip = f"set_position(object={written(self.body)})=skip"
            yield Trial(self.change.step - 1, f"{self.body} isn't moved", answers=(skip,), compares=True)
        if case.world is not None and self.body in case.world.bodies and case.data.get("step") != self.change.step:
            yield from (replace(each, compares=True) for each in self._moved(case, case.world))

    def _moved(self, case: FailureCase, world: World) -> Iterator[Trial]:
        body, reads = world.bodies[self.body], [*_compared(case)]
        alike = (names for names, part in reads if part == self.part and self.body in names)
        read = next(alike, [])  # perhaps several bodies, which fail together
        together = dict.fromkeys([self.body, *(each for each in read if each in case.mentioned)])
        if self.part in ("", *_AXES):
            places = {each: trials.wanted(case, each) for each in together}
            for number in range(len(places[self.body])):
                yield trials.arranged(case, {each: at[number] for each, at in places.items() if number < len(at)})
        carried = self.change.task is not None and self.change.task.kind == "motion" and self.part in _IN_SPACE
        yield from trials.put_back(case, self.change) if self.change.how != "load" and not carried else ()
        names = {name for every, _ in reads for name in every}
        is_given = self.change.how == "load" and len(names) > 1  # the plan moved the others
        if self.part in _AXES and not is_given:
            axis = _AXES.index(self.part)
            for goal in _goals(case, body.position[axis], axis):
                poses = {each: [*world.bodies[each].position] for each in together}
                for at in poses.values():
                    at[axis] = goal
                yield trials.arranged(case, {each: (at, "") for each, at in poses.items()})
        for angle in _TURNS if self.part in ("", "turn") else ():
            turning = (0.0, 0.0, 0.0), geometry.from_rpy(0.0, 0.0, angle)
            pose = (*body.position, *geometry.multiply(turning, body.pose)[1])
            yield trials.arranged(case, {self.body: (pose, f"turned by {math.degrees(angle):.0f} degrees")})
        for end in trials.ends(case, self.body, self.part) if self.part not in _IN_SPACE else ():
            yield from trials.joint_at(case, self.body, self.part, end)

    def _words(self) -> Iterator[str]:
        if self.value is not None:
            what = f"{self.body}.{self.part} is {phrases.number(self.value)} since"
        else:
            what = f"{self.body}'s {'orientation' if self.part else 'pose'} is from"
        yield f"{what} step {self.change.step}: {self.change}"
        for each in self.others:
            yield f"{each.row}; {self.body} was not"


def _goals(case: FailureCase, now: float, axis: int) -> Iterator[float]:
    """Yield values of a coordinate that may pass the failed check, such as compared values, or beyond bounds."""
    values, line = _variables(case), next((each for error in case.traced[-1:] for each in error.lines[-1:]), _NO_LINE)
    points = [each for name in values if isinstance(each := _value(ast.Name(name), values), list | tuple)]
    goals, bounds = [each[axis] for each in points if len(each) == len(_AXES)], list[float]()
    for node in syntax_nodes(case.source.text(line.file)):
        if isinstance(node, ast.BinOp | ast.Compare) and node.lineno <= line.number <= (node.end_lineno or 0):
            right = node.comparators if isinstance(node, ast.Compare) else [node.right]
            known = [each for one in (node.left, *right) if isinstance(each := _value(one, values), float)]
            goals += known if isinstance(node, ast.BinOp) else ()
            bounds += [each + math.copysign(_BEYOND, each - now) for each in known if isinstance(node, ast.Compare)]
    for goal in (*goals, *(sorted(bounds, key=lambda each: abs(each - now)) or (now - _FAR, now + _FAR))):
        if isinstance(goal, float) and abs(goal - now) > _WROTE:
            yield goal


def _writer(case: FailureCase, name: str, part: str) -> Blame | None:
    """Return the last change of a part of a pose that is more than settling; None for an unknown body."""
    step = case.data.get("step")
    target = name if part in _IN_SPACE else f"{name}.{part}"
    last = case.blame(target)
    if isinstance(step, int) and 0 <= step < case.step and last is not None:
        last = blame(case.log, target, step, last.world)
    while last is not None and last.how == "physics" and last.earlier is not None and not _wrote(last, part):
        last = blame(case.log, target, last.record.seq - 1, last.world)
    return last


def _wrote(change: Blame, part: str) -> bool:
    before, after = change.before, change.after
    if not isinstance(before, tuple) or not isinstance(after, tuple):
        return True
    turned = geometry.angle(before[1], after[1]) if part in ("turn", "") else 0.0
    moved = [abs(a - b) for axis, a, b in zip(_AXES, before[0], after[0], strict=True) if part in (axis, "")]
    return max([turned, *moved]) >= _WROTE


def _others(case: FailureCase, since: int) -> Iterator[CausingChange]:
    """Yield for each line the first change since a step by which it moved, or put down, another object."""
    moved: dict[tuple[str, int], list[tuple[Mutation, str]]] = {}
    for number, record in enumerate(case.log.backwards(case.step, Mutation)):
        if record.seq <= since or number >= _MUTATIONS:
            break
        name = record.detach_body.body or (commanded(record) if record.HasField("move_body") else "")
        if case.free_body(name) is not None and case.is_here(record):
            moved.setdefault((record.source_file, record.source_line), []).append((record, name))
    for found in moved.values():
        record, name = found[-1]
        yield case.change(record, name, "detached" if record.HasField("detach_body") else "command")


# --- what is compared ------------------------------------------------------------------------------------------------


def compared(case: FailureCase) -> Iterator[tuple[str, str]]:
    """Yield the bodies and parts of poses that a property or a check of the plan compares."""
    return ((name, part) for names, part in _compared(case) for name in names)


def _compared(case: FailureCase) -> Iterator[tuple[list[str], str]]:
    """Yield the bodies that each expression of a property or check reads, and the part of their poses."""
    bodies = case.world.bodies if case.world is not None else {}
    if case.failure.type == "PropertyViolated":
        for name in bodies:
            for each in re.finditer(rf"(?<![\w.]){re.escape(name)}(?:\.(\w+))?(?!\w)", str(case.data.get("property"))):
                part = each[1] if each[1] in (*_AXES, *bodies[name].joints) else ""
                if part or case.free_body(name) is not None:
                    yield [name], part
        return
    error = next(reversed(case.traced), None)
    if error is None or not error.own or not error.lines or case.motion is not None:
        return
    line, values = error.lines[-1], _variables(case)
    robot = case.world.robot if case.world is not None else ""
    nodes = syntax_nodes(case.source.text(line.file))
    for owner, part in _reads(nodes, line, values):
        named = [robot] if isinstance(owner, ast.Attribute) and owner.attr == "robot" else _objects(owner, values)
        if len(named) != 1:
            named = [name for name in case.mentioned if name in named] or list(case.mentioned)
        if not named:
            used = (each for each in nodes if isinstance(each, ast.Name | ast.Constant) and each.lineno == line.number)
            words = {str(_value(each, values)) for each in used}
            said = [name for name, body in bodies.items() if {name, body.type} & words]
            named = [name for name in said if trials.wanted(case, name, before=False)] or said  # first, those astray
        joints = [name for name in named if name in bodies and part in bodies[name].joints]
        named = joints or [name for name in named if name == robot or case.free_body(name) is not None]
        if part or len(named) == 1:
            yield named, part


def _variables(case: FailureCase) -> dict[str, str]:
    """Return the recorded variables of the innermost line of the failure."""
    error = next(reversed(case.traced), None)
    line = error.lines[-1] if error is not None and error.lines else None
    frames = {(each.file, each.line): each.variables for each in case.failure.frames}
    return {each.name: each.value for each in frames.get((line.file, line.number), ())} if line is not None else {}


def _reads(nodes: Sequence[ast.AST], line: Line, values: Mapping[str, str]) -> Iterator[tuple[ast.expr, str]]:
    """Yield the owner and the coordinate of each pose that a check of the plan reads, without conditions that hold."""
    statements = [each for each in nodes if isinstance(each, ast.stmt)]
    around = [each for each in statements if each.lineno <= line.number <= (each.end_lineno or 0)]
    outer = [at for at, each in enumerate(around) if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)]
    around = around[outer[-1] :] if outer else around
    if not around or not isinstance(around[-1], ast.Assert | ast.Raise):
        return
    functions = [each for each in statements if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)]
    others = {id(each) for function in functions if function not in around for each in ast.walk(function)}
    scope = [each for each in (ast.walk(around[0]) if outer else nodes) if isinstance(each, ast.Assign | ast.For)]
    scope = [each for each in scope if each.lineno < line.number and (outer or id(each) not in others)]
    tests = [each.test for each in around if isinstance(each, ast.Assert | ast.If)][-1:]
    if isinstance(around[-1], ast.Assert):
        parts = [part for test in tests for part in (test.values if isinstance(test, ast.BoolOp) else [test])]
        tests = [part for part in parts if not _holds(part, values)] or tests
    waiting: list[_Checked] = [(test, None, _DEPTH, sorted(scope, key=lambda each: each.lineno)) for test in tests]
    seen: set[tuple[str, str | None]] = set()
    for node, wanted, depth, made in waiting:  # the list grows
        for each in ast.walk(node):
            if isinstance(each, ast.Call) and isinstance(each.func, ast.Attribute) and each.func.attr in _READS:
                yield from ((each.func.value, part) for part in _parts(node, each, wanted, values))
            elif isinstance(each, ast.Call):
                called = [*_results(functions, each)] if depth else []
                waiting += ((end, wanted or _item(node, each), depth - 1, inner) for end, inner in called)
                yield from ((given, "") for given in each.args if not called and _objects(given, values))
            elif isinstance(each, ast.Name) and (each.id, _item(node, each)) not in seen and depth:
                seen.add((each.id, _item(node, each)))
                for given, part in [*filter(None, (_given(other, each.id) for other in made))][-1:]:
                    waiting.append((given, part or wanted or _item(node, each), depth - 1, made))


def _parts(node: ast.AST, call: ast.Call, wanted: str | None, values: Mapping[str, str]) -> list[str]:
    """Return the part of a pose, or the names of the joints, that an expression takes from a call."""
    name = called_name(call)
    if "joint" in name:
        given = [_value(each, values) for each in (*call.args, *(each.value for each in call.keywords))]
        keys = (_value(each.slice, values) for each in ast.walk(node) if isinstance(each, ast.Subscript))
        return [each for each in given or [wanted, *keys] if isinstance(each, str)]
    found = wanted if wanted in _IN_SPACE else _item(node, call, _READS[name])
    return [found if found is not None else "turn" if name == "get_orientation" else ""]


def _results(functions: Sequence[ast.AST], call: ast.Call) -> Iterator[tuple[ast.expr, list[ast.Assign | ast.For]]]:
    """Yield the results of a called function with its assignments, both with arguments in place of parameters."""
    for function in (each for each in functions if getattr(each, "name", "") == called_name(call)):
        nodes = [*ast.walk(copy.deepcopy(function))]
        names = [each.arg for each in nodes if isinstance(each, ast.arg)][isinstance(call.func, ast.Attribute) :]
        given = dict(zip(names, call.args, strict=False)) | {each.arg: each.value for each in call.keywords}
        own = {*names, *(each.id for each in nodes if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store))}
        for each in nodes:
            if isinstance(each, ast.Name):  # the caller's variables may have the names of the function's variables
                each.id = getattr(given.get(each.id), "id", f".{each.id}" * (each.id in own) or each.id)
        made = [each for each in nodes if isinstance(each, ast.Assign | ast.For)]
        yield from ((each.value, made) for each in nodes if isinstance(each, ast.Return) and each.value is not None)


def _holds(test: ast.expr, values: Mapping[str, str]) -> bool:
    """Return whether a comparison of recorded numbers is true; False if a value is unknown."""
    match test:
        case ast.Compare(left=left, ops=[order], comparators=[right]) if type(order) in _ORDERS:
            one, other = _value(left, values), _value(right, values)
            return isinstance(one, float) and isinstance(other, float) and _ORDERS[type(order)](one, other)
    return False


def _value(node: ast.expr, values: Mapping[str, str]) -> object:
    """Return the value of an expression at the failure: a number, or a container of numbers; None if unknown."""
    match node:
        case ast.Constant(value=int() | float() | str()) | ast.UnaryOp(op=ast.USub(), operand=ast.Constant()):
            given = ast.literal_eval(node)
            return given if isinstance(given, str) else float(given)
        case ast.Name(id=name) if name in values:
            with suppress(ValueError, SyntaxError):
                value = ast.literal_eval(values[name])
                return float(value) if isinstance(value, int) else value
        case ast.Subscript(value=owner, slice=given):
            items, index = _value(owner, values), _value(given, values)
            with suppress(LookupError, TypeError):
                found = items[int(index) if isinstance(index, float) else index]  # type: ignore[index]
                return float(found) if isinstance(found, int) else found
        case ast.BinOp(left=left, op=sum_, right=right) if type(sum_) in _SUMS:
            one, other = _value(left, values), _value(right, values)
            if isinstance(one, float) and isinstance(other, float):
                return _SUMS[type(sum_)](one, other)
        case ast.Call(func=ast.Name(id="abs"), args=[given]) if isinstance(one := _value(given, values), float):
            return abs(one)
    return None


def _given(statement: ast.Assign | ast.For, name: str) -> tuple[ast.expr, str] | None:
    """Return the expression that a statement gives a name, and the part if it unpacks a position; otherwise None."""
    looped = isinstance(statement, ast.For)
    target = statement.target if isinstance(statement, ast.For) else statement.targets[0]
    value = statement.iter if isinstance(statement, ast.For) else statement.value
    tuples = [[getattr(each, "id", "") for each in one.elts] for one in ast.walk(target) if isinstance(one, ast.Tuple)]
    names = next((each for each in tuples if name in each), [])
    if names and isinstance(value, ast.Tuple) and len(value.elts) == len(names) and not looped:
        return value.elts[names.index(name)], ""
    parts = _READS.get(called_name(value), _AXES if looped and len(names) == len(_AXES) else ()) if names else ()
    found = name in {getattr(each, "id", "") for each in ast.walk(target)}
    return (value, "".join(parts[names.index(name) :][:1]) if parts else "") if found else None


def _item(node: ast.AST, inner: ast.expr, parts: Sequence[str] = _AXES) -> str | None:
    for each in ast.walk(node):
        if isinstance(each, ast.Subscript) and each.value is inner and isinstance(each.slice, ast.Constant):
            at = each.slice.value
            within = isinstance(at, int) and -len(parts) <= at < len(parts)
            return at if isinstance(at, str) else parts[at] if within else None  # type: ignore[index]
    return None


def _objects(owner: ast.expr, values: Mapping[str, str]) -> list[str]:
    """Return the names of the objects in the recorded variables that an expression reads."""
    if isinstance(owner, ast.Subscript) and isinstance(owner.value, ast.Name):
        key = values.get(ast.unparse(owner.slice), ast.unparse(owner.slice))
        return re.findall(rf"{re.escape(key)}: <Object ([^<>]+)>", values.get(owner.value.id, ""))
    names = [each.id for each in ast.walk(owner) if isinstance(each, ast.Name)]
    return [found for name in names for found in _OBJECT.findall(values.get(name, ""))]
