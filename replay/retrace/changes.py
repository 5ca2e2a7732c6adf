"""What whoever forks a run changes of it after a step: settings of objects and fluents, answers of queries, the seed.

Each is a line of text, as a person types it and as the fork's recording keeps it: ``milk.position=1,2,0.9``,
``reachable_object(milk)=false``. So a fork can be run again as any other run. They are checked against the recording
before anything runs, as far as it tells; the setters check the rest.
"""

from __future__ import annotations

import gc
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pycram.fluents.fluent import Fluent
from pycram.fluents.variables import Variable
from pycram.seeding import MAX_SEED
from pycram.world.current import open_worlds
from recorder import records
from recorder.records import Change
from replay.errors import NoSuchName, ReplayError
from replay.state.fold import state_at

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pycram.world.object import Object
    from pycram.world.world import BulletWorld
    from replay.file.record_reader import RecordReader

_COUNTS: Final[Mapping[str, tuple[int, ...]]] = {"position": (3, 7), "orientation": (4,), "color": (4,)}
_EXPECTED: Final = (
    "OBJECT.position=X,Y,Z (m, or these and a quaternion x,y,z,w), OBJECT.orientation=X,Y,Z,W, OBJECT.color=R,G,B,A, "
    "OBJECT.JOINT=VALUE (rad or m) or FLUENT=VALUE"
)
_FLUENT: Final = "fluent:"  # before a fluent's name that looks like an object's part


class BadChange(ReplayError):
    """A change of a run that can't be made.

    Attributes:
        change: as it was given.
        cause: what is wrong with it.
    """

    def __init__(self, change: str, cause: str) -> None:
        super().__init__(f"{change}: {cause}")
        self.change = change
        self.cause = cause


@dataclass(frozen=True, slots=True)
class Setting:
    """A value for something of an object, or for a fluent.

    Attributes:
        text: as it was given.
        name: of the object; of the fluent.
        quantity: "position", "orientation", "color" or a joint of the object; "" for a fluent.
        value: its numbers; of a fluent any value.
    """

    text: str
    name: str
    quantity: str
    value: Any

    def make(self, world: str) -> None:
        """Make it, in a world of this process.

        Raises:
            BadChange: there is no such world or fluent.
            PycramError: the setter refuses it.
        """
        if not self.quantity:
            self._fluent().set_value(self.value)
            return
        body = object_of(_world(world, self.text), self.name)
        if self.quantity == "position":
            body.set_position(self.value[:3], self.value[3:] or None)
        elif self.quantity == "orientation":
            body.set_orientation(self.value)
        elif self.quantity == "color":
            body.set_color(self.value)
        else:
            body.set_joint_position(self.quantity, *self.value)

    def _fluent(self) -> Fluent:
        """Return the fluent of that name; nobody but the plan itself keeps them."""
        fluents: list[Fluent] = [
            each for each in gc.get_objects() if issubclass(type(each), Fluent)
        ]  # proxies may do anything
        named = {each.expression: each for each in fluents if _is_settable(each)}
        found = [each for expression, each in named.items() if expression.text() == self.name]
        if not found:
            names = sorted({expression.text() for expression in named})
            others = f"those that can be set are {', '.join(names)}" if names else "none can be set"
            raise BadChange(self.text, f"there is no fluent {self.name} at that moment; {others}")
        if len(found) > 1:
            raise BadChange(self.text, f"{len(found)} fluents have that name")
        return found[0]


def _is_settable(fluent: Fluent) -> bool:
    expression = getattr(fluent, "expression", None)  # not yet, in the middle of its making
    return isinstance(expression, Variable) and not expression.source


def settings(log: RecordReader, step: int, texts: Iterable[str], world: str | None = None) -> list[Change]:
    """Return settings as changes after a step of a recording.

    Args:
        log: the recording.
        step: the step.
        texts: as ``milk.position=1,2,0.9``.
        world: name of the objects' world; by default the open one that was opened last.

    Raises:
        BadChange: one can't be read.
        NoSuchName: there is no such world, object or joint then.
    """
    changes = []
    if world is not None:
        state_at(log, step).world(world)  # raises, also where nothing of it is set
    for text in texts:
        setting = parse_setting(text, fluent=_is_of_fluent(log, text))
        name = ""
        if setting.quantity:
            there = state_at(log, step).world(world)
            is_robot = setting.name == "robot" and "robot" not in there.bodies
            if is_robot and not there.robot:
                raise BadChange(text, f"{there.name} has no robot at step {step}")
            body = there.body(there.robot if is_robot else setting.name)
            if setting.quantity not in _COUNTS and setting.quantity not in body.joints:
                raise NoSuchName(f"position, orientation, color or joint of {body.name}", setting.quantity, body.joints)
            name = there.name
        changes.append(Change(step=step, set=text, world=name))
    return changes


def _is_of_fluent(log: RecordReader, text: str) -> bool:
    """Return whether a setting is for a fluent, whose name may look like that of something of an object."""
    name = text.partition("=")[0].strip()
    return (
        "." not in name
        or name.startswith(_FLUENT)
        or any(record.name == name for record in log.records(records.Fluent))
    )


def parse_setting(text: str, *, fluent: bool) -> Setting:
    """Parse ``milk.position=1,2,0.9``, ``pr2.torso_lift_joint=0.2`` or, of a fluent, ``battery=20``.

    A fluent whose name has a dot, and isn't on record yet, is ``fluent:left.battery=20``.

    Raises:
        BadChange: it is none.
    """
    left, _, right = (part.strip() for part in text.partition("="))
    name, _, quantity = (left.removeprefix(_FLUENT), "", "") if fluent else left.rpartition(".")
    if not name or not right or (not fluent and not quantity):
        raise BadChange(text, f"expected {_EXPECTED}")
    if fluent:
        try:
            return Setting(text, name, "", json.loads(right))
        except ValueError:
            return Setting(text, name, "", right)
    try:
        numbers = [float(part) for part in right.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in _COUNTS.get(quantity, (1,)) or not all(map(math.isfinite, numbers)):
        raise BadChange(text, f"expected {_EXPECTED}")
    return Setting(text, name, quantity, numbers)


def seed_change(step: int, seed: int) -> Change:
    """Return another seed as a change after a step.

    Raises:
        BadChange: it is no seed.
    """
    if not 0 <= seed <= MAX_SEED:
        raise BadChange(f"seed {seed}", f"a seed is a whole number from 0 to {MAX_SEED}")
    return Change(step=step, seed=str(seed))


def text_of(change: Change) -> str:
    """Return a change in words."""
    return change.set or change.answer or f"seed {change.seed}"


def _world(name: str, text: str) -> BulletWorld:
    world = next((each for each in open_worlds() if each.name == name), None)
    if world is None:
        raise BadChange(text, f"the world {name} isn't open at that moment")
    return world


def object_of(world: BulletWorld, name: str) -> Object:
    """Return an object of a world by its name; ``robot`` is the world's robot, if no object is called so."""
    if name == "robot" and world.robot is not None and not world.get_objects_by_name(name):
        return world.robot
    return world.get_object(name)
