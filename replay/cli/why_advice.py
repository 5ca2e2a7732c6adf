"""What to type next: the commands by which a person who was told why a plan failed can look closer."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Final

from replay.explain import wording
from replay.restore.question import BadQuestion, Name, Question, Term, question_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from recorder.records import Query
    from replay.explain.explanation import Why

_STEP: Final = 0.35  # m: what a thing is moved by, to ask again


def commands(found: Why, path: str) -> Iterator[str]:
    """Commands that look closer at what a failure was about.

    Args:
        found: its explanation.
        path: of the recording, quoted for a shell.
    """
    world = "" if found.world is None or found.is_default else f" --world {shlex.quote(found.world.name)}"
    if found.asked:
        yield f"pycram-replay show {path} {found.asked[-1].query.seq}"
    things = [thing.body.name for thing in found.things]
    if things:
        name = shlex.quote(things[-1])
        yield f"pycram-replay state {path} {found.step} {name}{world}"
        yield f"pycram-replay blame {path} {name} --at {found.step}{world}"
    if found.warning is not None:
        yield f"pycram-replay ask {path} {found.step} {shlex.quote(asked_again(found.warning))}{_nearer(found)}{world}"
    if things:
        yield f"pycram-replay render {path} {found.step} -o moment.png{world}"
        yield f"pycram-replay restore {path} {found.step} --shell{world}"


def asked_again(query: Query) -> str:
    """A query as ``ask`` takes it: what it was about, without its thresholds.

    Args:
        query: its record.
    """
    about: list[Term] = []
    try:
        asked = question_of(query)
    except BadQuestion:
        return wording.question(query)
    for name, term in asked.keywords.items():
        if name in ("threshold", "margin", "grasp", "collision_free"):
            break
        about.append(Name(term) if isinstance(term, str) else term)  # a query takes the one for the other
    return str(Question(query.name, tuple(about)))


def _nearer(found: Why) -> str:
    """The same question with the thing nearer to the robot, if a robot is there to reach it."""
    if not found.things:  # a damaged recording may have lost them
        return ""
    robot = next((thing.body for thing in found.things if thing.robot), None)
    thing = found.things[-1]
    if robot is None or thing.distance is None or thing.distance <= _STEP:
        return ""
    share = _STEP / thing.distance
    place = [a + (b - a) * share for a, b in zip(thing.body.position[:2], robot.position[:2], strict=True)]
    return f" --move {shlex.quote(thing.body.name)}={place[0]:.2f},{place[1]:.2f},{thing.body.position[2]:.2f}"
