"""The records: their definition (``log.proto``), their Python names, frames and text. A record is one step."""

from collections.abc import Mapping
from typing import Final, TypeAlias

from recorder.records.log_pb2 import (
    Argument,
    Asset,
    AttachBody,
    Attachment,
    BodyState,
    CloseWorld,
    DetachBody,
    Effect,
    Event,
    Failure,
    Fluent,
    HandlerCall,
    Keyframe,
    LoadBody,
    MoveBody,
    MoveJoints,
    Mutation,
    OpenWorld,
    Picture,
    Query,
    RemoveBody,
    Reset,
    Run,
    Sample,
    SetColor,
    SetGravity,
    SetRealtime,
    SetRobot,
    Simulate,
    SourceLine,
    Task,
)
from recorder.records.values import arguments, failure, format_error, format_failure, to_json

__all__ = [
    "STEPS_PER_SECOND",
    "TOPICS",
    "Argument",
    "Asset",
    "AttachBody",
    "Attachment",
    "BodyState",
    "CloseWorld",
    "DetachBody",
    "Effect",
    "Event",
    "Failure",
    "Fluent",
    "HandlerCall",
    "Keyframe",
    "LoadBody",
    "MoveBody",
    "MoveJoints",
    "Mutation",
    "OpenWorld",
    "Picture",
    "Query",
    "Record",
    "RemoveBody",
    "Reset",
    "Run",
    "Sample",
    "SetColor",
    "SetGravity",
    "SetRealtime",
    "SetRobot",
    "Simulate",
    "SourceLine",
    "Task",
    "arguments",
    "failure",
    "format_error",
    "format_failure",
    "to_json",
]

Record: TypeAlias = Run | Task | Mutation | Event | Fluent | Query | Keyframe

TOPICS: Mapping[type[Record], str] = {
    Run: "/run",
    Task: "/task",
    Mutation: "/mutation",
    Event: "/event",
    Fluent: "/fluent",
    Query: "/query",
    Keyframe: "/keyframe",
}
"""The MCAP topic of each record type; one type each."""

STEPS_PER_SECOND: Final = 240
"""Of simulated time, which a record's ``sim_step`` counts; every world is simulated at this pace."""
