"""The demo is counted from outside, by wrapping public methods: the recording holds just these calls."""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import redirect_stdout
from functools import wraps
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mcap.reader
import pytest

import recorder
from pycram import bullet_world_reasoning as btr
from pycram.bullet_world import BulletWorld, Object
from pycram.process_module import ProcessModule
from pycram.world import attachment, simulation
from recorder.records import log_pb2

if TYPE_CHECKING:
    from collections.abc import Callable

sys.path.insert(0, str(Path(__file__).parent.parent / "demos"))

import set_the_table

QUERIES = ("stable", "contact", "visible", "occluding", "reachable", "reachable_object", "reachable_pose", "blocking")
CHANGES = {  # public methods and functions, and the command that each call records
    (Object, "__init__"): "load_body",
    (Object, "set_position_and_orientation"): "move_body",
    (Object, "set_joint_positions"): "move_joints",
    (attachment, "attach"): "attach_body",
    (attachment, "detach"): "detach_body",
    (BulletWorld, "set_gravity"): "set_gravity",
    (BulletWorld, "set_robot"): "set_robot",
    (BulletWorld, "simulate_steps"): "simulate",
    (simulation, "settle"): "simulate",  # as placing does
    (BulletWorld, "exit"): "close_world",
}


class Observer:
    """Wraps public methods and counts their calls."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.seen: Counter[tuple[str, str]] = Counter()
        self._patch = patch

    def watch(self, owner: Any, name: str, key: Callable[..., tuple[str, str]], *, static: bool = False) -> None:
        method = getattr(owner, name)

        @wraps(method)
        def counted(*args: Any, **kwargs: Any) -> Any:
            self.seen[key(*args, **kwargs)] += 1
            return method(*args, **kwargs)

        self._patch.setattr(owner, name, staticmethod(counted) if static else counted)


@pytest.fixture
def observer(monkeypatch: pytest.MonkeyPatch) -> Observer:
    observer = Observer(monkeypatch)
    for (owner, name), command in CHANGES.items():
        observer.watch(owner, name, lambda *_, _key=command, **__: ("mutation", _key))
    for name in QUERIES:
        observer.watch(btr, name, lambda *_, _key=name, **__: ("query", _key))
    observer.watch(ProcessModule, "perform", lambda motion: ("motion", motion.prop_value("type")), static=True)
    return observer


def read(file: Path) -> Counter[tuple[str, str]]:
    """Counts records with mcap and protobuf alone."""
    found: Counter[tuple[str, str]] = Counter()
    types = {name: getattr(log_pb2, name) for name in ("Task", "Mutation", "Query", "Event")}
    with file.open("rb") as stream:
        for schema, _, message in mcap.reader.make_reader(stream, validate_crcs=True).iter_messages():
            kind = schema.name.rpartition(".")[2] if schema else ""
            if kind not in types:
                continue
            record = types[kind].FromString(message.data)
            if kind == "Task" and record.phase == log_pb2.Task.FINISHED:
                assert record.status == log_pb2.Task.SUCCEEDED
                found[record.kind, record.name] += 1
            elif kind == "Mutation":
                found["mutation", record.WhichOneof("command")] += 1
            elif kind == "Query":
                found["query", record.name] += 1
            elif kind == "Event":
                found["event", record.name] += 1
    return found


@pytest.mark.slow
def test_the_recording_holds_the_calls_that_an_observer_counts(tmp_path: Path, observer: Observer) -> None:
    file = tmp_path / "x.mcap"
    fired: Counter[tuple[str, str]] = Counter()
    with recorder.record(file), redirect_stdout(StringIO()):
        kitchen = set_the_table.build_scene()
        world = BulletWorld.current_bullet_world
        for event_of in (world.get_attachment_event, world.get_detachment_event, world.get_manipulation_event):
            event = event_of()
            event += lambda *_, _name=event.name: fired.update([("event", _name)])
        for kind in ("milk", "cereal", "spoon"):
            set_the_table.move_object(kind, kitchen)
        world.exit()
    found = read(file)
    seen = observer.seen
    assert {key: count for key, count in found.items() if key[0] == "motion"} == {
        key: count for key, count in seen.items() if key[0] == "motion"
    }
    assert {key: count for key, count in found.items() if key[0] == "event"} == fired
    assert sum(fired.values()) > 8
    for (_, name), command in CHANGES.items():
        assert found["mutation", command] == seen["mutation", command] > 0, name
    # plans call the module's functions; queries of motions themselves are recorded beside these
    for name in ("stable", "blocking", "reachable_pose"):
        assert found["query", name] == seen["query", name] > 0
    assert found["process-module", "PickUp"] == found["motion", "pick-up"] == 4
