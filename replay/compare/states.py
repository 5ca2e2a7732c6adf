"""Compares two states: bodies that were added, removed, moved, and attachments that changed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from replay.file.lifetimes import title
from replay.report import phrases, report
from replay.state.state import turn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from recorder.geometry import Pose
    from replay.state.state import Attachment, Body, State, World

#: Smaller changes are physics settling.
NOTABLE_METRES: Final = 1e-3
NOTABLE_RADIANS: Final = math.radians(0.5)
_MAX_LISTED: Final = 8  # joints that are listed one by one
_MIN_TURN: Final = math.radians(0.05)  # smaller turns aren't mentioned


@dataclass(frozen=True, slots=True)
class BodyChange:
    """A body that is in both states, but not the same."""

    world: str
    body: str
    before: Pose
    after: Pose
    distance: float  # of its base from where it was, m
    angle: float  # by which it is turned, rad
    joints: Mapping[str, tuple[float, float]]  # values before and after, of those that differ
    carrier: tuple[Attachment | None, Attachment | None]  # how it is carried, before and after
    details: tuple[str, ...] = ()  # further fields that differ: color, type, fixed_base, models

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
    """The difference of a second state from a first."""

    opened: tuple[str, ...] = ()  # titles of worlds that are open in the second only
    closed: tuple[str, ...] = ()  # titles of worlds that are open in the first only
    added: tuple[tuple[str, str], ...] = ()  # bodies that are in the second only, as pairs of world and body
    removed: tuple[tuple[str, str], ...] = ()  # bodies that are in the first only
    changed: tuple[BodyChange, ...] = ()  # the others that are not the same, to the last bit
    #: Values of worlds that differ, before and after, by world and name: gravity, robot, realtime, seconds, and where a
    #: robot believes an object, a position or None.
    facts: Mapping[tuple[str, str], tuple[object, object]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.opened or self.closed or self.added or self.removed or self.changed or self.facts)

    @property
    def notable(self) -> tuple[BodyChange, ...]:
        """Bodies that changed by more than settling."""
        return tuple(change for change in self.changed if change.notable)


def difference(before: State, after: State, names: Mapping[str, str] = MappingProxyType({})) -> Difference:
    """Compare two states, which may be of two recordings.

    ``names`` maps names of worlds in the second to those of their counterparts in the first, if these differ.
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


# --- as JSON data and as text ----------------------------------------------------------------------------------------


@report.data.register(Difference)
def _(delta: Difference) -> dict[str, object]:
    return {
        "opened": delta.opened,
        "closed": delta.closed,
        "came": [{"world": world, "object": body} for world, body in delta.added],
        "went": [{"world": world, "object": body} for world, body in delta.removed],
        "changed": report.data(delta.changed),
        "facts": [{"world": world, "fact": name, "values": pair} for (world, name), pair in delta.facts.items()],
    }


@report.data.register(BodyChange)
def _(change: BodyChange) -> dict[str, object]:
    joints = {name: [None if math.isnan(value) else value for value in pair] for name, pair in change.joints.items()}
    carrier = [held and {"object": held.carrier, "link": held.carrier_link} for held in change.carrier]
    return report.fields_data(change, body="object") | {"joints": joints, "carrier": carrier, "notable": change.notable}


def lines(delta: Difference, *, whole: bool = False) -> Iterator[str]:
    """Yield a difference as text; ``whole`` includes settling of physics and every joint."""
    yield from (f"{world} was opened" for world in delta.opened)
    yield from (f"{world} was closed" for world in delta.closed)
    yield from (f"{body} is new" for _, body in delta.added)
    yield from (f"{body} is gone" for _, body in delta.removed)
    for (world, name), (before, after) in delta.facts.items():
        yield f"{world}: {name} {_plain(before)} -> {_plain(after)}"
    shown = delta.changed if whole else delta.notable
    for change in shown:
        yield from _change_lines(change, whole=whole)
    rest = len(delta.changed) - len(shown)
    if rest:
        yield (f"{rest} more settled by less than 1 mm" if shown else f"{rest} objects settled by less than 1 mm")
    if not delta:
        yield "no difference"


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return phrases.vector(value)
    if value is None:
        return "nowhere"
    return phrases.number(value) if isinstance(value, float) else str(value) or "none"


def _change_lines(change: BodyChange, *, whole: bool) -> Iterator[str]:
    changes = []
    if change.moved or (whole and (change.distance or change.angle)):
        is_turned = change.angle > 0 and (whole or change.angle >= _MIN_TURN)
        turned = f", turned by {phrases.degrees(change.angle)}" if is_turned else ""
        before, after = phrases.vectors(change.before[0], change.after[0])
        changes.append(f"moved by {phrases.length(change.distance)}{turned}: {before} -> {after}")
    if change.carrier_changed:
        holder, former = change.carrier[1], change.carrier[0]
        changes.append(f"held by {_carrier(holder)}, before by {_carrier(former)}")
    changes += [f"has another {detail}" for detail in change.details]
    joints = change.joints if whole else change.moved_joints
    if len(joints) > _MAX_LISTED and not whole:
        changes.append(
            f"{len(joints)} joints moved, most of all "
            + _joint(*max(joints.items(), key=lambda item: abs(item[1][1] - item[1][0])))
        )
        joints = {}
    changes += [_joint(name, pair) for name, pair in joints.items()]
    if len(changes) == 1:
        yield f"{change.body} {changes[0]}"
    else:
        yield change.body
        yield from (f"  {line}" for line in changes)


def _joint(name: str, pair: tuple[float, float]) -> str:
    before, after = phrases.apart(*pair)
    return f"{name} {before} -> {after}"


def _carrier(held: Attachment | None) -> str:
    return "nothing" if held is None else phrases.carrier(held)
