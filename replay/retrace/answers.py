"""Answers of queries in a run that a recording guides: taken from the recording, or given by whoever forks the run.

The reasoning queries leave no trace: they draw no random numbers, change nothing in a world, and what they cache of it
is what they would find again. So a run whose answers are taken goes on as one that asks. An answer is taken only for
the query that the recording has next: so the plan asks the same, with the same arguments, at the same moment, and the
query recorded nothing else on its way. All others are asked, as are those that failed, and those about many targets,
whose answers have evidence of their own that isn't on record. Queries of the plan's own may do anything, and are asked.

An answer that is given has the evidence of the query's own: it is asked first.
"""

from __future__ import annotations

import inspect
import re
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NoReturn

from pycram import bullet_world_reasoning as btr
from pycram.foundation.failures import PycramError
from pycram.reasoning.queries.query import RECORDED_AS, Found, Verdict
from pycram.world.object import Object
from recorder import records
from recorder.records import Query, from_json
from recorder.tracing.process_identity import process
from replay.errors import NoSuchName
from replay.restore.question import BadQuestion, Name, Question, parse
from replay.retrace.changes import BadChange, object_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pycram.reasoning.choosing import Question as Asked
    from pycram.world.world import BulletWorld
    from recorder.records import Plain
    from replay.restore.question import Term
    from replay.retrace.guide import Guide

_ANY: Final = re.compile(r"([(,])\s*\.\.\.\s*\)$")  # the rest of a query's arguments
_OF_MANY: Final = "Found[Verdict]"
_OURS: Final = "pycram.reasoning.queries."

ANSWERABLE: Final = tuple(name for name in btr.__all__ if hasattr(getattr(btr, name), "__wrapped__"))
"""Names of the queries, as records have them."""

_ANSWERS: Final = {
    "Verdict": "true or false",
    "Found[Object]": "a list of objects, as [milk, bowl] or []",
    _OF_MANY: "a list of true and false, one for each target",
}


class Answers:
    """Answers queries in place of their own.

    Args:
        guide: what the recording has next.
        taken: whether answers are taken from the recording.
        refuse: called with what is wrong with a given answer, where only the query itself tells; it doesn't return.

    Attributes:
        taken: how many were.
        given: those that are to be given, in their order.
    """

    def __init__(self, guide: Guide, *, taken: bool, refuse: Callable[[Exception], NoReturn]) -> None:
        self._guide = guide
        self._takes = taken
        self._refuse = refuse
        self._process = process()
        self._beside: dict[int, Query] = {}  # by thread: what the record of its query has beside the answer
        self.taken = 0
        self.given: list[GivenAnswer] = []

    def __call__(
        self, question: Asked, world: BulletWorld, function: Callable[..., Any], ask: Callable[[], Any]
    ) -> Any:
        """Answer a query; see :class:`pycram.reasoning.queries.query.Oracle`."""
        if process() != self._process or not function.__module__.startswith(_OURS):
            return ask()
        recorded = self._guide.upcoming() if self._takes else None
        if isinstance(recorded, Query) and _is_whole(recorded) and _asks(recorded, question, world):
            self._beside[threading.get_ident()] = recorded
            self.taken += 1
            return _taken(recorded, world)
        own = ask()
        for given in self.given:
            if given.fits(question.name, question.arguments, world):
                self.given.remove(given)
                self._beside[threading.get_ident()] = Query(by_fork=True, own_answer_json=records.to_json(own))
                try:
                    return given.replace(own, world)
                except (BadChange, PycramError) as error:
                    self._refuse(error)
        return own

    def complete(self, record: Query) -> None:
        """Complete the record of a query that wasn't asked, or whose answer was given."""
        beside = self._beside.pop(threading.get_ident(), None)
        if beside is None:
            return
        if beside.by_fork:
            record.by_fork, record.own_answer_json = True, beside.own_answer_json
            return
        record.candidates.extend(beside.candidates)
        if beside.HasField("chosen"):
            record.chosen = beside.chosen


def _is_whole(recorded: Query) -> bool:
    """Return whether a record has all of a query's own answer."""
    known = recorded.name in ANSWERABLE and _kind(recorded.name) != _OF_MANY
    return known and not recorded.HasField("failure") and not recorded.by_fork


def _asks(recorded: Query, question: Asked, world: BulletWorld) -> bool:
    """Return whether a record is of this very question."""
    moment = recorded.name, recorded.world, recorded.sim_step
    return moment == (question.name, world.name, world.sim_step) and list(recorded.arguments) == records.arguments(
        question.arguments
    )


