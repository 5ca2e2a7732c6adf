"""How much of the records' definition (``log.proto``) a release knows, and a recording's writer knew.

Definitions are added and never taken away, so their number tells which of two releases knows more. Recordings have it
in their metadata, and the definitions themselves beside their records.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

from google.protobuf.message import DecodeError

from recorder.records import log_pb2

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from google.protobuf.descriptor_pb2 import DescriptorProto

PACKAGE: Final = log_pb2.DESCRIPTOR.package


@cache
def known() -> frozenset[str]:
    """The names of all messages, fields and values of enums, as ``Mutation``, ``Mutation.effect``, ``Task.LEFT``."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto  # noqa: PLC0415  few readers need it

    own = FileDescriptorProto()
    log_pb2.DESCRIPTOR.CopyToProto(own)
    return frozenset(_names(own.message_type))


def format_number() -> int:
    """The format that this release writes: how many definitions it knows."""
    return len(known())


def unknown(definitions: Iterable[bytes]) -> list[str]:
    """The names of what this release doesn't know.

    Args:
        definitions: of message types, as recordings have them; what can't be read defines nothing.
    """
    from google.protobuf.descriptor_pb2 import FileDescriptorSet  # noqa: PLC0415  few readers need it

    names: dict[str, None] = {}
    for definition in definitions:
        try:
            files = FileDescriptorSet.FromString(definition).file
        except DecodeError:
            continue
        names |= dict.fromkeys(name for file in files if file.package == PACKAGE for name in _names(file.message_type))
    return [name for name in names if name not in known()]


def _names(messages: Iterable[DescriptorProto], within: str = "") -> Iterator[str]:
    for message in messages:
        name = within + message.name
        yield name
        yield from (f"{name}.{field.name}" for field in message.field)
        yield from (f"{name}.{value.name}" for enum in message.enum_type for value in enum.value)
        yield from _names(message.nested_type, f"{name}.")
