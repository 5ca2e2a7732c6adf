"""Every field of every record is compared by ``verify``, or listed here with the reason why nothing determines it.

The fields are those of the definition: a new one is in neither, and this test fails until it is compared or listed.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest
from google.protobuf.descriptor import FieldDescriptor

import recorder
from pycram import bullet_world_reasoning as btr, monitored
from pycram.bullet_world import BulletWorld, Object
from pycram.event import Event
from pycram.failures import PlanFailure
from pycram.fluent import Fluent
from pycram.knowledge import learn
from pycram.world import transaction
from recorder.records import TOPICS, Mutation, PathSearch
from recorder.tracing.span import span
from replay.recording import Recording
from replay.restore.verify import verify
from tests.smooth_motions import smooth, to

if TYPE_CHECKING:
    from collections.abc import Iterator

    from google.protobuf.descriptor import Descriptor
    from google.protobuf.message import Message

    from recorder.records import Record
    from replay.state.integrity import Verification

CABINET = Path(__file__).parents[1] / "golden" / "cabinet.urdf"

_CLOCK = "a clock's: only the order is checked"
_PLAN = "the plan's own code decides it, which isn't executed again"
_WHERE = "a line of the plan, or a thread"
_SAID = "the world that was current, and its time: threads may change it meanwhile"
_ASKED = "queries aren't asked again by verify; `ask` does that"
_DAEMON = "what the recorder was given"

#: Regular expressions of fields that nothing determines, and why.
NOT_DETERMINED: Final = {
    r"\w+\.(wall_time_ns|monotonic_ns)": _CLOCK,
    r"\w+\.duration_ns|Task\.began_ns|(Task|Run)\.checkpoint|\w+\.strikes\..*|Run\.looks": _CLOCK,
    r"\w+\.thread": _WHERE,
    r"\w+\.(source_file|source_line|callers\..*)": _WHERE,
    r"(?!Mutation|Keyframe)\w+\.(world|sim_step)": _SAID,
    r"\w+\.failure\..*": _PLAN,
    r"Keyframe\.world": "a world that was opened unrecorded is announced by its keyframe",
    r"Mutation\.simulate\.settled": "a judgement by the rules of the release, with which nothing changes",
    r"Mutation\.begin_trajectory\.search\..*": "how a path was found, with which nothing changes",
    r"Mutation\.by_fork": "whoever forked the run",
    r"Mutation\.drags\..*": "a person's hand",
    r"Mutation\.restore\.sim_step": "when the state was saved, which the world's clock doesn't go back to",
    r"Mutation\.restore\.bodies\.orientation": "the engine normalises it, so others may come to the same",
    r"Task\.(parameters|solution|decision)\..*|Task\.result_json": _PLAN,
    r"(Event|Subscription|Refusal|Output)\.(?!seq|task|cause).*": _PLAN,
    r"Fluent\.(?!seq|task|cause).*": _PLAN,
    r"Check\.(?!seq|task|cause).*": _PLAN,
    r"Query\.(?!seq|task|cause).*": _ASKED,
    r"Run\.(arguments|directory|seed|order|environment|hash_seed|plan\..*|pycram\..*|host|cpu|program|parameters\..*|sweep\..*|by_program|called_as|number|origin\..*|interrupted_by)": _DAEMON,
}


def fields(descriptor: Descriptor, within: str = "") -> Iterator[str]:
    """The fields of a message that hold values, with those of its parts."""
    for field in descriptor.fields:
        path = f"{within or descriptor.name}.{field.name}"
        if field.message_type is None:
            yield path
        else:
            yield from fields(field.message_type, path)


FIELDS: Final = [path for kind in TOPICS for path in fields(kind.DESCRIPTOR)]
COMPARED: Final = [path for path in FIELDS if not any(re.fullmatch(each, path) for each in NOT_DETERMINED)]


def is_repeated(field: FieldDescriptor) -> bool:
    return field.is_repeated if hasattr(field, "is_repeated") else field.label == FieldDescriptor.LABEL_REPEATED


def alter(message: Message, path: list[str], *, add: bool = False) -> bool:
    """Gives a field another value, where the message has what it is a part of; tells whether it did.

    With ``add``, a list without a value gets one.
    """
    field = message.DESCRIPTOR.fields_by_name[path[0]]
    value = getattr(message, field.name)
    if len(path) > 1:
        if is_repeated(field):
            return any(alter(part, path[1:], add=add) for part in value)
        return message.HasField(field.name) and alter(value, path[1:], add=add)
    if is_repeated(field):
        if not value and not add:
            return False
        value[-1:] = [other(field, value[-1] if value else NOTHING[field.cpp_type])]
    elif message.DESCRIPTOR.name == "Keyframe" and field.name == "robot" and not value:
        message.robot = "cup"
    else:
        setattr(message, field.name, other(field, value))
    return True


NOTHING: Final = {FieldDescriptor.CPPTYPE_STRING: "", FieldDescriptor.CPPTYPE_DOUBLE: 0.0}


def other(field: FieldDescriptor, value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, float):
        return value + 1e-9
    if field.enum_type is not None:
        return next(each.number for each in field.enum_type.values if each.number not in (0, value))
    return f"{value}x" if isinstance(value, str) else value + 1000


class Altered(Recording):
    """A recording in which one record is another."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.instead: dict[int, Record] = {}

    def records(self, *args: Any, **kwargs: Any) -> Iterator[Any]:
        for record in super().records(*args, **kwargs):
            yield self.instead.get(record.seq, record)


