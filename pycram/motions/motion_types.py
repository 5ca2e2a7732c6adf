"""The eleven motion designators of the thesis (4.5, tables 4.4-4.14), as data: their slots and resources.

One resolver serves them all. It checks the slots and yields solutions: dictionaries with ``cmd`` and every parameter of
the process module, inferred if the plan left it out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from pycram.foundation.failures import BadArgument
from pycram.motions import slot_checks
from pycram.motions.resources import WHOLE_ROBOT, Resources
from pycram.motions.slots import DesignatorError, Slot, Value, checked_slots, described, given_slots
from pycram.scheduling.future import branch_of
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pycram.motions.designator import Solution
    from pycram.motions.slots import Described


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
