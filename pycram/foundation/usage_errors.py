"""Usage errors: the program is wrong (a misspelt joint, a pose with NaN, a change inside a query).

Nothing should catch them (:mod:`pycram.foundation.error_families`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pycram.foundation.error_families import UsageError
from recorder.suggestions import nearest, suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path


class BadArgument(UsageError, ValueError):
    """A value that no world could accept (NaN, wrong length, zero quaternion, ...).

    Attributes:
        argument: name of the parameter.
        value: what was given.
        expected: what it takes.
    """

    def __init__(self, argument: str, value: object, expected: str) -> None:
        super().__init__(f"{argument} = {value!r}: expected {expected}")
        self.argument = argument
        self.value = value
        self.expected = expected


class JointLimitError(BadArgument):
    """A joint value outside the limits of the model.

    Attributes:
        joint: name of the joint.
        body: name of the object.
        lower: lower limit in rad or m.
        upper: upper limit in rad or m.
    """

    def __init__(self, body: str, joint: str, value: float, lower: float, upper: float) -> None:
        super().__init__(f"joint {joint} of {body}", value, f"a value from {lower:g} to {upper:g}")
        self.body = body
        self.joint = joint
        self.lower = lower
        self.upper = upper


class UnknownName(UsageError, LookupError):
    """A name that the world, object or registry doesn't have.

    Attributes:
        kind: what was looked for ("joint", "link", "object", ...).
        name: what was given.
        owner: where it was looked for.
        nearest: the most similar names that exist there.
    """

    def __init__(self, kind: str, name: object, owner: str, known: Iterable[str]) -> None:
        names = list(known)
        super().__init__(f"{owner} has no {kind} {name!r}; {suggestion(name, names)}")
        self.kind = kind
        self.name = name
        self.owner = owner
        self.nearest = nearest(name, names)


class AssetError(UsageError):
    """A model or mesh file that can't be used.

    Attributes:
        path: the file.
        cause: why.
    """

    def __init__(self, path: str | Path, cause: str) -> None:
        super().__init__(f"{path}: {cause}")
        self.path = str(path)
        self.cause = cause


class AttachmentError(UsageError):
    """An attachment that can't be made (cycle, itself, another world, already carried).

    Attributes:
        carrier: name of the object that should carry.
        body: name of the object that should be carried.
        reason: why not.
    """

    def __init__(self, carrier: str, body: str, reason: str) -> None:
        super().__init__(f"{carrier} can't carry {body}: {reason}")
        self.carrier = carrier
        self.body = body
        self.reason = reason


class ReadOnly(UsageError, AttributeError):
    """An attribute was assigned that only methods change, as each change is a record.

    Attributes:
        owner: the world or object.
        attribute: name of the attribute.
        instead: what to do instead.
    """

    def __init__(self, owner: str, attribute: str, instead: str) -> None:
        super().__init__(f"{attribute} of {owner} can't be assigned: {instead}")
        self.owner = owner
        self.attribute = attribute
        self.instead = instead


class WorldClosed(UsageError):
    """Something was asked of a world after its exit, or of an object after its removal.

    Attributes:
        world: name of the world.
        action: what was tried.
    """

    def __init__(self, world: str, action: str, what: str = "the world") -> None:
        super().__init__(f"can't {action} in {world}: {what} is gone")
        self.world = world
        self.action = action


class NoWorld(UsageError):
    """Nothing is current: no world was opened, or all have ended."""

    def __init__(self, what: str = "world") -> None:
        super().__init__(
            "there is no current world; open one with BulletWorld()"
            if what == "world"
            else "the current world has no robot; set BulletWorld.robot"
        )
        self.what = what


class ChangeRefused(UsageError):
    """A change of a world was tried inside a reasoning query.

    Attributes:
        change: the change that was tried.
        query: the query that was running.
    """

    def __init__(self, change: str, query: str) -> None:
        super().__init__(f"{change} was tried inside the query {query}; queries leave no trace")
        self.change = change
        self.query = query


class ObjectsChanged(UsageError):
    """A state of a world can't be restored, as it was saved with other objects.

    Attributes:
        world: name of the world.
        added: names of the objects that were loaded since.
        removed: names of those that were removed since.
    """

    def __init__(self, world: str, added: Sequence[str], removed: Sequence[str]) -> None:
        changes = ((added, "loaded"), (removed, "removed"))
        since = " and ".join(
            f"{', '.join(names)} {'were' if names[1:] else 'was'} {how}" for names, how in changes if names
        )
        super().__init__(f"a state of {world} has the same objects when it is restored, but {since} since it was saved")
        self.world = world
        self.added = tuple(added)
        self.removed = tuple(removed)


class FollowsTrajectory(UsageError):
    """Something was asked for that can't be done while a body follows a trajectory.

    Attributes:
        action: what was tried.
        body: name of the object that follows it.
        number: the trajectory's number in its world.
        joints: names of the joints that it moves; none for the base.
    """

    def __init__(self, action: str, body: str, number: int, joints: Sequence[str] = ()) -> None:
        listed = ", ".join(joints[:3]) + (f" and {len(joints) - 3} more" if len(joints) > 3 else "")
        which = f"{listed or 'the base'} of {body}"
        remedy = f"wait until it has ended, or stop it with stop_trajectory({number})"
        super().__init__(f"can't {action}: trajectory {number} moves {which}; {remedy}")
        self.action = action
        self.body = body
        self.number = number
        self.joints = tuple(joints)


class DisplayError(UsageError):
    """A window was asked for where none can open.

    Attributes:
        reason: why not.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(f'BulletWorld("GUI") can\'t open its window: {reason}; BulletWorld() runs without one')
        self.reason = reason
