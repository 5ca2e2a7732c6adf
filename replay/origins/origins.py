"""Where the values in a failure come from: ``pycram-replay why --origins``.

The plan runs again, guided by its recording, while its values are noted (:mod:`.noting`). From the failed call, and
from calls that made its causes, each value is followed back to the lines that made it (:mod:`.chain`). Values are
compared with the world: objects that moved after they were read, and mistakes that fit a number.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from recorder import geometry
from recorder.records import Mutation, Plain
from replay.explain.causes import decides, lacks_step
from replay.explain.causes.case import Cause, hands, joints_of
from replay.explain.causes.out_of_reach import ObstructingBody
from replay.file.record_reader import RecordReader
from replay.history.blame import Blame, blame, commanded
from replay.history.oddities import is_strong, oddities
from replay.history.source import PlanSource
from replay.origins.origin import Origin, Origins, PossibleMistake
from replay.report import phrases
from replay.retrace.plan_process import CantRetrace, PlanProcess
from replay.state.fold import state_at
from replay.state.state import Body, World

if TYPE_CHECKING:
    from replay.explain.why import Why

_MAX_CAUSES: Final = 3  # maximum number of causes whose calls are explained
_SHOWN: Final = 2000
_MOVED: Final = 0.001  # position or distance in rad or m up to which a joint or body counts as unmoved


def origins(log: RecordReader, why: Why, *, recorded_source: bool = False) -> Origins:
    """Run the plan again, and follow the values in its failure back.

    Raises:
        CantRetrace: the plan can't be run again.
    """
    first = why.step if why.thread else len(log) - 1
    if why.task is not None:
        first = (why.task.motion.asked or why.task.motion.started).seq
    process = PlanProcess(log, recorded_source=recorded_source)
    steps = _steps(log, why)
    answer = _noted(process, [first, *steps])
    read = [*_writers(log, why, answer["facts"].get(str(first)))]
    if not {*read} <= {*steps}:  # a read shows which calls wrote the value that the plan checks
        answer = _noted(process, [first, *read, *steps])
    steps = dict.fromkeys(read, True) | {step: decided for step, decided in steps.items() if step not in read}
    moved = tuple(answer["folder"] or ("", ""))
    facts = {int(step): Origin.of(fact, moved) for step, fact in answer["facts"].items() if fact is not None}
    found = {step: with_moves(log, fact, why) for step, fact in facts.items()}
    failed = found.pop(first, None)
    earlier: dict[tuple[str, int], Origin] = {}
    decided = 0
    for step in steps:
        each = found.get(step)
        if each is not None and each.place not in earlier and (failed is None or each.place != failed.place):
            earlier[each.place] = each
            decided += steps[step]
    notes = list(process.notes()) if recorded_source else [each for each in process.notes() if "source" in each]
    if str(first) not in answer["facts"] and answer["difference"] is None:
        notes.append(f"the plan didn't reach step {first}, where the failed call began")
    if answer["difference"] is not None:
        notes.append("the plan differs from its recording at step {step}: {text}".format(**answer["difference"]))
    calls = tuple(earlier.values())
    mistakes = (*guesses(why, failed), *slips(PlanSource(log), (each for each in (failed, *calls) if each is not None)))
    lacks = why.case is not None and lacks_step(why.case, why.causes)
    return Origins(failed, calls, str(process.program), decided, mistakes, tuple(notes), lacks)


def _noted(process: PlanProcess, steps: list[int]) -> dict[str, Any]:
    """Run the plan again, and return the facts about the calls at some steps."""
    with tempfile.TemporaryDirectory(prefix="pycram-origins-") as folder, tempfile.TemporaryFile() as errors:
        result = Path(folder) / "origins.json"
        running = process.start(
            "replay.origins.tracing", process.guidance(), folder, errors, steps=steps, result=str(result)
        )
        try:
            running.wait()
        finally:
            running.kill()
            running.wait()
        if not result.exists():
            errors.seek(0)
            printed = errors.read().decode("utf-8", "replace").strip()[-_SHOWN:]
            raise CantRetrace(f"the plan's process ended without a result: {printed}")
        answer: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
    if "error" in answer:
        raise CantRetrace(answer["error"])
    return answer


def _writers(log: RecordReader, why: Why, failed: dict[str, Any] | None) -> Iterator[int]:
    """Yield the steps of the last changes of the objects whose states the plan's own check read, the latest first."""
    reads: dict[str, int] = {}
    waiting = [] if failed is None or why.task is not None or why.thread else [failed]
    for each in waiting:  # the list grows
        waiting += each["parts"] if each["kind"] != "before" else []
        if each["kind"] == "read":
            reads[each["body"]] = max(each["step"], reads.get(each["body"], 0))
    for body, step in sorted(reads.items(), key=lambda each: -each[1]):
        for record in log.backwards(step, Mutation, naming=body):
            changed = {commanded(record), *(each.body for each in record.effect.bodies)}
            if body in changed and not record.HasField("simulate"):
                yield from [] if record.HasField("load_body") else [record.seq]
                break


