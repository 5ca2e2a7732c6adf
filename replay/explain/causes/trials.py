"""Changes of a fork that take causes away: a change of the world is undone, a decision forced, or a limit made longer.

Each kind of cause yields its trials (:meth:`replay.explain.causes.case.Cause.trials`); :mod:`replay.retrace.prove` runs
them.
"""

from __future__ import annotations

import ast
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder import geometry
from recorder.plan_lines import called_name, syntax_nodes
from recorder.records import Mutation, Query, Refusal, Task, argument_values
from recorder.tasks import Node
from replay.errors import NoSuchStep
from replay.explain.causes.case import objects_in
from replay.history.blame import commanded
from replay.history.source import Line
from replay.report import phrases
from replay.report.question import QueryCall, question_of, written
from replay.state.fold import last_open_step, state_at
from replay.state.state import Body, World

if TYPE_CHECKING:
    from replay.explain.causes.case import CausingChange, FailureCase

_MOVED: Final = 1e-6  # change in rad or m above which a joint has moved
_FAR: Final = 30.0  # distance in m to which an obstacle is moved away
_BEFORE: Final = 0.65  # distance in m between robot and target at which arms work well
_ROOM: Final = 0.1  # distance in m by which the robot moves nearer, plus the distance that the arm lacked
_NEAR: Final = 0.05  # nearer positions are the same, m
_SEARCHED: Final = 2_000  # number of tasks before the failure that are searched
_MOVES: Final = 20  # number of changes of a body that are searched
_MOVING: Final = ("attach_body", "move_body", "reset")
_LONGER: Final = 10.0  # factor for the limits of waits
OPEN: Final = 0.01  # doors and drawers with a larger joint position aren't closed, rad or m
NONE: Final = "none"
FLUENT: Final = "fluent:"
COMPARED: Final = re.compile(r"(.+) (==|>=?|<=?) (.+)")
JOINT: Final = re.compile(r"joint of (\S+) of (.+)")  # the name of a fluent that follows a joint
_BEYOND: Final = 0.01  # difference between the new number and the bound: this amount, or this share of the bound
_WITHOUT_RESULT: Final = ("attach", "detach", "detach_all", "remove")  # calls without a result, in addition to setters
Place: TypeAlias = "tuple[Sequence[float], str]"  # a position or pose, and its origin as text


@dataclass(frozen=True, slots=True)
class Trial:
    """A fork that takes a cause away."""

    step: int  # the last step before the fork's change
    words: str  # change in words
    settings: tuple[str, ...] = ()  # values of ``fork --set``
    answers: tuple[str, ...] = ()  # values of ``fork --answer``
    world: str = ""  # the world of the settings
    decisive: bool = True  # whether the same failure refutes the cause even in a single fork
    partial: bool = False  # whether the fork takes only a part of the cause away, so the same failure refutes nothing
    compares: bool = False  # whether the fork changes a value that a check compares
    succeeds: bool = False  # whether only a success of the failed motion confirms the cause
    needs: str = ""  # motion that must succeed because of the change; otherwise, the fork decides nothing


@dataclass(frozen=True, slots=True)
class TriedTrial:
    """A finished fork."""

    trial: Trial
    verdict: str  # verdict of this fork alone on the cause, as in :class:`Proof`
    text: str  # outcome in words
    file: str = ""  # recording of the fork; "" if it was deleted


@dataclass(frozen=True, slots=True)
class Proof:
    """The verdict on a cause."""

    #: "confirmed" (without the cause, there is no failure, or another one later), "refuted" (without the cause, the
    #: same failure occurs), "untested" (no fork decides), or "code" (forks change the world, and not the plan's code)
    verdict: str
    text: str  # text of the verdict
    forks: tuple[TriedTrial, ...] = ()


CONFIRMED, REFUTED, UNTESTED, IN_CODE = "confirmed", "refuted", "untested", "code"


def put_back(case: FailureCase, change: CausingChange) -> Iterator[Trial]:
    """Yield the trial that undoes a change immediately after it. Other changes may have the same effect."""
    yield from (replace(trial, decisive=False) for trial in _undone(case, change))


