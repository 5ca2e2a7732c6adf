"""Records and states as JSON data."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

from google.protobuf.message import Message

from recorder.records import TOPICS, UNKNOWN, Argument, Keyframe, Mutation, Plain, Record, argument_values, from_json
from replay.state.state import Body, State, World

if TYPE_CHECKING:
    from google.protobuf.descriptor import FieldDescriptor

_ENVELOPE = ("wall_time_ns", "monotonic_ns", "sim_step", "world", "task", "thread")


def kind_of(record: Record) -> str:
    """Return the kind of a record, which is the name of its topic, such as "task" or "mutation"."""
    return TOPICS.get(type(record), UNKNOWN).removeprefix("/")


def record_data(record: Record) -> dict[str, Plain]:
    """Return a whole record as data; fields that aren't set are left out."""
    envelope: dict[str, Plain] = {"step": record.seq, "kind": kind_of(record)}
    envelope |= {name: getattr(record, name) for name in _ENVELOPE}
    return envelope | {key: value for key, value in _fields(record) if key != "seq" and key not in _ENVELOPE}


def message_data(message: Message) -> dict[str, Plain]:
    """Return a part of a record as data; fields that aren't set are left out."""
    return dict(_fields(message))


def _fields(message: Message) -> Iterator[tuple[str, Plain]]:
    for field, value in message.ListFields():
        if field.name.endswith("_json"):
            yield field.name.removesuffix("_json"), from_json(value)
        elif field.enum_type is not None:
            enum_value = field.enum_type.values_by_number.get(value)
            yield field.name, enum_value.name.lower() if enum_value else value
        else:
            yield field.name, _value(field, value)


def _value(field: FieldDescriptor, value: object) -> Plain:
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    is_repeated = hasattr(value, "append")
    if field.message_type is None:
        return list(value) if is_repeated else value  # type: ignore[call-overload, return-value]
    if field.message_type.full_name == Argument.DESCRIPTOR.full_name:
        return argument_values(value)  # type: ignore[arg-type]
    if is_repeated:
        return [dict(_fields(item)) for item in value]  # type: ignore[attr-defined]
    return dict(_fields(value))  # type: ignore[arg-type]


def mentions(record: Record, name: str) -> bool:
    """Return whether a record changes a body, or names it in an argument or answer; keyframes don't count."""
    if isinstance(record, Keyframe):
        return False
    if isinstance(record, Mutation):
        command = record.WhichOneof("command")
        effect = record.effect
        names = {getattr(getattr(record, command), field, "") for field in ("body", "carrier")} if command else set()
        names.update(state.body for state in effect.bodies)
        names.update(effect.removed)
        names.update(body for held in (*effect.attached, *effect.detached) for body in (held.carrier, held.body))
        return name in names
    return _has(record_data(record), name)


def _has(value: Plain, name: str) -> bool:
    items = list(value.values()) if isinstance(value, dict) else value
    return any(_has(item, name) for item in items) if isinstance(items, list) else value == name


def state_data(state: State, body: str | None = None, world: str | None = None) -> dict[str, Plain]:
    """Return a state as data, or only a body or a world of it."""
    worlds: dict[str, Plain] = {
        each.name: world_data(each, body)
        for each in state.worlds.values()
        if world in (None, each.name) and (body is None or body in each.bodies)
    }
    data: dict[str, Plain] = {"step": state.step, "doubt": state.uncertainty, "worlds": worlds}
    return data | {"sampled": dict(asdict(state.sampled))} if state.sampled is not None else data


def world_data(world: World, only: str | None = None) -> dict[str, Plain]:
    """Return a world as data, or only one of its bodies with the body's attachments."""
    return {
        "open": world.open,
        "life": world.lifetime,
        "mode": world.mode,
        "sim_step": world.sim_step,
        "gravity": list(world.gravity),
        "realtime": world.realtime,
        "robot": world.robot,
        "bodies": {body.name: _body(body) for body in world.bodies.values() if only in (None, body.name)},
        "attachments": [
            _attributes(held, "carrier carrier_link body body_link position orientation")
            | ({"loose": True} if held.loose else {})
            for held in world.attachments.values()
            if only in (None, held.carrier, held.body)
        ],
        "following": {
            str(number): message_data(each)
            for number, each in world.following.items()
            if only in (None, each.begin.body)
        },
        "beliefs": [
            {
                "robot": belief.robot,
                "body": belief.object,
                **_attributes(belief, "position orientation source sim_step step"),
            }
            for belief in world.beliefs.values()
            if only in (None, belief.robot, belief.object)
        ],
    }


def _body(body: Body) -> Plain:
    return _attributes(body, "type position orientation velocity joints joint_velocities color fixed_base models")


def _attributes(value: object, names: str) -> dict[str, Plain]:
    found = {name: getattr(value, name) for name in names.split()}
    return {name: list(each) if isinstance(each, tuple) else each for name, each in found.items()}