def _taken(recorded: Query, world: BulletWorld) -> Verdict | Found[Object]:
    answer = _live(from_json(recorded.answer_json), world)
    evidence = {each.name: _live(from_json(each.json), world) for each in recorded.evidence}
    picture = recorded.picture if recorded.HasField("picture") else None
    return Found(answer, evidence, picture) if isinstance(answer, list) else Verdict(answer, evidence, picture)


def _live(value: Plain, world: BulletWorld) -> Any:
    if isinstance(value, list):
        return [_live(item, world) for item in value]
    if isinstance(value, dict):
        if value.keys() == {"object", "world"} and value["world"] == world.name:
            return world.get_object(str(value["object"]))
        if value.keys() == {"float"}:
            return float(str(value["float"]))
        return {key: _live(item, world) for key, item in value.items()}
    return value


@dataclass(frozen=True, slots=True)
class GivenAnswer:
    """An answer for the next query that fits.

    Attributes:
        text: as it was given.
        query: name of the query.
        arguments: those that it has to have, by what records call them.
        answer: true or false; names of objects; true or false for each of several.
    """

    text: str
    query: str
    arguments: Mapping[str, Term]
    answer: Term

    def fits(self, name: str, arguments: Mapping[str, object], world: BulletWorld) -> bool:
        """Return whether a query is the one that is meant."""
        return name == self.query and all(
            key in arguments and _is_same(term, arguments[key], world) for key, term in self.arguments.items()
        )

    def replace(self, own: Any, world: BulletWorld) -> Any:
        """Return it with the evidence of the query's own answer.

        Raises:
            BadChange: the query answers about another number of things.
        """
        if isinstance(own, Verdict):
            return Verdict(self.answer, own.evidence, own.picture, own.considered)
        terms = self.answer if isinstance(self.answer, list) else []
        if _kind(self.query) == _OF_MANY:
            if len(terms) != len(own):
                raise BadChange(self.text, f"the query has {len(own)} answers, not {len(terms)}")
            items = [
                Verdict(term, each.evidence, each.picture, each.considered)
                for term, each in zip(terms, own, strict=True)
            ]
            return Found(items, own.evidence, own.picture, own.considered)
        return Found([object_of(world, _name(term)) for term in terms], own.evidence, own.picture, own.considered)


def parse_answer(text: str) -> GivenAnswer:
    """Parse ``reachable_object(milk)=false``, ``blocking(...)=[bowl]``: of the arguments those that are given count.

    Raises:
        BadChange: it isn't the call of a query and an answer that it can give.
        NoSuchName: there is no such query.
    """
    left, equals, right = text.rpartition("=")
    try:
        asked = parse(_ANY.sub(lambda match: f"{match[1].rstrip(',')})", left.strip()))
        given = parse(f"answer({right})").arguments if equals and right.strip() else ()
    except BadQuestion as error:
        raise BadChange(text, f"expected QUERY(ARGUMENTS)=ANSWER, as stable(milk)=false: {error.cause}") from None
    if asked.query not in ANSWERABLE:
        raise NoSuchName("query on record", asked.query, ANSWERABLE)
    kind = _kind(asked.query)
    if len(given) != 1 or not _can_be(given[0], kind):
        raise BadChange(text, f"its answer is {_ANSWERS[kind]}")
    return GivenAnswer(text, asked.query, _bound(asked, text), given[0])


def _bound(asked: Question, text: str) -> dict[str, Term]:
    """Return the arguments of a question by what records call them."""
    parameters = {recorded: parameter for parameter, recorded in RECORDED_AS.items()}
    keywords = {parameters.get(name, name): term for name, term in asked.keywords.items()}
    try:
        bound = inspect.signature(getattr(btr, asked.query)).bind_partial(*asked.arguments, **keywords)
    except TypeError as error:
        raise BadChange(text, str(error)) from None
    return {RECORDED_AS.get(name, name): term for name, term in bound.arguments.items() if name != "world"}


def _kind(query: str) -> str:
    return str(inspect.signature(getattr(btr, query)).return_annotation)


def _can_be(term: Term, kind: str) -> bool:
    if kind == "Verdict":
        return isinstance(term, bool)
    wanted: Any = bool if kind == _OF_MANY else (Name, str)
    return isinstance(term, list) and all(isinstance(each, wanted) for each in term)


def _is_same(term: Term, value: object, world: BulletWorld) -> bool:
    if isinstance(value, Object):
        name = _name(term)
        return name == value.name or (name == "robot" and value is world.robot)
    if isinstance(term, list):
        return (
            isinstance(value, list | tuple)
            and len(term) == len(value)
            and all(_is_same(one, other, world) for one, other in zip(term, value, strict=True))
        )
    return bool((term.text if isinstance(term, Name) else term) == value)


def _name(term: Term) -> str:
    return term.text if isinstance(term, Name) else str(term)