def _steps(log: RecordReader, why: Why) -> dict[int, bool]:
    """Return the steps that led to the failure, and whether they decided it; deciding steps come first."""
    causes = [(each, why.case is not None and decides(why.case, each)) for each in why.causes[:_MAX_CAUSES]]
    causes.sort(key=lambda each: not each[1])
    found = []
    for cause, decided in causes:
        made = (each.step for each in cause.causing_changes())
        found += [(step, decided) for step in (*made, *cause.steps, *_moved_joints(why, cause))]
    steps: dict[int, bool] = {}
    for step, decided in (*found, *((step, False) for step in _made_state(log, why))):
        if step < why.step:
            steps.setdefault(step, decided)
    return steps


def _moved_joints(why: Why, cause: Cause) -> Iterator[int]:
    """Yield the last step that moved a joint of the furniture that is in the way."""
    case = why.case
    if isinstance(cause, ObstructingBody) and cause.change is None and case is not None and case.world is not None:
        body = case.world.bodies[cause.body]
        changes = [case.changed(f"{body.name}.{joint}") for joint, value in body.joints.items() if abs(value) > _MOVED]
        yield from sorted(each.step for each in changes if each is not None)[-1:]


def _made_state(log: RecordReader, why: Why) -> Iterator[int]:
    """Yield the steps of the last changes of objects, robot and arms; and of gravity, if it isn't downwards."""
    world = why.world
    if world is None:
        return
    if world.gravity[2] >= 0:
        every = log.records(Mutation, 0, why.step)
        yield from [each.seq for each in every if each.world == world.name and each.HasField("set_gravity")][-1:]
    for involved in why.bodies:
        joints = [joints_of(involved.body, arm)[:1] for arm in hands(involved.body)] if involved.is_robot else []
        names = [involved.body.name, *(f"{involved.body.name}.{joint}" for found in joints for joint in found)]
        for name in names if involved.is_robot or not involved.body.fixed_base else ():
            last: Blame | None = blame(log, name, why.step, world.name)
            while last is not None and last.how == "physics":
                last = last.earlier
            if last is not None:
                yield last.record.seq


_CHANGES: Final = 20  # maximum number of last changes among which the largest is sought
_CLOSE: Final = 0.15  # distance in m at which a point is near an object
_FAR: Final = 0.5  # distance in m at which a point is away from all objects
_ROOM: Final = 3.0  # distance in m at which a point is outside of the scene
_TILTED: Final = 0.5  # cosine of a lean below which no object stands like that
_POSITION: Final = 3  # number of coordinates of a position
_UNITS: Final = ((100.0, "centimetres"), (1000.0, "millimetres"))
_DEGREES: Final = 5.0  # angle below which a number is rarely in degrees
_LEAST: Final = 50.0  # smallest share of 1 m that a number in a unit can be
_NUMBER: Final = re.compile(r"(?<![\w.])\d+(?:\.\d*)?(?![\w.])")


def with_moves(log: RecordReader, origin: Origin, why: Why) -> Origin:
    """Return a fact, with the motions of those objects that it or its parts read."""
    parts = tuple(with_moves(log, each, why) for each in origin.parts)
    return replace(origin, parts=parts, moved=_moved_since(log, origin, why) if origin.kind == "read" else "")


def _moved_since(log: RecordReader, origin: Origin, why: Why) -> str:
    world = why.world
    if world is None or origin.step < 0 or origin.body not in world.bodies:
        return ""
    then = state_at(log, origin.step).worlds.get(world.name)
    before = None if then is None or then.lifetime != world.lifetime else then.bodies.get(origin.body)
    distance = 0.0 if before is None else math.dist(before.position, world.bodies[origin.body].position)
    if distance < _MOVED:
        return ""
    changes = [blame(log, origin.body, why.step, world.name)]
    while len(changes) < _CHANGES and (step := changes[-1].record.seq - 1) > origin.step:
        changes.append(blame(log, origin.body, step, world.name))
    since = [each for each in changes if each.record.seq > origin.step]
    most = max(since, key=lambda each: each.distance, default=changes[0])
    stack = most.causes.call_stack
    motion = next((each.started for each in most.causes.tasks if each.started.kind == "motion"), None)
    by = f" by {motion.name}" if motion is not None else ""
    when = "last" if most is changes[0] else "farthest"
    return (
        f"{origin.body} has moved {phrases.length(distance)} since then, {when} at step {most.record.seq}{by}"
        + phrases.at(stack[-1] if stack else PlanSource(log).line("", 0))
    )


