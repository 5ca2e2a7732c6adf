"""Laws of folding: any step from its keyframe is what all records from the start give, and what really happened."""

from __future__ import annotations

import itertools
import math
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings, strategies as st

import replay
from recorder.mcap_sink import McapSink
from recorder.records import (
    AttachBody,
    Attachment,
    BodyState,
    CloseWorld,
    DetachBody,
    Effect,
    Event,
    Keyframe,
    LoadBody,
    MoveBody,
    MoveJoints,
    Mutation,
    OpenWorld,
    RemoveBody,
    SetGravity,
    Simulate,
)
from recorder.tracing.journal import Journal

if TYPE_CHECKING:
    from recorder.records import Record

JOINTS = ("lift", "turn")
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
AT_REST = (0.0,) * 6
finite = st.floats(-1e6, 1e6, allow_nan=False)
vectors = st.tuples(finite, finite, finite)
bodies = st.sampled_from(["cup", "box", "arm"])
worlds = st.sampled_from(["a", "b"])
actions = st.one_of(
    st.tuples(st.just("load"), worlds, bodies, vectors),
    st.tuples(st.just("remove"), worlds, bodies),
    st.tuples(st.just("move"), worlds, bodies, vectors),
    st.tuples(st.just("joint"), worlds, bodies, st.sampled_from(JOINTS), finite),
    st.tuples(st.just("attach"), worlds, bodies, bodies),
    st.tuples(st.just("detach"), worlds, bodies),
    st.tuples(st.just("gravity"), worlds, vectors),
    st.tuples(st.just("simulate"), worlds, st.lists(st.tuples(bodies, vectors), max_size=3), st.integers(1, 50)),
    st.tuples(st.just("keyframe"), worlds),
    st.tuples(st.just("close"), worlds),
    st.tuples(st.just("event"), worlds),
)

#: Most actions need an open world with bodies; the first action of all opens it.
BEGINNING = [("load", world, body, (0.0, 0.0, 0.0)) for world in ("a", "b") for body in ("cup", "cup", "box", "arm")]


@dataclass
class Model:
    """A world as plain as can be, kept by the test."""

    name: str
    lifetime: int = 0
    sim_step: int = 0
    gravity: tuple[float, ...] = (0.0, 0.0, 0.0)
    positions: dict[str, tuple[float, ...]] = field(default_factory=dict)
    speeds: dict[str, tuple[float, ...]] = field(default_factory=dict)
    joints: dict[str, dict[str, float]] = field(default_factory=dict)
    held: dict[str, str] = field(default_factory=dict)  # carrier by body
    open: bool = False

    def facts(self) -> dict[str, object]:
        return {
            "open": self.open,
            "life": self.lifetime,
            "sim_step": self.sim_step,
            "gravity": self.gravity,
            "positions": dict(self.positions),
            "speeds": dict(self.speeds),
            "joints": {body: dict(values) for body, values in self.joints.items()},
            "held": dict(self.held),
        }

    def keyframe(self) -> Keyframe:
        return Keyframe(
            mode="DIRECT",
            gravity=self.gravity,
            loaded=[LoadBody(body=body, joints=JOINTS) for body in self.positions],
            bodies=[
                BodyState(
                    body=body,
                    position=position,
                    orientation=UPRIGHT,
                    velocity=self.speeds[body],
                    joints=JOINTS,
                    joint_positions=[self.joints[body][joint] for joint in JOINTS],
                )
                for body, position in self.positions.items()
            ],
            attachments=[attachment(carrier, body) for body, carrier in self.held.items()],
        )


def attachment(carrier: str, body: str) -> Attachment:
    return Attachment(carrier=carrier, body=body, position=(0, 0, 0), orientation=UPRIGHT)


def perform(model: Model, action: tuple[object, ...]) -> Record | None:
    """Does it to the model; None if it can't be done."""
    kind, _, *given_ = action
    if kind == "event":
        return Event(name="tick")
    if not model.open:
        model.open, model.sim_step, model.gravity = True, 0, (0.0, 0.0, 0.0)
        model.lifetime += 1
        return Mutation(open_world=OpenWorld(mode="DIRECT"))
    return ACTIONS[str(kind)](model, *given_)


def load(model: Model, body: str, position: tuple[float, ...]) -> Record | None:
    if body in model.positions:
        return None
    model.positions[body], model.speeds[body], model.joints[body] = position, AT_REST, dict.fromkeys(JOINTS, 0.0)
    return Mutation(
        load_body=LoadBody(body=body, joints=JOINTS, position=position, orientation=UPRIGHT), effect=Effect()
    )


def remove(model: Model, body: str) -> Record | None:
    if body not in model.positions:
        return None
    del model.positions[body], model.speeds[body], model.joints[body]
    model.held = {held: carrier for held, carrier in model.held.items() if body not in (held, carrier)}
    return Mutation(remove_body=RemoveBody(body=body), effect=Effect(removed=[body]))


