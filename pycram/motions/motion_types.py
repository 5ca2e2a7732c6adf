"""The eleven motion designators of the thesis (4.5, tables 4.4-4.14), as data: their slots and resources.

One resolver serves them all. It checks the slots and yields solutions: dictionaries with ``cmd`` and every parameter of
the process module, inferred if the plan left it out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias, TypeVar

from pycram.foundation.failures import BadArgument
from pycram.motions import slot_checks
from pycram.motions.resources import WHOLE_ROBOT, Resources
from pycram.motions.slots import DesignatorError
from pycram.scheduling.future import branch_of, unwrap
from pycram.world.world import BulletWorld
from recorder.errors import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from pycram.motions.slot_checks import Check
    from pycram.motions.solutions import Solution

Value: TypeAlias = Any
Type = TypeVar("Type", bound="Slotted")


class Described(Protocol):
    """A designator, as this module uses it."""

    @property
    def type(self) -> str:
        """Its slot ``type``; empty if that isn't a string."""

    @property
    def description(self) -> Iterable[tuple[str, Value]]:
        """Its slots."""


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot of a motion type.

    Attributes:
        check: Check of its value.
        default: Infers a missing value from the given ones, and says in its docstring which; None leaves it out of the
            solution.
        otherwise: What is done then.
        aliases: Other names for it.
        text: What it is; that of the check by default.
    """

    name: str
    check: Check
    required: bool = False
    default: Callable[[dict[str, Value]], Value] | None = None
    aliases: tuple[str, ...] = ()
    text: str = ""
    otherwise: str = ""

    def describe(self) -> str:
        """Describe it, for messages."""
        names = " or ".join((self.name, *self.aliases))
        need = "required" if self.required else "optional"
        return f"{names} ({need}): {self.values}"

    @property
    def values(self) -> str:
        """What it may hold, with units and frames."""
        return self.text or (self.check.__doc__ or "").strip().rstrip(".")

    @property
    def missing(self) -> str:
        """What is meant where it is left out; empty if that isn't said."""
        return self.otherwise or ((self.default and self.default.__doc__) or "").strip().rstrip(".")


class Slotted(Protocol):
    """A type of designators, with its slots; see :class:`MotionType`."""

    @property
    def type(self) -> str:
        """Its name."""

    @property
    def slots(self) -> tuple[Slot, ...]:
        """Its slots beside ``type``."""

    @property
    def one_of(self) -> tuple[str, ...]:
        """Slots of which at least one is required."""

    @property
    def only_one(self) -> bool:
        """Whether exactly one is."""

    def describe(self) -> str:
        """Describe its slots, for messages."""


@dataclass(frozen=True, slots=True)
class MotionType:
    """A type of motion designators.

    Attributes:
        cmd: ``cmd`` of its solutions, by which process modules are chosen.
        slots: Its slots beside ``type``.
        resources: Returns what it needs of the robot, given its slots or its solution.
        one_of: Slots of which at least one is required.
        only_one: Whether exactly one is.
        fixed: Further parameters of its solutions.
    """

    type: str
    cmd: str
    slots: tuple[Slot, ...]
    resources: Callable[[dict[str, Value]], Resources]
    one_of: tuple[str, ...] = ()
    only_one: bool = False
    fixed: tuple[tuple[str, str], ...] = ()

    def for_robot(self) -> MotionType:
        """Return it with the slots that it has for the current robot."""
        return self

    def describe(self) -> str:
        """Describe its slots, for messages."""
        return described(self)


class _PosturesOfArms(MotionType):
    """A type with a slot ``NAME-arm`` for the posture of each arm that the current robot has."""

    __slots__ = ()

    def for_robot(self) -> MotionType:
        """Return it with these slots."""
        (posture,) = self.slots
        names = tuple(posture.name.replace("NAME", arm) for arm in slot_checks.arm_names())
        return replace(self, slots=tuple(replace(posture, name=name) for name in names), one_of=names)


def _heading(_: dict[str, Value]) -> Value:
    """The robot's orientation now."""
    return BulletWorld.current_robot().get_orientation()


def _default_arm(_: dict[str, Value]) -> Value:
    """The only arm, or "left"."""
    return slot_checks.default_arm()


def _only_arm(_: dict[str, Value]) -> Value:
    """The only arm; required of a robot that has several."""
    return slot_checks.only_arm()


def _holding_arm(given: dict[str, Value]) -> Value:
    """The arm that holds the object; the only one, or "left", if none does."""
    body = given.get("object")
    attachment = None if body is None or body.carrier is None else body.attachments[body.carrier]
    description = BulletWorld.current_robot().description
    if attachment is None or description is None:
        return slot_checks.default_arm()
    arm = description.arm_of(attachment.carrier_link)
    return arm.name if arm else slot_checks.default_arm()


def _opened(_: dict[str, Value]) -> Value:
    """0.3."""
    return 0.3


