"""Which definitions (``log.proto``) this release knows, and which a recording's writer knew.

Definitions are added and never taken away, so their number tells which of two releases knows more. Recordings have the
number in their metadata, and the definitions themselves beside their records.
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
    """Return the names of all messages, fields and enum values, as ``Mutation``, ``Mutation.effect``, ``Task.LEFT``."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto  # noqa: PLC0415  few readers need it

    own = FileDescriptorProto()
    log_pb2.DESCRIPTOR.CopyToProto(own)
    return frozenset(_names(own.message_type))


def format_number() -> int:
    """Return the format that this release writes: the number of its definitions."""
    return len(known())


def unknown(definitions: Iterable[bytes]) -> list[str]:
    """Return the names in the definitions of message types (as recordings have them) that this release doesn't know.

    Definitions that can't be read define nothing.
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
