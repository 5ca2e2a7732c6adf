"""Ask reasoning queries at a past step, with objects moved if necessary.

The world of the step is rebuilt without recording, objects are moved, and the query runs. Plans call the same code, so
repeating a plan's query gives the same answer.
"""

from __future__ import annotations

import inspect
import json
import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram import bullet_world_reasoning as btr
from pycram.foundation.failures import PycramError
from pycram.reasoning.queries.query import RECORDED_AS, Found, Verdict
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import html, properties
from recorder.geometry import Quaternion, Vector
from recorder.records import Plain, Query, format_error, to_json
from replay.errors import NoSuchName, ReplayError
from replay.report.question import BadQuestion, Name, QueryCall, parse, question_of
from replay.restore.world import temporary_world
from replay.state.fold import state_at
from replay.state.state import State

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader

BELIEVED: Final = "believed"
"""The query for a robot's recorded belief. ``away`` is the distance of the object from the believed position in m."""
_BELIEVED_TAKES: Final = ("what", "robot")
QUERIES: Final = tuple(name for name in btr.__all__ if inspect.isfunction(getattr(btr, name)))  # names of the queries
#: Names of the parameters that are objects. A pose may be an object or a position.
_OBJECTS: Final = ("object", "object1", "object2", "robot", "pose", "ignoring")
_PARAMETERS: Final = {recorded: parameter for parameter, recorded in RECORDED_AS.items()}


@dataclass(frozen=True, slots=True)
class Move:
    """An object, and the pose to which it is moved before the query."""

    body: str
    position: Vector  # xyz, m
    orientation: Quaternion | None = None  # xyzw; None if it doesn't change


@dataclass(frozen=True, slots=True, repr=False)
class QueryAnswer:
    """The answer to a query."""

    step: int  # the query was asked after this step
    world: str
    question: QueryCall
    answer: bool | list[str | bool]  # the answer: true or false, names of objects, or an answer for each target
    evidence: Mapping[str, Plain]
    moves: tuple[Move, ...] = ()

    def __repr__(self) -> str:
        return f"<QueryAnswer after step {self.step}: {next(self.lines())}>"

    def _repr_html_(self) -> str:
        headline, *more = self.lines()
        return html.page(headline, html.text(more))

    def lines(self) -> Iterator[str]:
        """Yield question, answer and evidence as text."""
        yield f"{self.question}: {_answer(self.answer)}"
        yield from _lines(self.evidence, "  ")


def ask(
    log: RecordReader,
    step: int,
    question: str | QueryCall | None = None,
    *,
    world: str | None = None,
    moves: Sequence[Move] = (),
    moment: float | None = None,
) -> QueryAnswer:
    """Ask a query at a past step, without recording it.

    The objects in ``moves``, and objects that they carry, are moved first. A question is a query of
    :mod:`pycram.bullet_world_reasoning`, such as ``visible(milk, wide_stereo_optical_frame)``, or ``believed(milk)``
    with an object or a type. By default, the question is the query that the step recorded. By default, the world is
    the last opened world. :func:`replay.restore.world.world_at` explains ``moment``.

    Raises:
        BadQuestion: The question is invalid, the world has no answer, or the record of the step isn't a query.
        NotRestored: No world is open at the step.
    """
    if question is None:
        question, world = _recorded(log, step, world)
    call = _query(question, str(log.path))
    if call.query == BELIEVED:
        return _believed(state_at(log, step), step, world, call, moves)
    state = state_at(log, step)
    with temporary_world(log, step, state.world(world).name if world is not None else None, moment) as restored:
        try:
            for move in moves:
                try:
                    _object(restored, move.body).set_position(move.position, move.orientation)
                except PycramError as error:
                    raise BadQuestion(f"moving {move.body}", str(error)) from error
            result = _call(restored, call)
        except NoSuchName as error:  # another world may have an object with this name
            raise state.no_body(error.name, [state.world(world)]) from None
        except PycramError as error:
            raise BadQuestion(str(call), str(error)) from error
        # queries may not check all arguments
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise BadQuestion(str(call), f"it can't be answered: {format_error(error)}") from error
        answer: bool | list[str | bool]
        if isinstance(result, list):
            answer = [bool(item) if isinstance(item, Verdict) else item.name for item in result]
        else:
            answer = bool(result)
        evidence: dict[str, Plain] = json.loads(to_json(result.evidence))
        title = restored.name.rpartition("@")[0]
    return QueryAnswer(step, title, call, answer, evidence, tuple(moves))


