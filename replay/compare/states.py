"""Compares two states: bodies that were added, removed, moved, and attachments that changed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from replay.file.lifetimes import title
from replay.state.state import turn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.geometry import Pose
    from replay.state.state import Attachment, Body, State, World

#: Smaller changes are physics settling.
NOTABLE_METRES: Final = 1e-3
NOTABLE_RADIANS: Final = math.radians(0.5)


@dataclass(frozen=True, slots=True)
class BodyChange:
    """A body that is in both states, but not the same.

    Attributes:
        world: name of its world.
        body: its name.
        before: its pose in the first state.
        after: its pose in the second.
        distance: how far its base is from where it was, m.
        angle: by how much it is turned, rad.
        joints: values before and after, of those that differ.
        carrier: how it is carried, before and after.
        details: names of further fields that differ: color, type, fixed_base, models.
    """

    world: str
    body: str
    before: Pose
    after: Pose
    distance: float
    angle: float
    joints: Mapping[str, tuple[float, float]]
    carrier: tuple[Attachment | None, Attachment | None]
    details: tuple[str, ...] = ()

    @property
    def moved(self) -> bool:
        """Whether its base moved by more than settling."""
        return self.distance >= NOTABLE_METRES or self.angle >= NOTABLE_RADIANS

    @property
    def moved_joints(self) -> dict[str, tuple[float, float]]:
        """The joints that moved by more than settling."""
        return {name: pair for name, pair in self.joints.items() if abs(pair[1] - pair[0]) >= NOTABLE_METRES}

    @property
    def carrier_changed(self) -> bool:
        """Whether another body carries it, or another link."""
        before, after = self.carrier
        return (before and (before.carrier, before.carrier_link)) != (after and (after.carrier, after.carrier_link))

    @property
    def notable(self) -> bool:
        """Whether it is more than settling."""
        return bool(self.moved or self.moved_joints or self.carrier_changed or self.details)


@dataclass(frozen=True, slots=True)
class Difference:
    """The difference of a second state from a first.

    Attributes:
        opened: titles of worlds that are open in the second only.
        closed: titles of worlds that are open in the first only.
        added: bodies that are in the second only, as pairs of world and body.
        removed: bodies that are in the first only.
        changed: the others that are not the same, to the last bit.
        facts: values of worlds that differ, before and after, by world and name: gravity, robot, realtime, seconds, and
            where a robot believes an object, a position or None.
    """

    opened: tuple[str, ...] = ()
    closed: tuple[str, ...] = ()
    added: tuple[tuple[str, str], ...] = ()
    removed: tuple[tuple[str, str], ...] = ()
    changed: tuple[BodyChange, ...] = ()
    facts: Mapping[tuple[str, str], tuple[object, object]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.opened or self.closed or self.added or self.removed or self.changed or self.facts)

    @property
    def notable(self) -> tuple[BodyChange, ...]:
        """Bodies that changed by more than settling."""
        return tuple(change for change in self.changed if change.notable)


def difference(before: State, after: State, names: Mapping[str, str] = MappingProxyType({})) -> Difference:
    """Compare two states, which may be of two recordings.

    Args:
        before: the first.
        after: the second.
        names: names of worlds in the first by those of the worlds in the second that are compared with them, where they
            differ.
    """
    first = {world.title: world for world in before.worlds.values() if world.open}
    second = {
        title(names.get(world.name, world.name), world.lifetime): world for world in after.worlds.values() if world.open
    }
    both = [(world, second[name]) for name, world in first.items() if name in second]
    return Difference(
        opened=tuple(world.title for name, world in second.items() if name not in first),
        closed=tuple(name for name in first if name not in second),
        added=tuple((b.name, body) for a, b in both for body in b.bodies if body not in a.bodies),
        removed=tuple((a.name, body) for a, b in both for body in a.bodies if body not in b.bodies),
        changed=tuple(change for a, b in both for change in _changes(a, b)),
        facts={fact: pair for a, b in both for fact, pair in _facts(a, b)},
    )


def _facts(a: World, b: World) -> Iterator[tuple[tuple[str, str], tuple[object, object]]]:
    for name in ("gravity", "robot", "realtime", "seconds"):
        pair = getattr(a, name), getattr(b, name)
        if pair[0] != pair[1]:
            yield (a.name, name), pair
    for robot, body in dict.fromkeys([*a.beliefs, *b.beliefs]):
        one, other = a.beliefs.get((robot, body)), b.beliefs.get((robot, body))
        if one is None or other is None or math.dist(one.position, other.position) >= NOTABLE_METRES:
            yield (a.name, f"where {robot} believes {body}"), (one and one.position, other and other.position)


def _changes(a: World, b: World) -> Iterator[BodyChange]:
    for name, body in a.bodies.items():
        if name in b.bodies:
            change = _change(a, body, b, b.bodies[name])
            if change is not None:
                yield change


def _change(a: World, before: Body, b: World, after: Body) -> BodyChange | None:
    joints = {
        joint: (before.joints.get(joint, math.nan), after.joints.get(joint, math.nan))
        for joint in {**before.joints, **after.joints}
        if before.joints.get(joint) != after.joints.get(joint)
    }
    carrier = a.carrier(before.name), b.carrier(before.name)
    details = tuple(
        name for name in ("color", "type", "fixed_base", "models") if getattr(before, name) != getattr(after, name)
    )
    speeds = before.velocity != after.velocity or before.joint_velocities != after.joint_velocities
    if before.pose == after.pose and not (speeds or joints or details) and carrier[0] == carrier[1]:
        return None
    return BodyChange(
        a.name,
        before.name,
        before.pose,
        after.pose,
        math.dist(before.position, after.position),
        turn(before.orientation, after.orientation),
        joints,
        carrier,
        details,
    )