def _arm_resources(given: dict[str, Value]) -> Resources:
    return Resources({f"{arm}-{part}" for arm in _arms(given, "arm") for part in ("arm", "gripper")}, {"base"})


def _pick_up_resources(given: dict[str, Value]) -> Resources:
    giver = given.get("from")
    taking = _arm_resources(given)
    return Resources(
        taking.moves | {f"{giver}-{part}" for part in ("arm", "gripper")} if giver else taking.moves, {"base"}
    )


def _gripper_resources(given: dict[str, Value]) -> Resources:
    return Resources({f"{arm}-gripper" for arm in _arms(given, "gripper")})


def _joint_resources(given: dict[str, Value]) -> Resources:
    return Resources({f"{arm}-arm" for arm in slot_checks.arm_names() if f"{arm}-arm" in given})


def _base_resources(_: dict[str, Value]) -> Resources:
    return Resources({"base"}, {f"{arm}-{part}" for arm in slot_checks.arm_names() for part in ("arm", "gripper")})


def _arms(given: dict[str, Value], slot: str) -> tuple[str, ...]:
    arm = given.get(slot)
    return (arm,) if isinstance(arm, str) else slot_checks.arm_names()  # not known yet: it may be any


_ARM: Final = Slot("arm", slot_checks.arm, default=_default_arm)
_GRIPPER: Final = Slot("gripper", slot_checks.arm, default=_only_arm)

TYPES: Final = {
    motion.type: motion
    for motion in (
        MotionType(
            "moving",
            "navigate",
            (
                Slot("target", slot_checks.position, required=True),
                Slot("orientation", slot_checks.orientation, default=_heading),
            ),
            _base_resources,
        ),
        MotionType(
            "pick-up",
            "pick",
            (
                Slot("object", slot_checks.body, required=True),
                _ARM,
                Slot("grasp", slot_checks.grasp, otherwise="the side that is freest"),
                Slot("from", slot_checks.arm, text="name of the arm that holds it, and lets go of it then"),
            ),
            _pick_up_resources,
        ),
        MotionType(
            "place",
            "place",
            (
                Slot("object", slot_checks.body, required=True),
                Slot("target", slot_checks.position, required=True),
                Slot("orientation", slot_checks.orientation, otherwise="upright, turned as the arm does it best"),
                Slot("arm", slot_checks.arm, default=_holding_arm),
            ),
            _arm_resources,
        ),
        MotionType(
            "accessing",
            "access",
            (
                Slot("drawer-joint", slot_checks.name, required=True),
                Slot("drawer-handle", slot_checks.name, required=True),
                Slot("part-of", slot_checks.body, required=True),
                _ARM,
                Slot("distance", slot_checks.distance, default=_opened),
            ),
            _arm_resources,
        ),
        MotionType(
            "looking",
            "looking",
            (Slot("target", slot_checks.position), Slot("object", slot_checks.body)),
            lambda _: Resources({"head"}, {"base"}),
            one_of=("target", "object"),
            only_one=True,
        ),
        MotionType("opening-gripper", "move-gripper", (_GRIPPER,), _gripper_resources, fixed=(("motion", "open"),)),
        MotionType("closing-gripper", "move-gripper", (_GRIPPER,), _gripper_resources, fixed=(("motion", "close"),)),
        MotionType(
            "detecting",
            "detecting",
            (Slot("object-type", slot_checks.kind, required=True, aliases=("object",)),),
            lambda _: Resources(at_rest={WHOLE_ROBOT}),
        ),
        MotionType(
            "move-tcp",
            "move-tcp",
            (
                Slot("target", slot_checks.position, required=True),
                Slot("orientation", slot_checks.orientation, otherwise="any"),
                _ARM,
            ),
            _arm_resources,
        ),
        _PosturesOfArms(
            "move-arm-joints",
            "move-joints",
            (Slot("NAME-arm", slot_checks.posture, otherwise="that arm stays as it is"),),
            _joint_resources,
            one_of=("NAME-arm",),
        ),
        MotionType(
            "world-state-detecting",
            "world-state-detecting",
            (Slot("object-type", slot_checks.kind, required=True, aliases=("object",)),),
            lambda _: Resources(),
        ),
    )
}


def resources_by_type(designator: Described) -> Resources | None:
    """Return what a designator needs by its type and slots, without waiting for futures; None for other types."""
    given = {key: value for key, value in designator.description if branch_of(value) is None and value is not None}
    kind = given.get("type")
    motion = TYPES.get(kind) if isinstance(kind, str) else None
    return motion.resources(given) if motion else None


def resources_of(solution: Solution) -> Resources | None:
    """Return what a solution needs by its ``cmd``; None for one that isn't PyCRAM's own."""
    given = {key: value for key, value in solution.items() if value is not None}
    motion = next((motion for motion in TYPES.values() if motion.cmd == given.get("cmd")), None)
    return motion.resources(given) if motion else None