def move(model: Model, body: str, position: tuple[float, ...]) -> Record | None:
    if body not in model.positions:
        return None
    model.positions[body], model.speeds[body] = position, AT_REST
    states = [BodyState(body=body, position=position, orientation=UPRIGHT)]
    for held in [held for held, carrier in model.held.items() if carrier == body]:
        model.positions[held], model.speeds[held] = position, AT_REST
        states.append(BodyState(body=held, position=position, orientation=UPRIGHT))
    return Mutation(move_body=MoveBody(body=body, position=position), effect=Effect(bodies=states))


def joint(model: Model, body: str, name: str, value: float) -> Record | None:
    if body not in model.joints:
        return None
    model.joints[body][name] = value
    state = BodyState(body=body, joints=[name], joint_positions=[value])
    return Mutation(move_joints=MoveJoints(body=body, joints=[name], positions=[value]), effect=Effect(bodies=[state]))


def attach(model: Model, carrier: str, body: str) -> Record | None:
    if body == carrier or not {carrier, body} <= set(model.positions) or body in model.held or carrier in model.held:
        return None
    model.held[body] = carrier
    return Mutation(
        attach_body=AttachBody(carrier=carrier, body=body), effect=Effect(attached=[attachment(carrier, body)])
    )


def detach(model: Model, body: str) -> Record | None:
    if body not in model.held:
        return None
    carrier = model.held.pop(body)
    return Mutation(
        detach_body=DetachBody(carrier=carrier, body=body), effect=Effect(detached=[attachment(carrier, body)])
    )


def gravity(model: Model, value: tuple[float, ...]) -> Record:
    model.gravity = value
    return Mutation(set_gravity=SetGravity(gravity=value))


def simulate(model: Model, moved: list[tuple[str, tuple[float, ...]]], steps: int) -> Record:
    model.sim_step += steps
    states = [
        BodyState(body=body, position=place, orientation=UPRIGHT, velocity=(*place, 0, 0, 0))
        for body, place in dict(moved).items()
        if body in model.positions
    ]
    for state in states:
        model.positions[state.body], model.speeds[state.body] = tuple(state.position), tuple(state.velocity)
    return Mutation(simulate=Simulate(steps=steps), effect=Effect(bodies=states))


def close(model: Model) -> Record:
    model.open = False
    model.positions.clear()
    model.speeds.clear()
    model.joints.clear()
    model.held.clear()
    return Mutation(close_world=CloseWorld())


ACTIONS = {
    "load": load,
    "remove": remove,
    "move": move,
    "joint": joint,
    "attach": attach,
    "detach": detach,
    "gravity": gravity,
    "simulate": simulate,
    "keyframe": Model.keyframe,
    "close": close,
}


def state_facts(state: replay.State) -> dict[str, dict[str, object]]:
    return {
        world.name: {
            "open": world.open,
            "life": world.lifetime,
            "sim_step": world.sim_step,
            "gravity": world.gravity,
            "positions": {body.name: body.position for body in world.bodies.values()},
            "speeds": {body.name: body.velocity for body in world.bodies.values()},
            "joints": {body.name: dict(body.joints) for body in world.bodies.values()},
            "held": {held.body: held.carrier for held in world.attachments.values()},
        }
        for world in state.worlds.values()
    }


@settings(max_examples=25, deadline=None)
@given(st.lists(actions, min_size=40, max_size=80), st.randoms(use_true_random=False))
@pytest.mark.slow
def test_folding_from_any_keyframe_gives_the_state_that_was(steps: list, rng) -> None:
    models = {name: Model(name) for name in ("a", "b")}
    expected: list[dict[str, object]] = []
    known: dict[str, object] = {}
    clock = itertools.count()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "x.mcap"
        journal = Journal([McapSink(file, {"plan": "laws"})], clock_ns=lambda: next(clock))
        for action in (*BEGINNING, *steps):
            model = models[str(action[1])]
            record = perform(model, action)
            if record is None:
                continue
            record.world, record.sim_step = ("", 0) if isinstance(record, Event) else (model.name, model.sim_step)
            journal.append(record)
            if not isinstance(record, Event):
                known[model.name] = model.facts()
            expected.append(dict(known))
        journal.append(Event(name="end"))
        expected.append(dict(known))
        journal.close()
        with replay.open(file) as log:
            records = list(log)
            order = list(range(len(expected)))
            rng.shuffle(order)
            for step in order:
                by_keyframe = log.state_at(step)
                assert state_facts(by_keyframe) == expected[step]
                without = [record for record in records[: step + 1] if not isinstance(record, Keyframe)]
                assert state_facts(replay.fold(without, step)) == expected[step]
            assert [record.seq for record in log.backwards()] == [record.seq for record in reversed(records)]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-1e9, 1e9), min_size=3, max_size=3))
def test_folded_numbers_keep_every_bit(position: list[float]) -> None:
    load_it = Mutation(load_body=LoadBody(body="cup"))
    move_it = Mutation(effect=Effect(bodies=[BodyState(body="cup", position=position)]))
    state = replay.fold([load_it, move_it])
    for read, written in zip(state.world("").body("cup").position, position, strict=True):
        assert read == written
        assert math.copysign(1, read) == math.copysign(1, written)
