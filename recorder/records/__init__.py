"""The records: their definition (``log.proto``), their Python names, frames and text. A record is one step."""

from collections.abc import Mapping
from typing import Final, TypeAlias

from recorder.records.log_pb2 import (
    Argument as Argument,
    Asset as Asset,
    AttachBody as AttachBody,
    Attachment as Attachment,
    BeginTrajectory as BeginTrajectory,
    Belief as Belief,
    BodyState as BodyState,
    Candidate as Candidate,
    Change as Change,
    CloseWorld as CloseWorld,
    Decision as Decision,
    DetachBody as DetachBody,
    Drag as Drag,
    Driven as Driven,
    Effect as Effect,
    Envelope as Envelope,
    Event as Event,
    Failure as Failure,
    Fluent as Fluent,
    Following as Following,
    Grid as Grid,
    HandlerCall as HandlerCall,
    Keyframe as Keyframe,
    LoadBody as LoadBody,
    Loading as Loading,
    MoveBody as MoveBody,
    MoveJoints as MoveJoints,
    Mutation as Mutation,
    OpenWorld as OpenWorld,
    Output as Output,
    Overlap as Overlap,
    PathSearch as PathSearch,
    Picture as Picture,
    Query as Query,
    Refusal as Refusal,
    RemoveBody as RemoveBody,
    Reset as Reset,
    Restore as Restore,
    Revision as Revision,
    Run as Run,
    Sample as Sample,
    SavedBody as SavedBody,
    SetColor as SetColor,
    SetGravity as SetGravity,
    SetRealtime as SetRealtime,
    SetRobot as SetRobot,
    Simulate as Simulate,
    SourceLine as SourceLine,
    Spot as Spot,
    StackFrame as StackFrame,
    StopTrajectory as StopTrajectory,
    Strike as Strike,
    Subscription as Subscription,
    Task as Task,
    Trajectory as Trajectory,
    Variable as Variable,
)
from recorder.records.values import (
    Plain as Plain,
    argument_values as argument_values,
    arguments as arguments,
    escaped as escaped,
    failure as failure,
    format_error as format_error,
    format_failure as format_failure,
    from_json as from_json,
    to_json as to_json,
    without_addresses as without_addresses,
)

Record: TypeAlias = (
    Run | Task | Mutation | Event | Subscription | Fluent | Query | Refusal | Keyframe | Output | Envelope
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
}
"""The MCAP topic of each record type; one type each."""

UNKNOWN: Final = "/unknown"
"""In place of the topic of records of a kind that a newer release has added."""

STEPS_PER_SECOND: Final = 240
"""Of simulated time, which a record's ``sim_step`` counts; every world is simulated at this pace."""
