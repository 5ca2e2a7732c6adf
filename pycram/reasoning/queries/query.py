"""Reasoning queries: the decorator that turns functions into queries, and the answers of queries.

A query doesn't change its world, which is locked and refuses changes during the query. Each call becomes one record, or
a refusal if its arguments are wrong. A query may call other queries.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any, Final, Generic, ParamSpec, Protocol, Self, TypeVar

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, NoWorld
from pycram.foundation.refusals import refused, refusing
from pycram.reasoning.choosing import Choice, Question
from pycram.scheduling.future import unwrap
from pycram.world.world import BulletWorld, Object
from recorder import records

T = TypeVar("T")
P = ParamSpec("P")

RECORDED_AS: Final = {"gripper_name": "gripper"}  # names in records, if they differ from the parameters
_OBJECTS: Final = ("object", "object1", "object2", "robot")


class Verdict(int):
    """A yes or no with evidence, which behaves like a bool."""

    evidence: Mapping[str, object]  # facts behind the answer
    picture: records.Picture | None  # the camera's picture, if the query renders one
    considered: Choice | None  # the candidates for the answer, if they are recorded

    def __new__(
        cls,
        answer: object,
        evidence: Mapping[str, object] | None = None,
        picture: records.Picture | None = None,
        considered: Choice | None = None,
    ) -> Self:
        """Create a verdict from a true or false value."""
        verdict = super().__new__(cls, bool(answer))
        verdict.evidence = dict(evidence or {})
        verdict.picture = picture
        verdict.considered = considered
        return verdict

    def __repr__(self) -> str:
        return repr(bool(self))

    __str__ = __repr__

    def __record__(self) -> object:
        """Return the verdict as a recorded value."""
        return bool(self)


class Found(list[T], Generic[T]):
    """A list of results with evidence."""

    def __init__(
        self,
        items: Iterable[T] = (),
        evidence: Mapping[str, object] | None = None,
        picture: records.Picture | None = None,
        considered: Choice | None = None,
    ) -> None:
        super().__init__(items)
        self.evidence: Mapping[str, object] = dict(evidence or {})  # facts behind the answer
        self.picture = picture  # the camera's picture, if the query renders one
        self.considered = considered  # the candidates for the answer, if they are recorded


Answer = TypeVar("Answer", bound="Verdict | Found[Any]")


def _not_negative(name: str, value: object) -> float:
    return checks.in_range(name, value, 0.0)


_CHECKS: Final[Mapping[str, Callable[[str, Any], object]]] = {
    "margin": _not_negative,
    "threshold": _not_negative,
    "pose": checks.vector,
    "orientation": lambda name, value: None if value is None else checks.quaternion(name, value),
    "ignoring": lambda _, value: [unwrap(body) for body in value],
}


def query(function: Callable[P, Answer]) -> Callable[P, Answer]:
    """Turn a function, which answers a question about a world, into a query.

    The function receives checked arguments, and results instead of futures. The names of its parameters define the
    checks: ``object``, ``object1``, ``object2``, ``robot`` and ``ignoring`` must be in one world, which is ``world`` if
    ``world`` is given. ``gripper_name`` must be a link of the robot. In a function with the parameter ``camera``,
    ``robot`` is the owner of the camera's frame; None means the world's robot. Records have all arguments in order,
    except ``world``.

    A :class:`pycram.failures.UsageError` from the function is recorded as a refusal.
    """
    signature = inspect.signature(function)

    @refusing()
    @functools.wraps(function)
    def ask(*args: P.args, **kwargs: P.kwargs) -> Answer:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError as error:
            given = {**{str(number): value for number, value in enumerate(args)}, **kwargs}
            raise refused(TypeError(f"{function.__name__}(): {error}"), function.__name__, given) from None
        bound.apply_defaults()
        arguments = {name: unwrap(value) for name, value in bound.arguments.items()}
        return _answer(function, _check(arguments), arguments)

    return ask


def _check(arguments: dict[str, Any]) -> BulletWorld:
    """Check the arguments, replace them by the checked values, and return their world."""
    for name, check in _CHECKS.items():
        if name in arguments:
            arguments[name] = check(name, arguments[name])
    camera, robot = arguments.get("camera"), arguments.get("robot")
    optional = "robot" not in arguments or (robot is None and "camera" in arguments)
    if not optional and not (isinstance(robot, Object) and robot.is_robot):
        raise BadArgument("robot", robot, 'an object of type "robot"')
    bodies = [arguments[name] for name in _OBJECTS if name in arguments and (name != "robot" or robot is not None)]
    world = world_of(*bodies, *arguments.get("ignoring", ()), world=arguments["world"])
    if "camera" in arguments:
        arguments["robot"] = (robot or world.robot) if isinstance(camera, str) else None
    if "gripper_name" in arguments:
        arguments["robot"].check_link(checks.text("gripper link", arguments["gripper_name"]))
    return world


class Oracle(Protocol):
    """Answers the queries of a run that a recording guides; the caller holds the world's lock."""

    def __call__(
        self, question: Question, world: BulletWorld, function: Callable[..., Any], ask: Callable[[], Any]
    ) -> Any:
        """Return the answer to a question; ``ask`` returns the query's own answer."""


_oracle: Oracle | None = None


@contextmanager
def answered_by(oracle: Oracle) -> Iterator[None]:
    """Let an oracle answer all queries of this process in the ``with`` block."""
    global _oracle  # noqa: PLW0603  a process runs one plan
    before, _oracle = _oracle, oracle
    try:
        yield
    finally:
        _oracle = before


def _answer(function: Callable[..., Answer], world: BulletWorld, arguments: Mapping[str, object]) -> Answer:
    asked = {
        RECORDED_AS.get(name, name): value
        for name, value in arguments.items()
        if name != "world" and (name, value) != ("robot", None)
    }
    question = Question(function.__name__, asked)
    with question.asked(world):
        ask = partial(function, **arguments)
        answer: Answer = ask() if _oracle is None else _oracle(question, world, function, ask)
        question.answer, question.evidence, question.picture = answer, answer.evidence, answer.picture
        question.considered = answer.considered
    return answer


def world_of(*bodies: Object, world: BulletWorld | None = None) -> BulletWorld:
    """Return the world of objects; ``world`` is the world that the caller has named, if any.

    Raises:
        BadArgument: An argument isn't an object, or the objects are in different worlds.
        NoWorld: No world is given, and none is current.
    """
    if world is not None and not isinstance(world, BulletWorld):
        raise BadArgument("world", world, "a BulletWorld")
    for body in bodies:
        if not isinstance(body, Object):
            raise BadArgument("object", body, "an Object of a world")
        if world is None:
            world = body.world
        elif body.world is not world:
            raise BadArgument("object", body, f"an object of {world.name}; {body.name} is in {body.world.name}")
        _ = body.handle  # raises an error for a removed object
    world = world or BulletWorld.current_bullet_world
    if world is None:
        raise NoWorld
    return world
