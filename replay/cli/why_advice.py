"""Suggested commands: how to look closer at a failure that was explained."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Final

from replay.explain import wording
from replay.restore.question import BadQuestion, Name, Question, Term, question_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Query
    from replay.explain.explanation import Why

_STEP: Final = 0.35  # m by which an object is moved to ask again


def commands(found: Why, path: str) -> Iterator[str]:
    """Yield commands that look closer at what a failure was about; ``path`` is quoted for a shell."""
    world = "" if found.world is None or found.is_default else f" --world {shlex.quote(found.world.name)}"
    if found.queries:
        yield f"pycram-replay show {path} {found.queries[-1].query.seq}"
    names = [involved.body.name for involved in found.bodies]
    if names:
        name = shlex.quote(names[-1])
        yield f"pycram-replay state {path} {found.step} {name}{world}"
        yield f"pycram-replay blame {path} {name} --at {found.step}{world}"
    if found.warning is not None:
        yield f"pycram-replay ask {path} {found.step} {shlex.quote(asked_again(found.warning))}{_nearer(found)}{world}"
    if names:
        yield f"pycram-replay render {path} {found.step} -o moment.png{world}"
        yield f"pycram-replay restore {path} {found.step} --shell{world}"


def asked_again(query: Query) -> str:
    """Return a query as ``ask`` takes it, without its thresholds."""
    about: list[Term] = []
    try:
        asked = question_of(query)
    except BadQuestion:
        return wording.question(query)
    for name, term in asked.keywords.items():
        if name in ("threshold", "margin", "grasp", "collision_free"):
            break
        about.append(Name(term) if isinstance(term, str) else term)  # queries take either
    return str(Question(query.name, tuple(about)))


def _nearer(found: Why) -> str:
    """Return the option that moves the object nearer to the robot; "" without a robot."""
    if not found.bodies:  # a damaged recording may have lost them
        return ""
    robot = next((involved.body for involved in found.bodies if involved.is_robot), None)
    last = found.bodies[-1]
    if robot is None or last.distance is None or last.distance <= _STEP:
        return ""
    share = _STEP / last.distance
    place = [a + (b - a) * share for a, b in zip(last.body.position[:2], robot.position[:2], strict=True)]
    return f" --move {shlex.quote(last.body.name)}={place[0]:.2f},{place[1]:.2f},{last.body.position[2]:.2f}"
