"""Relates a plan's values to the world: objects that moved after they were read, and mistakes that fit a number."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any, Final

from recorder import geometry
from recorder.records import Plain
from replay.file.record_reader import RecordReader
from replay.history.blame import blame
from replay.history.flow import is_strong, oddities
from replay.history.source import PlanSource
from replay.origins.origin import Origin, PossibleMistake
from replay.report import phrases
from replay.state.fold import state_at
from replay.state.state import Body, World

if TYPE_CHECKING:
    from replay.explain.why import Why

_MOVED: Final = 0.001  # distance in m below which a motion is ignored
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
    last = blame(log, origin.body, why.step, world.name)
    stack = last.causes.call_stack
    motion = next((each.started for each in last.causes.tasks if each.started.kind == "motion"), None)
    by = f" by {motion.name}" if motion is not None else ""
    return (
        f"{origin.body} has moved {phrases.length(distance)} since then, last at step {last.record.seq}{by}"
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
