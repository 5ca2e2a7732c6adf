"""Suggested commands: how to look closer at a failure that was explained."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Final

from replay.report import phrases
from replay.restore.question import BadQuestion, Name, Question, Term, question_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Query
    from replay.explain.causes.why_data import InvolvedBody, Why

_STEP: Final = 0.35  # m by which an object is moved to ask again


def commands(why: Why, path: str) -> Iterator[str]:
    """Yield commands that look closer at what a failure was about; ``path`` is quoted for a shell."""
    world = "" if why.world is None or why.is_default else f" --world {shlex.quote(why.world.name)}"
    if why.queries:
        yield f"pycram-replay show {path} {why.queries[-1].query.seq}"
    names = [involved.body.name for involved in _movable(why)]
    if names:
        name = shlex.quote(names[-1])
        yield f"pycram-replay state {path} {why.step} {name}{world}"
        yield f"pycram-replay blame {path} {name} --at {why.step}{world}"
    if why.warning is not None:
        yield f"pycram-replay ask {path} {why.step} {shlex.quote(asked_again(why.warning))}{_nearer(why)}{world}"
    if names:
        yield f"pycram-replay render {path} {why.step} -o moment.png{world}"
        yield f"pycram-replay restore {path} {why.step} --shell{world}"


def asked_again(query: Query) -> str:
    """Return a query as ``ask`` takes it, without its thresholds."""
    arguments: list[Term] = []
    try:
        question = question_of(query)
    except BadQuestion:
        return phrases.question(query)
    for name, term in question.keywords.items():
        if name in ("threshold", "margin", "grasp", "orientation", "collision_free"):
            break
        arguments.append(Name(term) if isinstance(term, str) else term)  # queries take either
    return str(Question(query.name, tuple(arguments)))


def _movable(why: Why) -> list[InvolvedBody]:
    """Return the robot and what it can move; all if there is no more."""
    movable = [each for each in why.bodies if each.is_robot or not each.body.fixed_base]
    return movable if len(movable) > 1 else list(why.bodies)


def _nearer(why: Why) -> str:
    """Return the option that moves the object nearer to the robot; "" without a robot."""
    if not why.bodies:  # a damaged recording may have lost them
        return ""
    robot = next((involved.body for involved in why.bodies if involved.is_robot), None)
    last = _movable(why)[-1]
    if robot is None or last.distance is None or last.distance <= _STEP:
        return ""
    share = _STEP / last.distance
    target = [a + (b - a) * share for a, b in zip(last.body.position[:2], robot.position[:2], strict=True)]
    return f" --move {shlex.quote(last.body.name)}={target[0]:.2f},{target[1]:.2f},{last.body.position[2]:.2f}"