def _undone(case: FailureCase, change: CausingChange) -> Iterator[Trial]:
    step = change.step
    if change.task is not None and change.task.kind == "motion":  # a fork can't change the world within the motion
        later = (each for each in case.log.records(Task, step, case.began) if each.task == change.task.task)
        step = next((each.seq for each in later if each.phase == Task.FINISHED), step)
    start = (change.task.seq if change.task is not None else change.step) - 1
    before = _body(case, change.body, start)
    name = written(change.body)
    if change.how == "removed":
        yield Trial(change.step - 1, f"{change.body} isn't removed", answers=(f"remove(body={name})=skip",))
    elif change.how == "gravity":
        world = state_at(case.log, change.step - 1).worlds[case.log[change.step].world]
        yield _set(case, step, "gravity is as before", {"gravity": world.gravity})
    elif change.how in ("attached", "detached"):
        arm = case.holder(change.body, change.step - 1)
        held = f"the {arm} gripper still holds {change.body}" if arm else f"nothing holds {change.body}"
        if " " not in arm:
            yield _set(case, step, held, {f"{name}.hand": arm or NONE})
    elif change.how == "load" or before is None:
        yield from away(case, change.body, step)
    elif case.holder(change.body, start) == case.holder(change.body, step):  # else, a hand held it in the air before
        text = f"{change.joint} of {change.body}" if change.joint else change.mover or change.body
        record, names = case.log[change.step], [change.body]
        if isinstance(record, Mutation) and change.how not in ("reset", "restored"):  # a command carries others along
            names = [commanded(record), change.body, *(each.body for each in record.effect.bodies)]
        yield from restored(case, names, start, step, f"{text} is put back")


def restored(case: FailureCase, names: Sequence[str], then: int, step: int, words: str = "") -> Iterator[Trial]:
    """Yield the fork in which bodies and joints are set back to an earlier step."""
    poses: dict[str, object] = {}
    joints: dict[str, object] = {}
    for name in dict.fromkeys(names):
        body, now = _body(case, name, then), _body(case, name, step)
        if body is None or now is None:
            continue
        if (body.position, body.orientation) != (now.position, now.orientation) or not words:
            poses[f"{written(name)}.position"] = (*body.position, *body.orientation)
        changed = (joint for joint, value in body.joints.items() if abs(now.joints.get(joint, value) - value) > _MOVED)
        joints |= {f"{written(name)}.{joint}": body.joints[joint] for joint in changed}
    if poses or joints:
        where = f"{phrases.names(names)} {'is as it was' if len(names) == 1 else 'are as they were'} at step {then}"
        yield _set(case, step, words or where, joints | poses)  # joints come first, because they carry bodies along


def downwards(case: FailureCase, step: int) -> Iterator[Trial]:
    """Yield the trial in which the world has the earth's gravity from a step on."""
    yield _set(case, step, "gravity points down", {"gravity": (0.0, 0.0, -9.81)})


def arranged(case: FailureCase, places: Mapping[str, Place], step: int | None = None) -> Trial:
    """Return the trial with bodies at positions or poses; by default, they are moved there just before the failure."""
    words = (f"{each} is at {phrases.vector(at[:3])}{of and f' ({of})'}" for each, (at, of) in places.items())
    released: dict[str, object] = {f"{written(each)}.hand": NONE for each in places if case.holder(each)}
    moved = {f"{written(each)}.position": at for each, (at, _) in places.items()}
    return _set(case, step, " and ".join(words), released | moved)


def wanted(case: FailureCase, name: str, *, before: bool = True) -> list[Place]:
    """Return the positions that requests and tables of the plan name for a body, then its earlier positions."""
    found: list[Place] = []
    if case.world is not None:
        body, earlier = case.world.bodies[name], [*_earlier(case, name)]
        named = [*_requested(case, body), *_tabled(case, body)]
        named = [each for each in named if each[0][-1]]  # the floor is for robots
        for number, (at, origin) in enumerate(named + earlier * before):
            place = (*at, *body.position[len(at) :])  # perhaps without a height
            start = earlier[-1:] if number < len(named) else ()  # tables also name the place at the start
            known = (body.position, *(each for each, _ in (*found, *start)))
            if all(math.dist(place[:2], each[:2]) > _NEAR or abs(place[2] - each[2]) > 2 * _NEAR for each in known):
                found.append((place, origin))
    return found


