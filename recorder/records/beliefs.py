"""The beliefs of robots about objects: a fold of the records of their world.

A robot believes that an object is where the robot's latest look showed it. After the robot takes an object, it believes
that the object is in its hand. After it puts the object down, it believes that the object is where it was released. It
doesn't notice other movements until it looks again. It has no beliefs about objects that it has neither seen nor held.
A reset clears its beliefs; restoring a saved state restores the beliefs of that time.

The running plan and readers of recordings fold with the same functions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Belief, Mutation, Query

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from recorder.geometry import PoseLike
    from recorder.records import Plain

#: A robot and an object, by their names.
Key: TypeAlias = tuple[str, str]
#: Beliefs in the order in which they were learned.
Beliefs: TypeAlias = dict[Key, Belief]

ROBOT: Final = "robot"
"""Name of the part of a look's evidence that contains the robot's name."""
SOURCES: Final[Mapping[str, Belief.Source]] = {"seen": Belief.SEEN, "told": Belief.TOLD}
"""Sources of beliefs, by the name of the part of a look's evidence that contains the poses of objects."""
_NAMES: Final = tuple(name.encode() for name in SOURCES)
_WORDS: Final = {source: name.lower() for name, source in Belief.Source.items() if source}
_FORGETTING: Final = frozenset({"reset", "close_world"})
_FAR: Final = 1e9  # largest allowed coordinate in m
_MIN_SQUARE, _MAX_SQUARE = 0.99, 1.01  # range of the squared length of a unit quaternion


def is_look(query: Query) -> bool:
    """Return whether a query is a look. In a look, a robot learns where objects are."""
    return any(fact.name in SOURCES for fact in query.evidence)


def may_be_look(payload: bytes) -> bool:
    """Return whether a serialized query may be a look; most queries are ruled out without parsing."""
    return any(name in payload for name in _NAMES)


def word(source: int) -> str:
    """Return a belief's source as "seen", "told", "held" or "placed"; as a number if only a newer release knows it."""
    return _WORDS.get(source, str(source))


def sightings(robot: str, source: str, poses: Mapping[str, PoseLike]) -> dict[str, Plain]:
    """Return the evidence of a look.

    Args:
        robot: name of the robot that looked.
        source: "seen" or "told".
        poses: poses of objects in the world, by their names: xyz in m, xyzw.
    """
    found: dict[str, Plain] = {
        name: {"position": list(position), "orientation": list(orientation)}
        for name, (position, orientation) in poses.items()
    }
    return {ROBOT: robot, source: found}


def look(beliefs: Beliefs, evidence: Mapping[str, object], sim_step: int, step: int = -1) -> list[Key]:
    """Fold the evidence of a query; return the keys of new beliefs. Beliefs about held objects don't change.

    Raises:
        ValueError: the evidence is malformed.
    """
    learned = []
    for fact, source in SOURCES.items():
        found, robot = evidence.get(fact), evidence.get(ROBOT)
        if found is None:
            continue
        if not isinstance(found, dict) or not isinstance(robot, str):
            raise ValueError(f"{fact}={found!r} isn't evidence of a perception by {robot!r}")  # noqa: TRY004  data, not a type
        for name, pose in found.items():
            key = robot, name
            known = beliefs.get(key)
            if known is None or known.source != Belief.HELD:
                position, orientation = _pose(name, pose)
                belief = Belief(position=position, orientation=orientation, source=source)
                _learn(beliefs, key, belief, sim_step, step)
                learned.append(key)
    return learned


def follow(
    beliefs: Beliefs,
    record: Mutation,
    sim_step: int,
    step: int = -1,
    *,
    removed: Collection[str] = (),
    carriers: Mapping[str, str] | None = None,
    robots: Collection[str] = (),
    pose_of: Callable[[str], PoseLike],
) -> list[Key]:
    """Fold a change of the world; return the keys of new beliefs.

    Args:
        beliefs: the beliefs before the change.
        record: the change; only its command is needed.
        sim_step: steps of simulated time of the world after the change.
        step: number of the record.
        removed: names of removed bodies.
        carriers: names of carriers by the names of the bodies that a robot carries after the change, directly or not.
            It may have further bodies. None if no attachment changes.
        robots: names of the robots after the change.
        pose_of: returns the pose of a body after the change, by name.
    """
    command = record.WhichOneof("command")
    if command in _FORGETTING:
        beliefs.clear()
        return []
    if command == "restore":
        restore(beliefs, record.restore.beliefs)
        return []
    for key in [key for key in beliefs if removed and not {*key}.isdisjoint(removed)]:
        del beliefs[key]
    if carriers is None:
        return []
    before = dict.fromkeys(key for key, belief in beliefs.items() if belief.source == Belief.HELD)
    after = dict.fromkeys(sorted((robot, body) for body in carriers if (robot := _holder(body, carriers, robots))))
    learned = []
    for key in before:
        if key not in after:
            position, orientation = pose_of(key[1])
            belief = Belief(position=position, orientation=orientation, source=Belief.PLACED)
            _learn(beliefs, key, belief, sim_step, step)
            learned.append(key)
    for key in after:
        if key not in before:
            _learn(beliefs, key, Belief(source=Belief.HELD), sim_step, step)
            learned.append(key)
    return learned


def restore(beliefs: Beliefs, recorded: Iterable[Belief]) -> None:
    """Replace all beliefs with recorded beliefs; raise ValueError if a belief is malformed."""
    beliefs.clear()
    for belief in recorded:
        if belief.source != Belief.HELD:
            _pose(belief.object, {"position": belief.position[:], "orientation": belief.orientation[:]})
        beliefs[belief.robot, belief.object] = belief


def _learn(beliefs: Beliefs, key: Key, belief: Belief, sim_step: int, step: int) -> None:
    belief.robot, belief.object = key
    belief.sim_step, belief.step = sim_step, step
    beliefs.pop(key, None)
    beliefs[key] = belief


def _holder(body: str, carriers: Mapping[str, str], robots: Collection[str]) -> str:
    """Return the robot that carries a body, directly or through other bodies; "" if no robot does."""
    seen = {body}
    while body in carriers:
        body = carriers[body]
        if body in robots:
            return body
        if body in seen:  # the attachments of a malformed recording form a circle
            break
        seen.add(body)
    return ""


def _pose(name: str, pose: object) -> tuple[list[float], list[float]]:
    """Return position and orientation of a recorded pose; raise ValueError if it isn't a pose."""
    numbers = []
    for part, count in (("position", 3), ("orientation", 4)):
        values = pose.get(part) if isinstance(pose, dict) else None
        if not (
            isinstance(values, list)
            and len(values) == count
            and all(type(value) in (int, float) and -_FAR <= value <= _FAR for value in values)
        ):
            raise ValueError(f"{values!r} isn't the {part} of {name}")
        numbers.append([float(value) for value in values])
    if not _MIN_SQUARE <= sum(number * number for number in numbers[1]) <= _MAX_SQUARE:
        raise ValueError(f"{numbers[1]} isn't a unit quaternion")
    return numbers[0], numbers[1]
