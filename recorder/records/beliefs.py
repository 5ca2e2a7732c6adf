"""The beliefs of robots about objects, computed from the records of their world.

A robot believes that an object is where the latest look showed it; after a grasp, in the hand; after a release, where
the hand put it down. When the object moves otherwise, the belief doesn't change until the next look. A robot has no
beliefs about other objects. A reset clears beliefs; restoring a saved state restores them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final, TypeAlias

from recorder.records import Belief, Mutation, Plain, Query
from recorder.records.values import vector

if TYPE_CHECKING:
    from recorder.geometry import PoseLike

Key: TypeAlias = tuple[str, str]  # the names of a robot and an object
Beliefs: TypeAlias = dict[Key, Belief]  # beliefs by robot and object, in the order of learning

ROBOT: Final = "robot"  # name of a look's evidence that is the robot's name
SOURCES: Final[Mapping[str, Belief.Source]] = {"seen": Belief.SEEN, "told": Belief.TOLD}
"""Sources of beliefs, by the name of the evidence that contains the poses of objects."""
_WORDS: Final = {source: name.lower() for name, source in Belief.Source.items() if source}
_FORGETTING: Final = frozenset({"reset", "close_world"})
_FAR: Final = 1e9  # maximum coordinate in m
_MIN_SQUARE, _MAX_SQUARE = 0.99, 1.01  # range for the squared length of a unit quaternion


def is_look(query: Query) -> bool:
    """Return whether a query is a look, in which a robot learns where objects are."""
    return any(fact.name in SOURCES for fact in query.evidence)


def word(source: int) -> str:
    """Return a belief's source as "seen", "told", "held" or "placed". Sources of newer releases are numbers."""
    return _WORDS.get(source, str(source))


def sightings(robot: str, source: str, poses: Mapping[str, PoseLike]) -> dict[str, Plain]:
    """Return the evidence of a look: poses of objects (xyz in m, xyzw) by name. ``source`` is "seen" or "told"."""
    found: dict[str, Plain] = {
        name: {"position": list(position), "orientation": list(orientation)}
        for name, (position, orientation) in poses.items()
    }
    return {ROBOT: robot, source: found}


def look(beliefs: Beliefs, evidence: Mapping[str, object], sim_step: int, step: int = -1) -> list[Key]:
    """Fold the evidence of a query, and return the keys of new beliefs; raise ValueError for malformed evidence."""
    learned = []
    for fact, source in SOURCES.items():
        found, robot = evidence.get(fact), evidence.get(ROBOT)
        if found is None:
            continue
        if not isinstance(found, dict) or not isinstance(robot, str):
            raise ValueError(f"{fact}={found!r} isn't evidence of a perception by {robot!r}")  # noqa: TRY004
        for name, pose in found.items():
            key = robot, name
            known = beliefs.get(key)
            if known is None or known.source != Belief.HELD:  # a look doesn't change beliefs about held objects
                position, orientation = _pose(name, pose)
                _learn(beliefs, key, Belief(position=position, orientation=orientation, source=source), sim_step, step)
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
    """Update the beliefs with a change of the world; return the keys of new beliefs. ``step`` is the record's number.

    Args:
        record: The change; only its command is used.
        sim_step: Simulated steps of the world after the change.
        carriers: The carrier of each body that a robot carries after the change, directly or not. Other bodies are
            ignored. None if the change doesn't affect attachments.
        pose_of: Returns a body's pose after the change, by the body's name.
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
    """Replace all beliefs with recorded beliefs. A malformed belief raises ValueError."""
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
        if body in seen:  # in a malformed recording, attachments may form a circle
            break
        seen.add(body)
    return ""


def _pose(name: str, pose: object) -> tuple[Sequence[float], Sequence[float]]:
    """Return position and orientation of a recorded pose. Values that aren't a pose raise ValueError."""
    parts = pose if isinstance(pose, dict) else {}
    position, orientation = vector(parts.get("position"), 3), vector(parts.get("orientation"), 4)
    if position is None or orientation is None or max(map(abs, position)) > _FAR:
        raise ValueError(f"{pose!r} isn't the pose of {name}")
    if not _MIN_SQUARE <= sum(number * number for number in orientation) <= _MAX_SQUARE:
        raise ValueError(f"{orientation} isn't a unit quaternion")
    return position, orientation