def guesses(why: Why, failed: Origin | None) -> Iterator[PossibleMistake]:
    """Yield mistakes that would explain a number of the failed call; each is supported by numbers of the scene."""
    if failed is None or why.world is None:
        return
    facts = [failed]
    for each in facts:  # the list grows
        facts += each.parts
    yield from _in_degrees({} if why.case is None else why.case.data, facts)
    if why.task is None:
        return
    for name, value in why.task.motion.parameters.items():
        numbers = _vector(value)
        bodies = [body for body in why.world.bodies.values() if not body.fixed_base and body.name != why.world.robot]
        found = ""
        if len(numbers) == _POSITION:
            found = _of_position(numbers, bodies, why.world)
            yield from _scaled(name, numbers, bodies, facts)
        elif len(numbers) == _POSITION + 1:
            found = _of_rotation(numbers)
        if found:
            made = [each for each in facts if isinstance(each.number, list) and _near(each.number, numbers)]
            deepest = made[-1] if made else failed
            yield PossibleMistake(f"{name} {phrases.vector(numbers)} {found}", *deepest.place)


def slips(source: PlanSource, calls: Iterable[Origin]) -> Iterator[PossibleMistake]:
    """Yield likely slips in the functions of the values' lines, from the source alone."""
    facts = [*calls]
    for each in facts:  # the list grows
        facts += each.parts
    for file in dict.fromkeys(each.file for each in facts):
        lines = (source.line(file, each.line) for each in facts if each.file == file)
        functions = {line.function for line in lines if line is not None}
        for number, words in oddities(source.text(file)).items():
            line = source.line(file, number)
            if line is not None and line.function in functions:
                yield PossibleMistake(words, file, number, line.text, is_strong(words))


def _in_degrees(data: Mapping[str, Plain], facts: Sequence[Origin]) -> Iterator[PossibleMistake]:
    """Yield the line of a joint's value, if the value would be within the limits as a number of degrees."""
    value, lower, upper = (data.get(key) for key in ("value", "lower", "upper"))
    if isinstance(value, int | float) and isinstance(lower, int | float) and isinstance(upper, int | float):
        angle = math.radians(value)
        if abs(value) >= _DEGREES and lower <= angle <= upper:
            for text, each in ((text, fact) for fact in facts for text in _NUMBER.findall(fact.text)):
                if math.isclose(float(text), abs(value)):
                    limits = f"{phrases.number(lower)} to {phrases.number(upper)}"
                    said = f"{text} is in degrees ({phrases.number(angle)} rad): {data.get('joint')} goes from {limits}"
                    yield PossibleMistake(said, *each.place)
                    return


def _vector(value: Plain) -> list[float]:
    """Return the numbers of a slot; the position of a pose."""
    if isinstance(value, dict):
        value = value.get("position")
    plain = isinstance(value, list) and all(isinstance(each, int | float) for each in value)
    return [float(each) for each in value] if plain else []  # type: ignore[union-attr, arg-type]


def _near(one: Sequence[Any], other: Sequence[float], within: float = _MOVED) -> bool:
    numbers = len(one) == len(other) and all(isinstance(each, int | float) for each in one)
    return numbers and math.dist(one, other) <= within


def _of_position(position: Sequence[float], bodies: Sequence[Body], world: World) -> str:
    """Return what a position may be instead of a position in the world; "" without evidence."""
    robot = world.bodies.get(world.robot)
    for body in bodies:
        relative = None if robot is None else geometry.transform(geometry.invert(robot.pose), body.position)
        if relative is not None and _near(relative, position) and not _near(body.position, position, _CLOSE):
            return f"is {body.name}'s position relative to {world.robot}, not in the world"
    if any(_near(body.position, position, _FAR) for body in bodies):
        return ""
    x, y, z = position
    for other, words in (([-x, y, z], "-x"), ([x, -y, z], "-y"), ([x, y, -z], "-z"), ([y, x, z], "x and y swapped")):
        near = next((body.name for body in bodies if _near(body.position, other, _CLOSE)), "")
        if near:
            return f"would be near {near} with {words}"
    return ""


def _of_rotation(rotation: Sequence[float]) -> str:
    x, y, z, w = rotation
    if abs(math.hypot(*rotation) - 1) > _CLOSE or 1 - 2 * (x * x + y * y) > _TILTED:
        return ""
    if 1 - 2 * (y * y + z * z) < 1 - _CLOSE:  # the lean of a rotation whose w is the first component
        return ""
    return f"has w first; in the order x, y, z, w it tilts by {phrases.degrees(2 * math.acos(min(1.0, abs(w))))}"


def _scaled(
    name: str, position: Sequence[float], bodies: Sequence[Body], facts: Sequence[Origin]
) -> Iterator[PossibleMistake]:
    """Yield the number of a line that would be a length like all others, if it were in another unit."""
    known = [part for body in bodies for part in body.position]
    limit = max(map(abs, known), default=0.0) + _ROOM
    for part in (part for part in position if abs(part) > limit):
        for each in facts:
            for text, (scale, unit) in product(_NUMBER.findall(each.text), _UNITS):
                number = float(text)
                if number >= scale / _LEAST and abs(part - number + number / scale) < limit:
                    size = phrases.length(number / scale)
                    yield PossibleMistake(
                        f"{text} is in {unit} ({size}): {name} has {phrases.number(part)} m", *each.place
                    )
                    return