def _requested(case: FailureCase, body: Body) -> Iterator[Place]:
    """Yield the targets of earlier motions and actions with a body, the latest first."""
    for task in islice(case.log.backwards(case.step, Task), _SEARCHED):
        if task.phase == Task.STARTED and task.kind in ("motion", "action"):
            given = argument_values(task.parameters)
            target, about = given.get("target"), (given.get("object"), *objects_in([given.get("object")]))
            if (body.name in about or body.type in about) and isinstance(target, list) and len(target) == 3:
                yield tuple(float(str(each)) for each in target), f"the target of {task.name} at step {task.seq}"


def _tabled(case: FailureCase, body: Body) -> list[Place]:
    """Return the points beside a body's name, or else its type, in dictionaries, rows and calls of the plan."""
    found, rows = list[Place](), list[tuple[str, Sequence[ast.expr | None]]]()
    for file in case.source.files:
        for node in syntax_nodes(case.source.text(file)):
            if isinstance(node, ast.Dict):
                rows += [(file, each) for each in (*zip(node.keys, node.values, strict=True), node.values)]
            elif isinstance(node, ast.Tuple | ast.List | ast.Call) and called_name(node) != "Object":
                rows.append((file, node.args if isinstance(node, ast.Call) else node.elts))
    for name in (body.name, body.type):
        beside = [each for each in rows if not found and name in [getattr(part, "value", 0) for part in each[1]]]
        parts = [(file, part) for file, row in beside for each in row[::-1] if each for part in ast.walk(each)]
        for file, part in parts:
            with suppress(ValueError, TypeError, SyntaxError):
                at = ast.literal_eval(part) if isinstance(part, ast.Tuple | ast.List) else ()
                if len(at) in (2, 3) and all(isinstance(each, int | float) for each in at):
                    found.append((at, f"its place at {phrases.place(Line(file, getattr(part, 'lineno', 0)))}"))
    return found


def _earlier(case: FailureCase, name: str) -> Iterator[Place]:
    """Yield the positions of a body before it was taken, moved or restored, the latest first."""
    for record in islice(case.log.backwards(case.step, Mutation, naming=name), _MOVES):
        body, step = _body(case, name, record.seq - 1), record.seq - 1
        if record.WhichOneof("command") in _MOVING and body is not None and not case.holder(name, step):
            yield body.position, f"its place at step {step}"


def away(case: FailureCase, body: str, step: int | None = None) -> Iterator[Trial]:
    """Yield the trial with an obstacle far away."""
    if case.free_body(body) is None or case.world is None:
        return
    yield _set(case, step, f"{body} is far away", _far_away(case.world, body))


def _far_away(world: World, body: str) -> dict[str, object]:
    x, y, z = world.bodies[body].position
    released = {f"{written(body)}.hand": NONE} if world.carrier(body) is not None else {}
    return {**released, f"{written(body)}.position": (x + _FAR, y + _FAR, z)}


def freed(case: FailureCase, body: str) -> Iterator[Trial]:
    """Yield the trial in which a body is released. A body that the motion doesn't need is moved far away."""
    if body in case.subjects:
        for place in islice(_earlier(case, body), 1):  # beside the hand, the body would hang in the air
            yield replace(arranged(case, {body: place}), succeeds=True)
        yield _set(case, None, f"nothing holds {body}", {f"{written(body)}.hand": NONE})
    else:
        yield from away(case, body)


def in_hand(case: FailureCase, body: str, arm: str) -> Iterator[Trial]:
    """Yield the trial with a body in a hand just before the failure."""
    if body and arm and case.world is not None:
        held = [each.body for each in case.world.attachments.values() if case.holder(each.body, _before(case)) == arm]
        emptied = {key: value for each in held for key, value in _far_away(case.world, each).items()}
        yield _set(case, None, f"the {arm} gripper holds {body}", emptied | {f"{written(body)}.hand": arm})