def hear(*_: object) -> None:
    with monitored("apple.z > 9", only_record=True):
        BulletWorld.current_bullet_world.get_object("apple").set_color([0, 1, 0, 1])


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Altered]:
    """A plan that leaves every kind of record, and of each world keyframes after whatever happens in it."""
    file = tmp_path_factory.mktemp("fields") / "run.mcap"
    frequent = pytest.MonkeyPatch()
    frequent.setattr(transaction, "TRANSACTIONS_PER_KEYFRAME", 3)
    with (
        recorder.record(file, output=True),
        BulletWorld(name="kitchen") as world,
        span("plan", "tidy", {"room": "kitchen"}),
    ):
        world.set_gravity([0, 0, -9.8])
        Object("floor", "environment", "plane.urdf")
        cabinet = Object("cabinet", "environment", str(CABINET), [1.3, 0.7, 0.6])
        cup = Object("cup", "cup", "cup.stl", [1.3, 0.6, 1.0], color=[1, 0, 0, 1], scale=1.1)
        with pytest.warns(match=" mm inside of "):
            apple = Object("apple", "apple", "apple.stl", [1.3, 0.6, 1.0])
        event, hunger = Event("dinner", "cook"), Fluent(1, "hunger")
        event += hear
        event()
        hunger.set_value(2)
        cup.set_position_and_orientation([1.3, 0.6, 1.2], [0, 0, 0.6, 0.8])
        cabinet.set_joint_position("drawer_joint", 0.3)
        world.simulate(0.1)
        cabinet.attach(cup, "drawer", cup.links[0])
        cabinet.set_joint_position("drawer_joint", 0.1)
        world.simulate(0.05)
        btr.contact(cup, apple)
        world.set_realtime(True)
        for opening in (0.2, 0.3, 0.2):
            cabinet.set_joint_position("drawer_joint", opening)
        world.set_realtime(False)
        print("tidy")
        with contextlib.suppress(PlanFailure), span("motion", "fails"):
            raise PlanFailure
        with contextlib.suppress(Exception):
            cup.set_position([0, 0])
        cabinet.detach(cup)
        world.set_robot(Object("arm", "robot", str(CABINET), [4, 0, 0]))
        cup.set_position([1.2, 0.6, 1.2])
        apple.set_color([0, 0, 1, 1])
        chest = Object("chest", "chest", str(CABINET), [0, 3, 0.7], [0.3, 0.2, 0, 0.9])
        world.simulate(0.3)  # it falls, and its drawer moves
        apple.remove()
        cabinet.attach(cup, "drawer", cup.links[0])
        learn({chest: chest.get_position_and_orientation()})
        saved = world.save()
        world.reset()
        world.restore(saved)
        world.simulate(0.1)
        opening = to(cabinet, {"drawer_joint": 0.05}, 1.0)
        search = PathSearch(planner="given", seed=3, attempts=1, checks=5, max_checks=9, way_points=[0, 0.1])
        number = world.begin_trajectory(cabinet, opening, search)
        world.simulate(0.2)
        world.stop_trajectory(number)
        world.simulate(0.1)
        world.begin_trajectory(Object("cart", "robot", str(CABINET), [8, 0, 0]), smooth((), [8, 0, 0], [9, 0, 0], 2))
        for _ in range(3):  # keyframes in the middle
            world.simulate(0.02)
        cabinet.detach(cup)
        cup.set_position([1, 1, 1])
    frequent.undo()
    with Altered(file) as opened:
        assert verify(opened).exact
        yield opened


def verified(log: Altered, step: int, instead: Record) -> Verification:
    log.instead = {step: instead}
    try:
        return verify(log)
    finally:
        log.instead = {}


def verdict(log: Altered, path: str) -> tuple[Record, Verification] | None:
    """What verify says when a field of one record has another value; None if no record has what it is a part of."""
    kind, *names = path.split(".")
    own = [record for record in log.records() if type(record).__name__ == kind]
    for record, add in [(record, add) for add in (False, True) for record in own]:
        altered = type(record).FromString(record.SerializeToString())
        if alter(altered, names, add=add):
            return record, verified(log, record.seq, altered)
    return None


@pytest.mark.costly
@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted({path.partition(".")[0] for path in COMPARED}))
def test_a_field_that_is_changed_is_found(log: Altered, kind: str) -> None:
    missed, absent = [], []
    for path in COMPARED:
        if path.startswith(f"{kind}."):
            found = verdict(log, path)
            if found is None:
                absent.append(path)
            elif found[1].sound:
                missed.append(f"{path} of step {found[0].seq}")
    assert not missed
    assert not absent, "the plan of this test leaves no record with these"


def test_what_nothing_determines_is_in_the_definition() -> None:
    for pattern in NOT_DETERMINED:
        assert any(re.fullmatch(pattern, path) for path in FIELDS), pattern
    assert len(COMPARED) > len([path for path in FIELDS if path.startswith(("Mutation.", "Keyframe."))]) * 0.8


def test_where_a_reset_would_put_a_cup_is_compared(log: Altered) -> None:
    """A keyframe says where each body was loaded, which a reset goes back to; once a cup landed 4 m away."""
    for record in log.records():
        for loaded in getattr(record, "loaded", ()):
            if loaded.body == "cup":
                altered = type(record).FromString(record.SerializeToString())
                next(each for each in altered.loaded if each.body == "cup").position[0] += 4
                found = verified(log, record.seq, altered)
                assert found.problem is not None
                assert found.problem.step == record.seq
                assert "loaded[cup].position[0]" in str(found.problem.deviation)
                return
    pytest.fail("no keyframe has the cup")


def test_the_commands_of_the_definition_are_all_tried(log: Altered) -> None:
    commands = {record.WhichOneof("command") for record in log.records(Mutation)}
    assert commands == {field.name for field in Mutation.DESCRIPTOR.oneofs_by_name["command"].fields}