def _query(question: str | QueryCall, path: str) -> QueryCall:
    try:
        call = parse(question) if isinstance(question, str) else question
        if call.query not in (*QUERIES, BELIEVED):
            raise NoSuchName("query", call.query, (*QUERIES, BELIEVED))
    except ReplayError:
        if isinstance(question, str) and _is_property(question):
            command = f"pycram-replay check {shlex.quote(path)} {shlex.quote(question)}"
            raise BadQuestion(question, f"this is a property, not a query; check it: {command}") from None
        raise
    return call


def _is_property(text: str) -> bool:
    try:
        parsed = properties.parse(text)
    except properties.BadProperty:
        return False
    return bool(parsed.body.quantities)


def _recorded(log: RecordReader, step: int, world: str | None) -> tuple[QueryCall, str]:
    """Return the query that a step recorded, and its world; raise BadQuestion if it isn't a query of a plan there."""
    record = log[step]
    if not isinstance(record, Query):
        raise BadQuestion(f"step {step}", "its record isn't a query that can be asked again; give a question")
    if record.name not in QUERIES:
        cause = f"its record is a {record.name}, which isn't a plan's query about a world; give a question"
        raise BadQuestion(f"step {step}", cause)
    if world not in (None, record.world):
        raise BadQuestion(f"step {step}", f"the query was asked in {record.world}, not in {world}")
    return question_of(record), record.world


def _believed(state: State, step: int, world: str | None, question: QueryCall, moves: Sequence[Move]) -> QueryAnswer:
    """Return a robot's recorded belief after a step; raise BadQuestion for changes, which don't affect past beliefs."""
    if moves:
        raise BadQuestion(str(question), "moving objects can't change a robot's past belief")
    given = dict(zip(_BELIEVED_TAKES, question.arguments, strict=False))
    terms = {name: getattr(term, "text", term) for name, term in {**given, **question.keywords}.items()}
    count = len(question.arguments) + len(question.keywords)
    known = "what" in terms and len(terms) == count and set(terms) <= {*_BELIEVED_TAKES}
    if not known or not all(isinstance(term, str) for term in terms.values()):
        raise BadQuestion(str(question), "expected believed(what, robot), where what is an object or a type")
    what, robot = str(terms["what"]), None if "robot" not in terms else str(terms["robot"])
    there = state.world(world)
    names = [name for body in there.bodies.values() for name in (body.name, body.type)]
    if what not in names:
        raise NoSuchName("object", what, dict.fromkeys(names))
    belief = next(iter(there.believed(what, robot)), None)
    evidence: dict[str, Plain] = {}
    if belief is not None:
        evidence = {name: json.loads(json.dumps(getattr(belief, name))) for name in belief.__slots__}
        evidence["away"] = math.dist(belief.position, there.bodies[belief.object].position)
    return QueryAnswer(step, there.name, question, belief is not None, evidence)


def _call(world: BulletWorld, question: QueryCall) -> Verdict | Found[Object] | Found[Verdict]:
    query: Callable[..., Verdict | Found[Object] | Found[Verdict]] = getattr(btr, question.query)
    signature = inspect.signature(query)
    keywords = {_PARAMETERS.get(name, name): term for name, term in question.keywords.items()}
    try:
        bound = signature.bind(*question.arguments, **keywords)
    except TypeError as error:
        takes = ", ".join(str(parameter).partition(":")[0] for parameter in signature.parameters.values())
        raise BadQuestion(str(question), f"{error}; the query is {question.query}({takes})") from None
    return query(**{name: _value(world, name, term) for name, term in bound.arguments.items()})


def _value(world: BulletWorld, parameter: str, term: object) -> object:
    if parameter == "world":
        return world
    if parameter in _OBJECTS and isinstance(term, Name | str):
        return _object(world, term.text if isinstance(term, Name) else term)
    if isinstance(term, list):
        return [_value(world, parameter, item) for item in term]
    return term.text if isinstance(term, Name) else term


def _object(world: BulletWorld, name: str) -> Object:
    objects = world.get_objects_by_name(name)
    if objects:
        return objects[0]
    if name == "robot" and world.robot is not None:
        return world.robot
    raise NoSuchName("object", name, (body.name for body in world.objects))


def _answer(answer: bool | str | list[str | bool]) -> str:
    if isinstance(answer, list):
        return ", ".join(map(_answer, answer)) or "nothing"
    return answer if isinstance(answer, str) else "yes" if answer else "no"


def _lines(evidence: object, indent: str) -> Iterator[str]:
    if not isinstance(evidence, dict):
        return
    width = max((len(name) for name in evidence), default=0)
    for name, value in evidence.items():
        if isinstance(value, dict) and value:
            yield f"{indent}{name}"
            yield from _lines(value, indent + "  ")
        else:
            yield f"{indent}{name:{width}}  {_short(value)}"


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list):
        return ", ".join(map(_short, value)) or "none"
    if value == {}:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