def joint_at(case: FailureCase, body: str, joint: str, value: float, step: int | None = None) -> Iterator[Trial]:
    """Yield the trial with a joint at a value; by default, it is set just before the failure."""
    text = f"{joint} of {body} is at {phrases.number(value)}"
    yield _set(case, step, text, {f"{written(body)}.{joint}": value})


def opened(case: FailureCase, body: str, joint: str, step: int | None = None) -> Iterator[Trial]:
    """Yield the trials with an open joint closed or wide open, or with a closed joint open and half-way open.

    These trials refute nothing, because the body may be in the way there, too.
    """
    is_open = case.world is not None and abs(case.world.bodies[body].joints[joint]) > OPEN
    wide = [end for end in ends(case, body, joint) if abs(end) > OPEN][:1]
    for value in (0.0, *wide) if is_open else (each for end in wide for each in (end, end / 2)):
        yield from (replace(each, partial=True) for each in joint_at(case, body, joint, value, step))


def ends(case: FailureCase, body: str, joint: str) -> list[float]:
    """Return the limits of a joint, the limit that is farther from the joint's position first."""
    at = case.world.bodies[body].joints[joint] if case.world is not None else 0.0
    return sorted(filter(math.isfinite, case.limits(body, joint) or ()), key=lambda end: -abs(end - at))


def nearer(case: FailureCase, target: Sequence[float], miss: float) -> Iterator[Trial]:
    """Yield the trials in which, just before the failure, the robot is nearer to a target, and before it."""
    robot = case.robot
    if robot is None:
        return
    (x, y, z), name = robot.position, robot.name
    distance, heading = math.dist((x, y), target[:2]), math.atan2(target[1] - y, target[0] - x)
    needed, facing = distance - miss - _ROOM, geometry.from_rpy(0.0, 0.0, heading)
    for left, turn, words in (
        (needed, robot.orientation, f"{name} is {phrases.length(miss + _ROOM)} nearer"),
        (_BEFORE, facing, f"{name} is {phrases.length(_BEFORE)} before the target, and faces it"),
    ):
        if left < _BEFORE:  # so near, the robot would stand in what it should reach
            continue
        ahead = distance - left
        pose = (x + ahead * math.cos(heading), y + ahead * math.sin(heading), z, *turn)
        trial = _set(case, None, words, {f"{written(name)}.position": pose})
        yield replace(trial, partial=True, succeeds=True)  # the target may also be too high, or too low


def other_answer(query: Query) -> Iterator[Trial]:
    """Yield the trial with the opposite answer of a query."""
    answer = json.loads(query.answer_json or "null")
    if isinstance(answer, bool) or (isinstance(answer, list) and answer):
        other = json.dumps(not answer) if isinstance(answer, bool) else "[]"
        question = QueryCall(query.name, (), question_of(query).keywords)
        said = "nothing" if other == "[]" else "yes" if other == "true" else "no"
        text = f"{phrases.question(query)} is answered {said}"
        yield Trial(query.seq - 1, text, answers=(f"{question}={other}",))


def seen(case: FailureCase, task: Node) -> Iterator[Trial]:
    """Yield the trial in which a failed perception sees an object of its type."""
    kind = task.motion.parameters.get("object-type")
    world = state_at(case.log, task.started.seq).worlds.get(task.started.world)
    bodies = [body.name for body in world.bodies.values() if body.type == kind] if world is not None else []
    for name in bodies[:1]:
        answer, step = f"visible({written(name)}, ...)=true", task.motion.started.seq - 1
        yield Trial(step, f"{name} is seen", answers=(answer,), needs=task.motion.name)


def replaced(case: FailureCase, slot: str, value: str) -> Iterator[Trial]:
    """Yield the trial in which a slot of the failed motion has another value."""
    if case.motion is not None:
        answer = f"{case.motion.name}.{slot}(...)={value if value.startswith('[') else written(value)}"
        yield Trial(_before(case), f"{case.motion.name} has the slot {slot}={value}", answers=(answer,))


