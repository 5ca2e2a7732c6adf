"""The records: their Python names, their topics, and the definitions (``log.proto``) that this release knows.

A step of a recording is a record. Definitions are added and never removed, so a release with more definitions is newer.
Recordings have the number of definitions in their metadata, and the definitions in their schemas.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Final, TypeAlias

from google.protobuf.message import DecodeError

from recorder.records import log_pb2
from recorder.records.log_pb2 import *  # noqa: F403  all messages of log.proto
from recorder.records.log_pb2 import (
    Check,
    Envelope,
    Event,
    Fluent,
    Keyframe,
    Mutation,
    Output,
    Query,
    Refusal,
    Run,
    Subscription,
    Task,
)
from recorder.records.values import (
    Plain as Plain,
    argument_values as argument_values,
    arguments as arguments,
    escaped as escaped,
    failure as failure,
    format_assertion as format_assertion,
    format_error as format_error,
    format_failure as format_failure,
    from_json as from_json,
    to_json as to_json,
    without_addresses as without_addresses,
)

if TYPE_CHECKING:
    from google.protobuf.descriptor_pb2 import DescriptorProto

Record: TypeAlias = (
    Run | Task | Mutation | Event | Subscription | Fluent | Query | Refusal | Keyframe | Output | Check | Envelope
)

TOPICS: Mapping[type[Record], str] = {
    Run: "/run",
    Task: "/task",
    Mutation: "/mutation",
    Event: "/event",
    Subscription: "/subscription",
    Fluent: "/fluent",
    Query: "/query",
    Refusal: "/refusal",
    Keyframe: "/keyframe",
    Output: "/output",
    Check: "/check",
}
"""The MCAP topic of each type of record."""

UNKNOWN: Final = "/unknown"  # the topic of records with a type of a newer release

STEPS_PER_SECOND: Final = 240  # number of simulation steps, which a record's ``sim_step`` counts, in a second

PACKAGE: Final = log_pb2.DESCRIPTOR.package  # the protobuf package of the definitions in recordings


@cache
def known_definitions() -> frozenset[str]:
    """Return the names of all messages, fields and enum values, such as ``Mutation.effect``."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto  # noqa: PLC0415  imported here: few readers need it

    own = FileDescriptorProto()
    log_pb2.DESCRIPTOR.CopyToProto(own)
    return frozenset(_names(own.message_type))


def format_number() -> int:
    """Return the format number of this release: the number of its definitions."""
    return len(known_definitions())


def unknown_definitions(definitions: Iterable[bytes]) -> list[str]:
    """Return the names in the schemas of a recording that this release doesn't know. Unreadable schemas are skipped."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet  # noqa: PLC0415  imported here: few readers need it

    names: dict[str, None] = {}
    for definition in definitions:
        try:
            files = FileDescriptorSet.FromString(definition).file
        except DecodeError:
            continue
        names |= dict.fromkeys(name for file in files if file.package == PACKAGE for name in _names(file.message_type))
    return [name for name in names if name not in known_definitions()]


def _names(messages: Iterable[DescriptorProto], within: str = "") -> Iterator[str]:
    for message in messages:
        name = within + message.name
        yield name
        yield from (f"{name}.{field.name}" for field in message.field)
        yield from (f"{name}.{value.name}" for enum in message.enum_type for value in enum.value)
        yield from _names(message.nested_type, f"{name}.")