def resolve(designator: Described) -> Iterator[Solution]:
    """Yield the solution of a designator of the eleven types (thesis 4.6).

    For ``moving`` with an orientation, also yield one with the robot's current orientation.

    Raises:
        DesignatorError: Its type is unknown, or a slot is missing, unknown or wrong.
    """
    motion_type, given = given_slots(designator, TYPES)
    motion = motion_type.for_robot()
    for filled in _filled(motion, given):
        checked = checked_slots(motion, filled)
        solution = {"cmd": motion.cmd, **dict(motion.fixed), **checked}
        for slot in motion.slots:
            if slot.name not in solution and slot.default is not None:
                try:
                    solution[slot.name] = slot.default(checked)
                except BadArgument as error:
                    problem, takes = f"missing slot {slot.name}: {error.expected}", motion.describe()
                    raise DesignatorError(problem, type=motion.type, slot=slot.name, takes=takes) from error
        yield solution
        if motion.type == "moving" and "orientation" in given:
            yield {**solution, "orientation": _heading(checked)}


def given_slots(designator: Described, types: Mapping[str, Type], kind: str = "") -> tuple[Type, dict[str, Value]]:
    """Return a designator's type, and its other slots with values other than None, waiting for futures.

    Args:
        designator: The designator.
        types: The types that there are, by name.
        kind: Of what, for messages.

    Raises:
        DesignatorError: Its type is none of these, or a slot is given twice.
    """
    given: dict[str, Value] = {}
    for key, value in designator.description:
        if key in given:
            raise DesignatorError(f"slot {key} is given twice", type=designator.type, slot=key, value=unwrap(value))
        if value is not None:
            given[key] = unwrap(value)
    name = given.pop("type", None)
    if not isinstance(name, str) or name not in types:
        unknown = f"has the unknown type {name!r}{did_you_mean(name, types)}"
        problem = f"the {kind}designator {'has no slot type' if name is None else unknown}"
        raise DesignatorError(
            problem, type=str(name or ""), slot="type", value=name, takes=f"types: {', '.join(types)}"
        )
    return types[name], given


def _filled(motion: MotionType, given: Mapping[str, Value]) -> Iterator[dict[str, Value]]:
    """Yield slots with what the designators among their values stand for: with each solution of these in turn."""
    names = {name: slot for slot in motion.slots for name in (slot.name, *slot.aliases)}
    for key, value in given.items():
        stands_for = getattr(type(value), "values_for", None)
        if stands_for is not None and key in names and names[key].check is not slot_checks.kind:
            rest = {name: other for name, other in given.items() if name != key}
            for values in stands_for(value, key, given):
                found = {name: each for name, each in values.items() if name in names or name == key}
                yield from _filled(motion, {**found, **rest})
            return
    yield dict(given)


def described(kind: Slotted, name: str = "") -> str:
    """Return a description of a type's slots, for messages; of designators with a type of their own by their name."""
    lines = [f"{name} takes"] if name else [f"a {kind.type} designator takes", f"  type (required): {kind.type!r}"]
    lines += [f"  {slot.describe()}" for slot in kind.slots]
    if kind.one_of:
        how = "exactly one" if kind.only_one else "at least one"
        lines.append(f"  {how} of {', '.join(kind.one_of)} has to be there")
    return "\n".join(lines)


def checked_slots(motion: Slotted, given: Mapping[str, Value]) -> dict[str, Value]:
    """Return the checked values of slots, by the slots' names.

    Raises:
        DesignatorError: A slot is missing, unknown or wrong.
    """
    names = {name: slot for slot in motion.slots for name in (slot.name, *slot.aliases)}
    takes = motion.describe()
    checked: dict[str, Value] = {}
    for key, value in given.items():
        slot = names.get(key)
        if slot is None:
            problem = f"unknown slot {key}{did_you_mean(key, names)}"
            raise DesignatorError(problem, type=motion.type, slot=key, value=value, takes=takes)
        if slot.name in checked:
            problem = f"slot {slot.name} is given twice"
            raise DesignatorError(problem, type=motion.type, slot=key, value=value, takes=takes)
        try:
            checked[slot.name] = slot.check(key, value)
        except BadArgument as error:
            problem = f"wrong value in slot {error}"
            raise DesignatorError(problem, type=motion.type, slot=key, value=value, takes=takes) from error
    missing = [slot.name for slot in motion.slots if slot.required and slot.name not in checked]
    if missing:
        raise DesignatorError(f"missing slot {', '.join(missing)}", type=motion.type, slot=missing[0], takes=takes)
    present = [name for name in motion.one_of if name in checked]
    if motion.one_of and (not present or (motion.only_one and len(present) > 1)):
        problem = (
            f"slots {' and '.join(present)} exclude each other"
            if present
            else f"missing slot {' or '.join(motion.one_of)}"
        )
        raise DesignatorError(problem, type=motion.type, slot=motion.one_of[0], takes=takes)
    return checked
