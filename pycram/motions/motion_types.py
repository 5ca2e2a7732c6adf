"""The eleven types of motion designators of the thesis (4.5, tables 4.4-4.14) as data: their slots and resources.

One resolver handles all types. The resolver checks the slots, infers missing parameters, and yields solutions:
dictionaries with ``cmd`` and all parameters of the process module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from pycram.foundation import plugins
from pycram.foundation.failures import BadArgument
from pycram.motions import slots
from pycram.motions.resources import WHOLE_ROBOT, Resources
from pycram.motions.slots import Slot, SlotTable, SolutionSlots, Value, arm_names, given_slots
from pycram.scheduling.future import branch_of, unwrap
from pycram.world.world import BulletWorld

if TYPE_CHECKING:
    from pycram.motions.designator import ResolvedDesignator, Solution


@dataclass(frozen=True, kw_only=True)
class MotionType(SlotTable):
    """A type of motion designators."""

    takes_designators = True
    cmd: str  # ``cmd`` of the solutions, which selects the process module
    resources: Callable[[dict[str, Value]], Resources]  # returns a motion's needs from its slots or solution
    fixed: tuple[tuple[str, str], ...] = ()  # further parameters of the solutions
    per_arm: bool = False  # whether the slot ``NAME-arm`` represents one slot for each arm

    def for_robot(self) -> MotionType:
        """Return the type with its slots for the current robot."""
        if not self.per_arm:
            return self
        (slot,) = self.slots
        names = tuple(slot.name.replace("NAME", arm) for arm in arm_names())
        return replace(self, slots=tuple(replace(slot, name=name) for name in names), one_of=names)


def _heading(_: dict[str, Value]) -> Value:
    return BulletWorld.current_robot().get_orientation()


def _holding_arm(given: dict[str, Value]) -> Value:
    body = given.get("object")
    attachment = None if body is None or body.carrier is None else body.attachments[body.carrier]
    description = BulletWorld.current_robot().description
    arm = description.arm_of(attachment.carrier_link) if attachment is not None and description is not None else None
    return arm.name if arm else slots.default_arm()


def _arms(given: dict[str, Value], slot: str) -> tuple[str, ...]:
    arm = given.get(slot)
    return (arm,) if isinstance(arm, str) else arm_names()  # a future may turn out to be any arm


def _arm_resources(given: dict[str, Value]) -> Resources:
    arms = _arms(given, "arm")
    if giver := given.get("from"):
        arms = (*arms, giver)
    return Resources({f"{arm}-{part}" for arm in arms for part in ("arm", "gripper")}, {"base"})


_ARM: Final = Slot("arm", slots.ARM, default=lambda _: slots.default_arm(), otherwise='The only arm, or "left"')
_GRIPPER: Final = Slot(
    "gripper",
    slots.ARM,
    default=lambda _: slots.only_arm(),
    otherwise="The only arm; required if the robot has several arms",
)
_OBJECT_TYPE: Final = Slot("object-type", slots.OBJECT_TYPE, required=True, aliases=("object",))

TYPES: Final = {
    motion.type: motion
    for motion in (
        MotionType(
            "moving",
            (
                Slot("target", slots.POSITION, required=True),
                Slot("orientation", slots.ORIENTATION, default=_heading, otherwise="The robot's present orientation"),
            ),
            cmd="navigate",
            resources=lambda _: Resources(
                {"base"}, {f"{arm}-{part}" for arm in arm_names() for part in ("arm", "gripper")}
            ),
        ),
        MotionType(
            "pick-up",
            (
                Slot("object", slots.BODY, required=True),
                _ARM,
                Slot("grasp", slots.GRASP, otherwise="the freest side"),
                Slot("from", slots.ARM, text="name of the arm that holds the object, and releases it to the other arm"),
            ),
            cmd="pick",
            resources=_arm_resources,
        ),
        MotionType(
            "place",
            (
                Slot("object", slots.BODY, required=True),
                Slot("target", slots.POSITION, required=True),
                Slot("orientation", slots.ORIENTATION, otherwise="upright, in the best orientation for the arm"),
                Slot(
                    "arm",
                    slots.ARM,
                    default=_holding_arm,
                    otherwise='The arm that holds the object; if no arm does, the only arm, or "left"',
                ),
            ),
            cmd="place",
            resources=_arm_resources,
        ),
        MotionType(
            "accessing",
            (
                Slot("drawer-joint", slots.NAME, required=True),
                Slot("drawer-handle", slots.NAME, required=True),
                Slot("part-of", slots.BODY, required=True),
                _ARM,
                Slot("distance", slots.DISTANCE, default=lambda _: 0.3, otherwise="0.3"),
            ),
            cmd="access",
            resources=_arm_resources,
        ),
        MotionType(
            "looking",
            (Slot("target", slots.POINT), Slot("object", slots.BODY)),
            one_of=("target", "object"),
            only_one=True,
            cmd="looking",
            resources=lambda _: Resources({"head"}, {"base"}),
        ),
        *(
            MotionType(
                kind,
                (_GRIPPER,),
                cmd="move-gripper",
                resources=lambda given: Resources({f"{arm}-gripper" for arm in _arms(given, "gripper")}),
                fixed=(("motion", goal),),
            )
            for kind, goal in (("opening-gripper", "open"), ("closing-gripper", "close"))
        ),
        MotionType("detecting", (_OBJECT_TYPE,), cmd="detecting", resources=lambda _: Resources(at_rest={WHOLE_ROBOT})),
        MotionType(
            "move-tcp",
            (
                Slot("target", slots.POINT, required=True),
                Slot("orientation", slots.ORIENTATION, otherwise="any"),
                _ARM,
                Slot(
                    "level",
                    slots.SWITCH,
                    text="Whether the held object stays level, within 15 degrees",
                    otherwise="False",
                ),
            ),
            cmd="move-tcp",
            resources=_arm_resources,
        ),
        MotionType(
            "move-arm-joints",
            (Slot("NAME-arm", slots.POSTURE, otherwise="that arm doesn't move"),),
            one_of=("NAME-arm",),
            cmd="move-joints",
            resources=lambda given: Resources({f"{arm}-arm" for arm in arm_names() if f"{arm}-arm" in given}),
            per_arm=True,
        ),
        MotionType(
            "world-state-detecting", (_OBJECT_TYPE,), cmd="world-state-detecting", resources=lambda _: Resources()
        ),
    )
}


def resources_by_type(designator: ResolvedDesignator) -> Resources | None:
    """Return the parts that a designator of the eleven types needs, without waiting for futures; else None."""
    given = SolutionSlots(
        (key, value) for key, value in designator.description if branch_of(value) is None and value is not None
    )
    kind = given.get("type")
    motion = TYPES.get(kind) if isinstance(kind, str) else None
    return motion.resources(given) if motion else None


def resources_of(solution: Solution) -> Resources | None:
    """Return the parts that a solution needs, by its ``cmd``; None if no PyCRAM motion has that ``cmd``."""
    given = SolutionSlots((key, value) for key, value in solution.items() if value is not None)
    motion = next((motion for motion in TYPES.values() if motion.cmd == given.get("cmd")), None)
    return motion.resources(given) if motion else None


def resolve(designator: ResolvedDesignator) -> Iterator[Solution]:
    """Yield the solution of a designator of the eleven types (thesis 4.6), or of a process module of another package.

    For ``moving`` with an orientation, a second solution keeps the robot's present orientation. A solution for a
    process module of another package has all slots, as the plan wrote them.
    """
    kind = designator.type
    if kind and kind not in TYPES and plugins.load(plugins.PROCESS_MODULES, kind) is not None:
        yield {"cmd": kind, **{slot: unwrap(value) for slot, value in designator.description if slot != "type"}}
        return
    motion_type, given = given_slots(designator, TYPES)
    motion = motion_type.for_robot()
    for filled in _filled(motion, given):
        checked = motion.checked(filled)
        solution = {"cmd": motion.cmd, **dict(motion.fixed), **checked}
        for slot in motion.slots:
            if slot.name not in solution and slot.default is not None:
                try:
                    solution[slot.name] = slot.default(checked)
                except BadArgument as error:
                    raise motion.error(f"missing slot {slot.name}: {error.expected}", slot.name) from error
        yield solution
        if motion.type == "moving" and "orientation" in given:
            yield {**solution, "orientation": _heading(checked)}


def _filled(motion: MotionType, given: Mapping[str, Value]) -> Iterator[dict[str, Value]]:
    """Yield the slots, combined with each solution of the designators that are values of slots."""
    names = {slots.slot_name(name): slot for slot in motion.slots for name in (slot.name, *slot.aliases)}
    for key, value in given.items():
        values_for = getattr(type(value), "values_for", None)
        if values_for is not None and key in names and names[key].check is not slots.OBJECT_TYPE:
            rest = {name: other for name, other in given.items() if name != key}
            for values in values_for(value, key, given):
                found = {name: each for name, each in values.items() if name in names or name == key}
                yield from _filled(motion, {**found, **rest})
            return
    yield dict(given)