def given_back(case: FailureCase) -> Iterator[Trial]:
    """Yield the trial in which the robot puts an object back from where it took it."""
    name, robot = next(iter(case.subjects), ""), case.robot.name if case.robot is not None else ""
    for taken in [each for each in case.motions("pick-up") if name in objects_in(each.parameters)][:1]:
        stood, lay = (_body(case, each, taken.started.seq) for each in (robot, name))
        at = phrases.vector(lay.position) if lay is not None else ""
        for trial in replaced(case, "target", at) if at else ():
            pose = {f"{written(robot)}.position": (*stood.position, *stood.orientation)} if stood is not None else {}
            words = f"place puts {name} to where it was taken, {at},"
            yield replace(_set(case, None, words, pose), answers=trial.answers, succeeds=True)


def longer(started: Task, seconds: object) -> Iterator[Trial]:
    """Yield the trial with a longer limit of a timeout or wait."""
    if isinstance(seconds, int | float) and seconds > 0:
        answer = f"timeout(seconds={seconds!r})={seconds * _LONGER!r}"
        yield Trial(started.seq - 1, decisive=False, words=f"the limit is {seconds * _LONGER:g} s", answers=(answer,))


def fulfilled(started: Task, values: Mapping[str, object]) -> Iterator[Trial]:
    """If the condition of a wait is a fluent, or compares a fluent with a number, yield the trial in which it holds."""
    compared = COMPARED.fullmatch(started.name)
    leaf = compared[1] if compared else started.name
    if leaf not in values:
        return
    try:
        wanted = ast.literal_eval(compared[3]) if compared else True
    except (ValueError, SyntaxError):
        return
    if compared and isinstance(wanted, int | float) and compared[2] != "==":
        wanted += (1 if compared[2].startswith(">") else -1) * max(_BEYOND, _BEYOND * abs(wanted))
    joint = JOINT.fullmatch(leaf)
    target = f"{written(joint[2])}.{joint[1]}" if joint else f"{FLUENT}{leaf}"
    setting = f"{target}={json.dumps(wanted)}"
    yield Trial(started.seq, f"{started.name} holds", (setting,), world=started.world if joint else "")


def skipped(refusal: Refusal) -> Iterator[Trial]:
    """Yield the trial in which a refused call isn't made, if calls of this kind have no result."""
    if refusal.name.startswith("set_") or refusal.name in _WITHOUT_RESULT:
        subject = argument_values(refusal.arguments).get("object")
        name = subject.get("object") if isinstance(subject, dict) else None
        answers = (f"{refusal.name}({'...' if name is None else f'object={written(str(name))}'})=skip",)
        yield Trial(refusal.seq - 1, f"{phrases.refused(refusal)} isn't called", answers=answers)


def other_arm(case: FailureCase, task: Node) -> Iterator[Trial]:
    """Yield the trial in which a failed motion uses another arm."""
    motion = task.motion
    others = [arm for arm in case.hands if arm != motion.parameters.get("arm")]
    for arm in others[:1] if motion.parameters.get("arm") else ():
        text = f"{phrases.node(motion)} uses the {arm} arm"
        yield Trial(motion.started.seq - 1, text, answers=(f"{motion.name}.arm(...)={arm}",), needs=motion.name)


def _set(case: FailureCase, step: int | None, words: str, values: Mapping[str, object]) -> Trial:
    """Return a trial with settings; by default, they are made just before the failure."""
    texts = (
        f"{key}={','.join(map(repr, value)) if isinstance(value, list | tuple) else value}"
        for key, value in values.items()
    )
    world = case.world.name if case.world is not None else ""
    return Trial(_before(case) if step is None else step, words, tuple(texts), world=world)


def _before(case: FailureCase) -> int:
    """Return the step at which the failed motion began; otherwise the last change or task before the failure."""
    earlier = case.log.backwards(last_open_step(case.log, case.began - 1), (Mutation, Task))
    last = (each.seq for each in earlier if not isinstance(each, Task) or each.phase == Task.FINISHED)
    return case.began if case.motion is not None else next(last, 0)


def _body(case: FailureCase, name: str, step: int) -> Body | None:
    try:
        world = state_at(case.log, max(step, 0)).worlds.get(case.world.name if case.world is not None else "")
    except NoSuchStep:
        return None
    return world.bodies.get(name) if world is not None else None
