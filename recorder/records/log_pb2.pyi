from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Argument(_message.Message):
    __slots__ = ("name", "json")
    NAME_FIELD_NUMBER: _ClassVar[int]
    JSON_FIELD_NUMBER: _ClassVar[int]
    name: str
    json: str
    def __init__(self, name: _Optional[str] = ..., json: _Optional[str] = ...) -> None: ...

class Variable(_message.Message):
    __slots__ = ("name", "value")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: str
    def __init__(self, name: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...

class StackFrame(_message.Message):
    __slots__ = ("file", "line", "function", "variables")
    FILE_FIELD_NUMBER: _ClassVar[int]
    LINE_FIELD_NUMBER: _ClassVar[int]
    FUNCTION_FIELD_NUMBER: _ClassVar[int]
    VARIABLES_FIELD_NUMBER: _ClassVar[int]
    file: str
    line: int
    function: str
    variables: _containers.RepeatedCompositeFieldContainer[Variable]
    def __init__(self, file: _Optional[str] = ..., line: _Optional[int] = ..., function: _Optional[str] = ..., variables: _Optional[_Iterable[_Union[Variable, _Mapping]]] = ...) -> None: ...

class Failure(_message.Message):
    __slots__ = ("type", "message", "data", "traceback", "frames")
    TYPE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    TRACEBACK_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    type: str
    message: str
    data: _containers.RepeatedCompositeFieldContainer[Argument]
    traceback: str
    frames: _containers.RepeatedCompositeFieldContainer[StackFrame]
    def __init__(self, type: _Optional[str] = ..., message: _Optional[str] = ..., data: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ..., traceback: _Optional[str] = ..., frames: _Optional[_Iterable[_Union[StackFrame, _Mapping]]] = ...) -> None: ...

class Decision(_message.Message):
    __slots__ = ("resolver", "checkpoint", "solution", "known", "complete", "environment", "module", "chooser", "registered_for")
    RESOLVER_FIELD_NUMBER: _ClassVar[int]
    CHECKPOINT_FIELD_NUMBER: _ClassVar[int]
    SOLUTION_FIELD_NUMBER: _ClassVar[int]
    KNOWN_FIELD_NUMBER: _ClassVar[int]
    COMPLETE_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_FIELD_NUMBER: _ClassVar[int]
    MODULE_FIELD_NUMBER: _ClassVar[int]
    CHOOSER_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_FOR_FIELD_NUMBER: _ClassVar[int]
    resolver: str
    checkpoint: int
    solution: int
    known: int
    complete: bool
    environment: str
    module: str
    chooser: str
    registered_for: str
    def __init__(self, resolver: _Optional[str] = ..., checkpoint: _Optional[int] = ..., solution: _Optional[int] = ..., known: _Optional[int] = ..., complete: bool = ..., environment: _Optional[str] = ..., module: _Optional[str] = ..., chooser: _Optional[str] = ..., registered_for: _Optional[str] = ...) -> None: ...

class Candidate(_message.Message):
    __slots__ = ("names", "count", "reason", "data")
    NAMES_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    names: _containers.RepeatedScalarFieldContainer[str]
    count: int
    reason: str
    data: _containers.RepeatedCompositeFieldContainer[Argument]
    def __init__(self, names: _Optional[_Iterable[str]] = ..., count: _Optional[int] = ..., reason: _Optional[str] = ..., data: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ...) -> None: ...

class SourceLine(_message.Message):
    __slots__ = ("file", "line")
    FILE_FIELD_NUMBER: _ClassVar[int]
    LINE_FIELD_NUMBER: _ClassVar[int]
    file: str
    line: int
    def __init__(self, file: _Optional[str] = ..., line: _Optional[int] = ...) -> None: ...

class Strike(_message.Message):
    __slots__ = ("look", "which")
    LOOK_FIELD_NUMBER: _ClassVar[int]
    WHICH_FIELD_NUMBER: _ClassVar[int]
    look: int
    which: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, look: _Optional[int] = ..., which: _Optional[_Iterable[int]] = ...) -> None: ...

class Asset(_message.Message):
    __slots__ = ("path", "sha256")
    PATH_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    path: str
    sha256: str
    def __init__(self, path: _Optional[str] = ..., sha256: _Optional[str] = ...) -> None: ...

class BodyState(_message.Message):
    __slots__ = ("body", "position", "orientation", "velocity", "joints", "joint_positions", "joint_velocities")
    BODY_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    JOINT_POSITIONS_FIELD_NUMBER: _ClassVar[int]
    JOINT_VELOCITIES_FIELD_NUMBER: _ClassVar[int]
    body: str
    position: _containers.RepeatedScalarFieldContainer[float]
    orientation: _containers.RepeatedScalarFieldContainer[float]
    velocity: _containers.RepeatedScalarFieldContainer[float]
    joints: _containers.RepeatedScalarFieldContainer[str]
    joint_positions: _containers.RepeatedScalarFieldContainer[float]
    joint_velocities: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, body: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., orientation: _Optional[_Iterable[float]] = ..., velocity: _Optional[_Iterable[float]] = ..., joints: _Optional[_Iterable[str]] = ..., joint_positions: _Optional[_Iterable[float]] = ..., joint_velocities: _Optional[_Iterable[float]] = ...) -> None: ...

class Attachment(_message.Message):
    __slots__ = ("carrier", "carrier_link", "body", "body_link", "position", "orientation", "loose")
    CARRIER_FIELD_NUMBER: _ClassVar[int]
    CARRIER_LINK_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    BODY_LINK_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    LOOSE_FIELD_NUMBER: _ClassVar[int]
    carrier: str
    carrier_link: str
    body: str
    body_link: str
    position: _containers.RepeatedScalarFieldContainer[float]
    orientation: _containers.RepeatedScalarFieldContainer[float]
    loose: bool
    def __init__(self, carrier: _Optional[str] = ..., carrier_link: _Optional[str] = ..., body: _Optional[str] = ..., body_link: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., orientation: _Optional[_Iterable[float]] = ..., loose: bool = ...) -> None: ...

class Overlap(_message.Message):
    __slots__ = ("link", "body", "body_link", "depth")
    LINK_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    BODY_LINK_FIELD_NUMBER: _ClassVar[int]
    DEPTH_FIELD_NUMBER: _ClassVar[int]
    link: str
    body: str
    body_link: str
    depth: float
    def __init__(self, link: _Optional[str] = ..., body: _Optional[str] = ..., body_link: _Optional[str] = ..., depth: _Optional[float] = ...) -> None: ...

class OpenWorld(_message.Message):
    __slots__ = ("mode",)
    MODE_FIELD_NUMBER: _ClassVar[int]
    mode: str
    def __init__(self, mode: _Optional[str] = ...) -> None: ...

class CloseWorld(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Loading(_message.Message):
    __slots__ = ("undamped", "clamped", "mimic", "inertia", "armature", "gain", "strength")
    UNDAMPED_FIELD_NUMBER: _ClassVar[int]
    CLAMPED_FIELD_NUMBER: _ClassVar[int]
    MIMIC_FIELD_NUMBER: _ClassVar[int]
    INERTIA_FIELD_NUMBER: _ClassVar[int]
    ARMATURE_FIELD_NUMBER: _ClassVar[int]
    GAIN_FIELD_NUMBER: _ClassVar[int]
    STRENGTH_FIELD_NUMBER: _ClassVar[int]
    undamped: bool
    clamped: bool
    mimic: bool
    inertia: bool
    armature: float
    gain: float
    strength: float
    def __init__(self, undamped: bool = ..., clamped: bool = ..., mimic: bool = ..., inertia: bool = ..., armature: _Optional[float] = ..., gain: _Optional[float] = ..., strength: _Optional[float] = ...) -> None: ...

class LoadBody(_message.Message):
    __slots__ = ("body", "type", "path", "assets", "position", "orientation", "color", "fixed_base", "joints", "robot_description", "loading", "overlaps", "scale")
    BODY_FIELD_NUMBER: _ClassVar[int]
    TYPE_FIELD_NUMBER: _ClassVar[int]
    PATH_FIELD_NUMBER: _ClassVar[int]
    ASSETS_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    COLOR_FIELD_NUMBER: _ClassVar[int]
    FIXED_BASE_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    ROBOT_DESCRIPTION_FIELD_NUMBER: _ClassVar[int]
    LOADING_FIELD_NUMBER: _ClassVar[int]
    OVERLAPS_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    body: str
    type: str
    path: str
    assets: _containers.RepeatedCompositeFieldContainer[Asset]
    position: _containers.RepeatedScalarFieldContainer[float]
    orientation: _containers.RepeatedScalarFieldContainer[float]
    color: _containers.RepeatedScalarFieldContainer[float]
    fixed_base: bool
    joints: _containers.RepeatedScalarFieldContainer[str]
    robot_description: str
    loading: Loading
    overlaps: _containers.RepeatedCompositeFieldContainer[Overlap]
    scale: float
    def __init__(self, body: _Optional[str] = ..., type: _Optional[str] = ..., path: _Optional[str] = ..., assets: _Optional[_Iterable[_Union[Asset, _Mapping]]] = ..., position: _Optional[_Iterable[float]] = ..., orientation: _Optional[_Iterable[float]] = ..., color: _Optional[_Iterable[float]] = ..., fixed_base: bool = ..., joints: _Optional[_Iterable[str]] = ..., robot_description: _Optional[str] = ..., loading: _Optional[_Union[Loading, _Mapping]] = ..., overlaps: _Optional[_Iterable[_Union[Overlap, _Mapping]]] = ..., scale: _Optional[float] = ...) -> None: ...

class RemoveBody(_message.Message):
    __slots__ = ("body",)
    BODY_FIELD_NUMBER: _ClassVar[int]
    body: str
    def __init__(self, body: _Optional[str] = ...) -> None: ...

class MoveBody(_message.Message):
    __slots__ = ("body", "position", "orientation")
    BODY_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    body: str
    position: _containers.RepeatedScalarFieldContainer[float]
    orientation: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, body: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., orientation: _Optional[_Iterable[float]] = ...) -> None: ...

class MoveJoints(_message.Message):
    __slots__ = ("body", "joints", "positions")
    BODY_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    body: str
    joints: _containers.RepeatedScalarFieldContainer[str]
    positions: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, body: _Optional[str] = ..., joints: _Optional[_Iterable[str]] = ..., positions: _Optional[_Iterable[float]] = ...) -> None: ...

class AttachBody(_message.Message):
    __slots__ = ("carrier", "carrier_link", "body", "body_link", "along", "left")
    CARRIER_FIELD_NUMBER: _ClassVar[int]
    CARRIER_LINK_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    BODY_LINK_FIELD_NUMBER: _ClassVar[int]
    ALONG_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    carrier: str
    carrier_link: str
    body: str
    body_link: str
    along: _containers.RepeatedScalarFieldContainer[str]
    left: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, carrier: _Optional[str] = ..., carrier_link: _Optional[str] = ..., body: _Optional[str] = ..., body_link: _Optional[str] = ..., along: _Optional[_Iterable[str]] = ..., left: _Optional[_Iterable[str]] = ...) -> None: ...

class DetachBody(_message.Message):
    __slots__ = ("carrier", "body")
    CARRIER_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    carrier: str
    body: str
    def __init__(self, carrier: _Optional[str] = ..., body: _Optional[str] = ...) -> None: ...

class SetGravity(_message.Message):
    __slots__ = ("gravity",)
    GRAVITY_FIELD_NUMBER: _ClassVar[int]
    gravity: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, gravity: _Optional[_Iterable[float]] = ...) -> None: ...

class SetRealtime(_message.Message):
    __slots__ = ("enabled",)
    ENABLED_FIELD_NUMBER: _ClassVar[int]
    enabled: bool
    def __init__(self, enabled: bool = ...) -> None: ...

class SetColor(_message.Message):
    __slots__ = ("body", "color")
    BODY_FIELD_NUMBER: _ClassVar[int]
    COLOR_FIELD_NUMBER: _ClassVar[int]
    body: str
    color: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, body: _Optional[str] = ..., color: _Optional[_Iterable[float]] = ...) -> None: ...

class SetRobot(_message.Message):
    __slots__ = ("body",)
    BODY_FIELD_NUMBER: _ClassVar[int]
    body: str
    def __init__(self, body: _Optional[str] = ...) -> None: ...

class Simulate(_message.Message):
    __slots__ = ("steps", "settled", "driven")
    STEPS_FIELD_NUMBER: _ClassVar[int]
    SETTLED_FIELD_NUMBER: _ClassVar[int]
    DRIVEN_FIELD_NUMBER: _ClassVar[int]
    steps: int
    settled: bool
    driven: _containers.RepeatedCompositeFieldContainer[Driven]
    def __init__(self, steps: _Optional[int] = ..., settled: bool = ..., driven: _Optional[_Iterable[_Union[Driven, _Mapping]]] = ...) -> None: ...

class Trajectory(_message.Message):
    __slots__ = ("joints", "times", "positions", "velocities")
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    TIMES_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    VELOCITIES_FIELD_NUMBER: _ClassVar[int]
    joints: _containers.RepeatedScalarFieldContainer[str]
    times: _containers.RepeatedScalarFieldContainer[float]
    positions: _containers.RepeatedScalarFieldContainer[float]
    velocities: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, joints: _Optional[_Iterable[str]] = ..., times: _Optional[_Iterable[float]] = ..., positions: _Optional[_Iterable[float]] = ..., velocities: _Optional[_Iterable[float]] = ...) -> None: ...

class PathSearch(_message.Message):
    __slots__ = ("planner", "seed", "attempts", "checks", "max_checks", "way_points")
    PLANNER_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    CHECKS_FIELD_NUMBER: _ClassVar[int]
    MAX_CHECKS_FIELD_NUMBER: _ClassVar[int]
    WAY_POINTS_FIELD_NUMBER: _ClassVar[int]
    planner: str
    seed: int
    attempts: int
    checks: int
    max_checks: int
    way_points: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, planner: _Optional[str] = ..., seed: _Optional[int] = ..., attempts: _Optional[int] = ..., checks: _Optional[int] = ..., max_checks: _Optional[int] = ..., way_points: _Optional[_Iterable[float]] = ...) -> None: ...

class BeginTrajectory(_message.Message):
    __slots__ = ("body", "number", "trajectory", "search", "coasts")
    BODY_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    TRAJECTORY_FIELD_NUMBER: _ClassVar[int]
    SEARCH_FIELD_NUMBER: _ClassVar[int]
    COASTS_FIELD_NUMBER: _ClassVar[int]
    body: str
    number: int
    trajectory: Trajectory
    search: PathSearch
    coasts: bool
    def __init__(self, body: _Optional[str] = ..., number: _Optional[int] = ..., trajectory: _Optional[_Union[Trajectory, _Mapping]] = ..., search: _Optional[_Union[PathSearch, _Mapping]] = ..., coasts: bool = ...) -> None: ...

class StopTrajectory(_message.Message):
    __slots__ = ("number", "body")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    number: int
    body: str
    def __init__(self, number: _Optional[int] = ..., body: _Optional[str] = ...) -> None: ...

class Driven(_message.Message):
    __slots__ = ("number", "body", "time", "error", "joint", "ended")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    JOINT_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    number: int
    body: str
    time: float
    error: float
    joint: str
    ended: bool
    def __init__(self, number: _Optional[int] = ..., body: _Optional[str] = ..., time: _Optional[float] = ..., error: _Optional[float] = ..., joint: _Optional[str] = ..., ended: bool = ...) -> None: ...

class Following(_message.Message):
    __slots__ = ("begin", "began", "stopped")
    BEGIN_FIELD_NUMBER: _ClassVar[int]
    BEGAN_FIELD_NUMBER: _ClassVar[int]
    STOPPED_FIELD_NUMBER: _ClassVar[int]
    begin: BeginTrajectory
    began: int
    stopped: int
    def __init__(self, begin: _Optional[_Union[BeginTrajectory, _Mapping]] = ..., began: _Optional[int] = ..., stopped: _Optional[int] = ...) -> None: ...

class Reset(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class SavedBody(_message.Message):
    __slots__ = ("body", "position", "orientation", "velocity", "joint_positions", "joint_velocities", "joint_targets")
    BODY_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FIELD_NUMBER: _ClassVar[int]
    JOINT_POSITIONS_FIELD_NUMBER: _ClassVar[int]
    JOINT_VELOCITIES_FIELD_NUMBER: _ClassVar[int]
    JOINT_TARGETS_FIELD_NUMBER: _ClassVar[int]
    body: str
    position: _containers.RepeatedScalarFieldContainer[float]
    orientation: _containers.RepeatedScalarFieldContainer[float]
    velocity: _containers.RepeatedScalarFieldContainer[float]
    joint_positions: _containers.RepeatedScalarFieldContainer[float]
    joint_velocities: _containers.RepeatedScalarFieldContainer[float]
    joint_targets: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, body: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., orientation: _Optional[_Iterable[float]] = ..., velocity: _Optional[_Iterable[float]] = ..., joint_positions: _Optional[_Iterable[float]] = ..., joint_velocities: _Optional[_Iterable[float]] = ..., joint_targets: _Optional[_Iterable[float]] = ...) -> None: ...

class Belief(_message.Message):
    __slots__ = ("robot", "object", "source", "position", "orientation", "sim_step", "step")
    class Source(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        SOURCE_UNSPECIFIED: _ClassVar[Belief.Source]
        SEEN: _ClassVar[Belief.Source]
        TOLD: _ClassVar[Belief.Source]
        HELD: _ClassVar[Belief.Source]
        PLACED: _ClassVar[Belief.Source]
    SOURCE_UNSPECIFIED: Belief.Source
    SEEN: Belief.Source
    TOLD: Belief.Source
    HELD: Belief.Source
    PLACED: Belief.Source
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    OBJECT_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    robot: str
    object: str
    source: Belief.Source
    position: _containers.RepeatedScalarFieldContainer[float]
    orientation: _containers.RepeatedScalarFieldContainer[float]
    sim_step: int
    step: int
    def __init__(self, robot: _Optional[str] = ..., object: _Optional[str] = ..., source: _Optional[_Union[Belief.Source, str]] = ..., position: _Optional[_Iterable[float]] = ..., orientation: _Optional[_Iterable[float]] = ..., sim_step: _Optional[int] = ..., step: _Optional[int] = ...) -> None: ...

class Restore(_message.Message):
    __slots__ = ("sim_step", "bodies", "attachments", "gravity", "robot", "beliefs")
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    BODIES_FIELD_NUMBER: _ClassVar[int]
    ATTACHMENTS_FIELD_NUMBER: _ClassVar[int]
    GRAVITY_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    BELIEFS_FIELD_NUMBER: _ClassVar[int]
    sim_step: int
    bodies: _containers.RepeatedCompositeFieldContainer[SavedBody]
    attachments: _containers.RepeatedCompositeFieldContainer[Attachment]
    gravity: _containers.RepeatedScalarFieldContainer[float]
    robot: str
    beliefs: _containers.RepeatedCompositeFieldContainer[Belief]
    def __init__(self, sim_step: _Optional[int] = ..., bodies: _Optional[_Iterable[_Union[SavedBody, _Mapping]]] = ..., attachments: _Optional[_Iterable[_Union[Attachment, _Mapping]]] = ..., gravity: _Optional[_Iterable[float]] = ..., robot: _Optional[str] = ..., beliefs: _Optional[_Iterable[_Union[Belief, _Mapping]]] = ...) -> None: ...

class Drag(_message.Message):
    __slots__ = ("body", "link", "sim_step")
    BODY_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    body: str
    link: str
    sim_step: int
    def __init__(self, body: _Optional[str] = ..., link: _Optional[str] = ..., sim_step: _Optional[int] = ...) -> None: ...

class Sample(_message.Message):
    __slots__ = ("sim_step", "bodies")
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    BODIES_FIELD_NUMBER: _ClassVar[int]
    sim_step: int
    bodies: _containers.RepeatedCompositeFieldContainer[BodyState]
    def __init__(self, sim_step: _Optional[int] = ..., bodies: _Optional[_Iterable[_Union[BodyState, _Mapping]]] = ...) -> None: ...

class Effect(_message.Message):
    __slots__ = ("bodies", "removed", "attached", "detached", "samples")
    BODIES_FIELD_NUMBER: _ClassVar[int]
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    ATTACHED_FIELD_NUMBER: _ClassVar[int]
    DETACHED_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    bodies: _containers.RepeatedCompositeFieldContainer[BodyState]
    removed: _containers.RepeatedScalarFieldContainer[str]
    attached: _containers.RepeatedCompositeFieldContainer[Attachment]
    detached: _containers.RepeatedCompositeFieldContainer[Attachment]
    samples: _containers.RepeatedCompositeFieldContainer[Sample]
    def __init__(self, bodies: _Optional[_Iterable[_Union[BodyState, _Mapping]]] = ..., removed: _Optional[_Iterable[str]] = ..., attached: _Optional[_Iterable[_Union[Attachment, _Mapping]]] = ..., detached: _Optional[_Iterable[_Union[Attachment, _Mapping]]] = ..., samples: _Optional[_Iterable[_Union[Sample, _Mapping]]] = ...) -> None: ...

class Mutation(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "open_world", "close_world", "load_body", "remove_body", "move_body", "move_joints", "attach_body", "detach_body", "set_gravity", "set_realtime", "set_color", "set_robot", "simulate", "reset", "restore", "begin_trajectory", "stop_trajectory", "effect", "source_file", "source_line", "callers", "drags", "by_fork")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    OPEN_WORLD_FIELD_NUMBER: _ClassVar[int]
    CLOSE_WORLD_FIELD_NUMBER: _ClassVar[int]
    LOAD_BODY_FIELD_NUMBER: _ClassVar[int]
    REMOVE_BODY_FIELD_NUMBER: _ClassVar[int]
    MOVE_BODY_FIELD_NUMBER: _ClassVar[int]
    MOVE_JOINTS_FIELD_NUMBER: _ClassVar[int]
    ATTACH_BODY_FIELD_NUMBER: _ClassVar[int]
    DETACH_BODY_FIELD_NUMBER: _ClassVar[int]
    SET_GRAVITY_FIELD_NUMBER: _ClassVar[int]
    SET_REALTIME_FIELD_NUMBER: _ClassVar[int]
    SET_COLOR_FIELD_NUMBER: _ClassVar[int]
    SET_ROBOT_FIELD_NUMBER: _ClassVar[int]
    SIMULATE_FIELD_NUMBER: _ClassVar[int]
    RESET_FIELD_NUMBER: _ClassVar[int]
    RESTORE_FIELD_NUMBER: _ClassVar[int]
    BEGIN_TRAJECTORY_FIELD_NUMBER: _ClassVar[int]
    STOP_TRAJECTORY_FIELD_NUMBER: _ClassVar[int]
    EFFECT_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    CALLERS_FIELD_NUMBER: _ClassVar[int]
    DRAGS_FIELD_NUMBER: _ClassVar[int]
    BY_FORK_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    open_world: OpenWorld
    close_world: CloseWorld
    load_body: LoadBody
    remove_body: RemoveBody
    move_body: MoveBody
    move_joints: MoveJoints
    attach_body: AttachBody
    detach_body: DetachBody
    set_gravity: SetGravity
    set_realtime: SetRealtime
    set_color: SetColor
    set_robot: SetRobot
    simulate: Simulate
    reset: Reset
    restore: Restore
    begin_trajectory: BeginTrajectory
    stop_trajectory: StopTrajectory
    effect: Effect
    source_file: str
    source_line: int
    callers: _containers.RepeatedCompositeFieldContainer[SourceLine]
    drags: _containers.RepeatedCompositeFieldContainer[Drag]
    by_fork: bool
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., open_world: _Optional[_Union[OpenWorld, _Mapping]] = ..., close_world: _Optional[_Union[CloseWorld, _Mapping]] = ..., load_body: _Optional[_Union[LoadBody, _Mapping]] = ..., remove_body: _Optional[_Union[RemoveBody, _Mapping]] = ..., move_body: _Optional[_Union[MoveBody, _Mapping]] = ..., move_joints: _Optional[_Union[MoveJoints, _Mapping]] = ..., attach_body: _Optional[_Union[AttachBody, _Mapping]] = ..., detach_body: _Optional[_Union[DetachBody, _Mapping]] = ..., set_gravity: _Optional[_Union[SetGravity, _Mapping]] = ..., set_realtime: _Optional[_Union[SetRealtime, _Mapping]] = ..., set_color: _Optional[_Union[SetColor, _Mapping]] = ..., set_robot: _Optional[_Union[SetRobot, _Mapping]] = ..., simulate: _Optional[_Union[Simulate, _Mapping]] = ..., reset: _Optional[_Union[Reset, _Mapping]] = ..., restore: _Optional[_Union[Restore, _Mapping]] = ..., begin_trajectory: _Optional[_Union[BeginTrajectory, _Mapping]] = ..., stop_trajectory: _Optional[_Union[StopTrajectory, _Mapping]] = ..., effect: _Optional[_Union[Effect, _Mapping]] = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ..., callers: _Optional[_Iterable[_Union[SourceLine, _Mapping]]] = ..., drags: _Optional[_Iterable[_Union[Drag, _Mapping]]] = ..., by_fork: bool = ...) -> None: ...

class Keyframe(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "mode", "gravity", "realtime", "loaded", "bodies", "attachments", "robot", "following", "beliefs")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    GRAVITY_FIELD_NUMBER: _ClassVar[int]
    REALTIME_FIELD_NUMBER: _ClassVar[int]
    LOADED_FIELD_NUMBER: _ClassVar[int]
    BODIES_FIELD_NUMBER: _ClassVar[int]
    ATTACHMENTS_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FIELD_NUMBER: _ClassVar[int]
    FOLLOWING_FIELD_NUMBER: _ClassVar[int]
    BELIEFS_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    mode: str
    gravity: _containers.RepeatedScalarFieldContainer[float]
    realtime: bool
    loaded: _containers.RepeatedCompositeFieldContainer[LoadBody]
    bodies: _containers.RepeatedCompositeFieldContainer[BodyState]
    attachments: _containers.RepeatedCompositeFieldContainer[Attachment]
    robot: str
    following: _containers.RepeatedCompositeFieldContainer[Following]
    beliefs: _containers.RepeatedCompositeFieldContainer[Belief]
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., mode: _Optional[str] = ..., gravity: _Optional[_Iterable[float]] = ..., realtime: bool = ..., loaded: _Optional[_Iterable[_Union[LoadBody, _Mapping]]] = ..., bodies: _Optional[_Iterable[_Union[BodyState, _Mapping]]] = ..., attachments: _Optional[_Iterable[_Union[Attachment, _Mapping]]] = ..., robot: _Optional[str] = ..., following: _Optional[_Iterable[_Union[Following, _Mapping]]] = ..., beliefs: _Optional[_Iterable[_Union[Belief, _Mapping]]] = ...) -> None: ...

class Task(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "phase", "status", "parent", "kind", "name", "parameters", "solution", "result_json", "failure", "duration_ns", "source_file", "source_line", "attempt", "callers", "decision", "began_ns", "checkpoint")
    class Phase(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        PHASE_UNSPECIFIED: _ClassVar[Task.Phase]
        STARTED: _ClassVar[Task.Phase]
        FINISHED: _ClassVar[Task.Phase]
        ASKED: _ClassVar[Task.Phase]
        LEFT: _ClassVar[Task.Phase]
    PHASE_UNSPECIFIED: Task.Phase
    STARTED: Task.Phase
    FINISHED: Task.Phase
    ASKED: Task.Phase
    LEFT: Task.Phase
    class Status(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STATUS_UNSPECIFIED: _ClassVar[Task.Status]
        RUNNING: _ClassVar[Task.Status]
        SUCCEEDED: _ClassVar[Task.Status]
        FAILED: _ClassVar[Task.Status]
        CANCELLED: _ClassVar[Task.Status]
        CREATED: _ClassVar[Task.Status]
    STATUS_UNSPECIFIED: Task.Status
    RUNNING: Task.Status
    SUCCEEDED: Task.Status
    FAILED: Task.Status
    CANCELLED: Task.Status
    CREATED: Task.Status
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    PARENT_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    PARAMETERS_FIELD_NUMBER: _ClassVar[int]
    SOLUTION_FIELD_NUMBER: _ClassVar[int]
    RESULT_JSON_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    DURATION_NS_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    CALLERS_FIELD_NUMBER: _ClassVar[int]
    DECISION_FIELD_NUMBER: _ClassVar[int]
    BEGAN_NS_FIELD_NUMBER: _ClassVar[int]
    CHECKPOINT_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    phase: Task.Phase
    status: Task.Status
    parent: int
    kind: str
    name: str
    parameters: _containers.RepeatedCompositeFieldContainer[Argument]
    solution: _containers.RepeatedCompositeFieldContainer[Argument]
    result_json: str
    failure: Failure
    duration_ns: int
    source_file: str
    source_line: int
    attempt: int
    callers: _containers.RepeatedCompositeFieldContainer[SourceLine]
    decision: Decision
    began_ns: int
    checkpoint: int
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., phase: _Optional[_Union[Task.Phase, str]] = ..., status: _Optional[_Union[Task.Status, str]] = ..., parent: _Optional[int] = ..., kind: _Optional[str] = ..., name: _Optional[str] = ..., parameters: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ..., solution: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ..., result_json: _Optional[str] = ..., failure: _Optional[_Union[Failure, _Mapping]] = ..., duration_ns: _Optional[int] = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ..., attempt: _Optional[int] = ..., callers: _Optional[_Iterable[_Union[SourceLine, _Mapping]]] = ..., decision: _Optional[_Union[Decision, _Mapping]] = ..., began_ns: _Optional[int] = ..., checkpoint: _Optional[int] = ...) -> None: ...

class HandlerCall(_message.Message):
    __slots__ = ("handler",)
    HANDLER_FIELD_NUMBER: _ClassVar[int]
    handler: str
    def __init__(self, handler: _Optional[str] = ...) -> None: ...

class Event(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "name", "sender", "arguments", "handlers", "source_file", "source_line", "callers")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SENDER_FIELD_NUMBER: _ClassVar[int]
    ARGUMENTS_FIELD_NUMBER: _ClassVar[int]
    HANDLERS_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    CALLERS_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    name: str
    sender: str
    arguments: _containers.RepeatedCompositeFieldContainer[Argument]
    handlers: _containers.RepeatedCompositeFieldContainer[HandlerCall]
    source_file: str
    source_line: int
    callers: _containers.RepeatedCompositeFieldContainer[SourceLine]
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., name: _Optional[str] = ..., sender: _Optional[str] = ..., arguments: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ..., handlers: _Optional[_Iterable[_Union[HandlerCall, _Mapping]]] = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ..., callers: _Optional[_Iterable[_Union[SourceLine, _Mapping]]] = ...) -> None: ...

class Subscription(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "name", "sender", "handler", "removed", "source_file", "source_line", "callers")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SENDER_FIELD_NUMBER: _ClassVar[int]
    HANDLER_FIELD_NUMBER: _ClassVar[int]
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    CALLERS_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    name: str
    sender: str
    handler: str
    removed: bool
    source_file: str
    source_line: int
    callers: _containers.RepeatedCompositeFieldContainer[SourceLine]
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., name: _Optional[str] = ..., sender: _Optional[str] = ..., handler: _Optional[str] = ..., removed: bool = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ..., callers: _Optional[_Iterable[_Union[SourceLine, _Mapping]]] = ...) -> None: ...

class Refusal(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "name", "arguments", "failure", "source_file", "source_line", "callers")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    ARGUMENTS_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    CALLERS_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    name: str
    arguments: _containers.RepeatedCompositeFieldContainer[Argument]
    failure: Failure
    source_file: str
    source_line: int
    callers: _containers.RepeatedCompositeFieldContainer[SourceLine]
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., name: _Optional[str] = ..., arguments: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ..., failure: _Optional[_Union[Failure, _Mapping]] = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ..., callers: _Optional[_Iterable[_Union[SourceLine, _Mapping]]] = ...) -> None: ...

class Picture(_message.Message):
    __slots__ = ("width", "height", "bodies", "pixels")
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    BODIES_FIELD_NUMBER: _ClassVar[int]
    PIXELS_FIELD_NUMBER: _ClassVar[int]
    width: int
    height: int
    bodies: _containers.RepeatedScalarFieldContainer[str]
    pixels: bytes
    def __init__(self, width: _Optional[int] = ..., height: _Optional[int] = ..., bodies: _Optional[_Iterable[str]] = ..., pixels: _Optional[bytes] = ...) -> None: ...

class Spot(_message.Message):
    __slots__ = ("position", "yaw", "score", "candidate")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    YAW_FIELD_NUMBER: _ClassVar[int]
    SCORE_FIELD_NUMBER: _ClassVar[int]
    CANDIDATE_FIELD_NUMBER: _ClassVar[int]
    position: _containers.RepeatedScalarFieldContainer[float]
    yaw: float
    score: float
    candidate: int
    def __init__(self, position: _Optional[_Iterable[float]] = ..., yaw: _Optional[float] = ..., score: _Optional[float] = ..., candidate: _Optional[int] = ...) -> None: ...

class Grid(_message.Message):
    __slots__ = ("origin", "resolution", "width", "height", "scores", "spots")
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    RESOLUTION_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    SCORES_FIELD_NUMBER: _ClassVar[int]
    SPOTS_FIELD_NUMBER: _ClassVar[int]
    origin: _containers.RepeatedScalarFieldContainer[float]
    resolution: float
    width: int
    height: int
    scores: bytes
    spots: _containers.RepeatedCompositeFieldContainer[Spot]
    def __init__(self, origin: _Optional[_Iterable[float]] = ..., resolution: _Optional[float] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., scores: _Optional[bytes] = ..., spots: _Optional[_Iterable[_Union[Spot, _Mapping]]] = ...) -> None: ...

class Query(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "name", "arguments", "answer_json", "evidence", "duration_ns", "failure", "picture", "candidates", "chosen", "source_file", "source_line", "callers", "grid", "by_fork", "own_answer_json")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    ARGUMENTS_FIELD_NUMBER: _ClassVar[int]
    ANSWER_JSON_FIELD_NUMBER: _ClassVar[int]
    EVIDENCE_FIELD_NUMBER: _ClassVar[int]
    DURATION_NS_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    PICTURE_FIELD_NUMBER: _ClassVar[int]
    CANDIDATES_FIELD_NUMBER: _ClassVar[int]
    CHOSEN_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    CALLERS_FIELD_NUMBER: _ClassVar[int]
    GRID_FIELD_NUMBER: _ClassVar[int]
    BY_FORK_FIELD_NUMBER: _ClassVar[int]
    OWN_ANSWER_JSON_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    name: str
    arguments: _containers.RepeatedCompositeFieldContainer[Argument]
    answer_json: str
    evidence: _containers.RepeatedCompositeFieldContainer[Argument]
    duration_ns: int
    failure: Failure
    picture: Picture
    candidates: _containers.RepeatedCompositeFieldContainer[Candidate]
    chosen: int
    source_file: str
    source_line: int
    callers: _containers.RepeatedCompositeFieldContainer[SourceLine]
    grid: Grid
    by_fork: bool
    own_answer_json: str
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., name: _Optional[str] = ..., arguments: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ..., answer_json: _Optional[str] = ..., evidence: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ..., duration_ns: _Optional[int] = ..., failure: _Optional[_Union[Failure, _Mapping]] = ..., picture: _Optional[_Union[Picture, _Mapping]] = ..., candidates: _Optional[_Iterable[_Union[Candidate, _Mapping]]] = ..., chosen: _Optional[int] = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ..., callers: _Optional[_Iterable[_Union[SourceLine, _Mapping]]] = ..., grid: _Optional[_Union[Grid, _Mapping]] = ..., by_fork: bool = ..., own_answer_json: _Optional[str] = ...) -> None: ...

class Fluent(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "name", "before_json", "after_json", "source", "bodies", "source_file", "source_line", "callers", "by_fork")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    BEFORE_JSON_FIELD_NUMBER: _ClassVar[int]
    AFTER_JSON_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    BODIES_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    CALLERS_FIELD_NUMBER: _ClassVar[int]
    BY_FORK_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    name: str
    before_json: str
    after_json: str
    source: str
    bodies: _containers.RepeatedScalarFieldContainer[str]
    source_file: str
    source_line: int
    callers: _containers.RepeatedCompositeFieldContainer[SourceLine]
    by_fork: bool
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., name: _Optional[str] = ..., before_json: _Optional[str] = ..., after_json: _Optional[str] = ..., source: _Optional[str] = ..., bodies: _Optional[_Iterable[str]] = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ..., callers: _Optional[_Iterable[_Union[SourceLine, _Mapping]]] = ..., by_fork: bool = ...) -> None: ...

class Check(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "phase", "property", "by_run", "only_record", "step", "moment", "margin", "values", "reason", "source_file", "source_line", "callers")
    class Phase(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        PHASE_UNSPECIFIED: _ClassVar[Check.Phase]
        WATCHED: _ClassVar[Check.Phase]
        VIOLATED: _ClassVar[Check.Phase]
    PHASE_UNSPECIFIED: Check.Phase
    WATCHED: Check.Phase
    VIOLATED: Check.Phase
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    PROPERTY_FIELD_NUMBER: _ClassVar[int]
    BY_RUN_FIELD_NUMBER: _ClassVar[int]
    ONLY_RECORD_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    MOMENT_FIELD_NUMBER: _ClassVar[int]
    MARGIN_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    CALLERS_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    phase: Check.Phase
    property: str
    by_run: bool
    only_record: bool
    step: int
    moment: int
    margin: float
    values: _containers.RepeatedCompositeFieldContainer[Argument]
    reason: str
    source_file: str
    source_line: int
    callers: _containers.RepeatedCompositeFieldContainer[SourceLine]
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., phase: _Optional[_Union[Check.Phase, str]] = ..., property: _Optional[str] = ..., by_run: bool = ..., only_record: bool = ..., step: _Optional[int] = ..., moment: _Optional[int] = ..., margin: _Optional[float] = ..., values: _Optional[_Iterable[_Union[Argument, _Mapping]]] = ..., reason: _Optional[str] = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ..., callers: _Optional[_Iterable[_Union[SourceLine, _Mapping]]] = ...) -> None: ...

class Output(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "stream", "text", "level", "logger", "source_file", "source_line")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    STREAM_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    LOGGER_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FILE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LINE_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    stream: str
    text: str
    level: str
    logger: str
    source_file: str
    source_line: int
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., stream: _Optional[str] = ..., text: _Optional[str] = ..., level: _Optional[str] = ..., logger: _Optional[str] = ..., source_file: _Optional[str] = ..., source_line: _Optional[int] = ...) -> None: ...

class Envelope(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ...) -> None: ...

class Revision(_message.Message):
    __slots__ = ("commit", "modified", "sha256")
    COMMIT_FIELD_NUMBER: _ClassVar[int]
    MODIFIED_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    commit: str
    modified: bool
    sha256: str
    def __init__(self, commit: _Optional[str] = ..., modified: bool = ..., sha256: _Optional[str] = ...) -> None: ...

class Origin(_message.Message):
    __slots__ = ("recording", "step", "wall_time_ns", "changes")
    RECORDING_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    CHANGES_FIELD_NUMBER: _ClassVar[int]
    recording: str
    step: int
    wall_time_ns: int
    changes: _containers.RepeatedCompositeFieldContainer[Change]
    def __init__(self, recording: _Optional[str] = ..., step: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., changes: _Optional[_Iterable[_Union[Change, _Mapping]]] = ...) -> None: ...

class Change(_message.Message):
    __slots__ = ("step", "set", "world", "answer", "seed")
    STEP_FIELD_NUMBER: _ClassVar[int]
    SET_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    ANSWER_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    step: int
    set: str
    world: str
    answer: str
    seed: str
    def __init__(self, step: _Optional[int] = ..., set: _Optional[str] = ..., world: _Optional[str] = ..., answer: _Optional[str] = ..., seed: _Optional[str] = ...) -> None: ...

class Run(_message.Message):
    __slots__ = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns", "strikes", "phase", "name", "succeeded", "failure", "duration_ns", "arguments", "directory", "seed", "hash_seed", "plan", "pycram", "host", "cpu", "program", "origin", "by_program", "called_as", "number", "order", "environment", "looks", "interrupted_by", "checkpoint", "parameters", "sweep")
    class Phase(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        PHASE_UNSPECIFIED: _ClassVar[Run.Phase]
        STARTED: _ClassVar[Run.Phase]
        FINISHED: _ClassVar[Run.Phase]
        THREAD_FAILED: _ClassVar[Run.Phase]
    PHASE_UNSPECIFIED: Run.Phase
    STARTED: Run.Phase
    FINISHED: Run.Phase
    THREAD_FAILED: Run.Phase
    SEQ_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SIM_STEP_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    THREAD_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    MONOTONIC_NS_FIELD_NUMBER: _ClassVar[int]
    STRIKES_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SUCCEEDED_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    DURATION_NS_FIELD_NUMBER: _ClassVar[int]
    ARGUMENTS_FIELD_NUMBER: _ClassVar[int]
    DIRECTORY_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    HASH_SEED_FIELD_NUMBER: _ClassVar[int]
    PLAN_FIELD_NUMBER: _ClassVar[int]
    PYCRAM_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    CPU_FIELD_NUMBER: _ClassVar[int]
    PROGRAM_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    BY_PROGRAM_FIELD_NUMBER: _ClassVar[int]
    CALLED_AS_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    ORDER_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_FIELD_NUMBER: _ClassVar[int]
    LOOKS_FIELD_NUMBER: _ClassVar[int]
    INTERRUPTED_BY_FIELD_NUMBER: _ClassVar[int]
    CHECKPOINT_FIELD_NUMBER: _ClassVar[int]
    PARAMETERS_FIELD_NUMBER: _ClassVar[int]
    SWEEP_FIELD_NUMBER: _ClassVar[int]
    seq: int
    wall_time_ns: int
    sim_step: int
    world: str
    task: int
    thread: str
    cause: int
    monotonic_ns: int
    strikes: _containers.RepeatedCompositeFieldContainer[Strike]
    phase: Run.Phase
    name: str
    succeeded: bool
    failure: Failure
    duration_ns: int
    arguments: _containers.RepeatedScalarFieldContainer[str]
    directory: str
    seed: str
    hash_seed: str
    plan: Revision
    pycram: Revision
    host: str
    cpu: str
    program: str
    origin: Origin
    by_program: bool
    called_as: str
    number: int
    order: str
    environment: str
    looks: int
    interrupted_by: str
    checkpoint: int
    parameters: _containers.RepeatedCompositeFieldContainer[Parameter]
    sweep: Sweep
    def __init__(self, seq: _Optional[int] = ..., wall_time_ns: _Optional[int] = ..., sim_step: _Optional[int] = ..., world: _Optional[str] = ..., task: _Optional[int] = ..., thread: _Optional[str] = ..., cause: _Optional[int] = ..., monotonic_ns: _Optional[int] = ..., strikes: _Optional[_Iterable[_Union[Strike, _Mapping]]] = ..., phase: _Optional[_Union[Run.Phase, str]] = ..., name: _Optional[str] = ..., succeeded: bool = ..., failure: _Optional[_Union[Failure, _Mapping]] = ..., duration_ns: _Optional[int] = ..., arguments: _Optional[_Iterable[str]] = ..., directory: _Optional[str] = ..., seed: _Optional[str] = ..., hash_seed: _Optional[str] = ..., plan: _Optional[_Union[Revision, _Mapping]] = ..., pycram: _Optional[_Union[Revision, _Mapping]] = ..., host: _Optional[str] = ..., cpu: _Optional[str] = ..., program: _Optional[str] = ..., origin: _Optional[_Union[Origin, _Mapping]] = ..., by_program: bool = ..., called_as: _Optional[str] = ..., number: _Optional[int] = ..., order: _Optional[str] = ..., environment: _Optional[str] = ..., looks: _Optional[int] = ..., interrupted_by: _Optional[str] = ..., checkpoint: _Optional[int] = ..., parameters: _Optional[_Iterable[_Union[Parameter, _Mapping]]] = ..., sweep: _Optional[_Union[Sweep, _Mapping]] = ...) -> None: ...

class Parameter(_message.Message):
    __slots__ = ("name", "value_json")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_JSON_FIELD_NUMBER: _ClassVar[int]
    name: str
    value_json: str
    def __init__(self, name: _Optional[str] = ..., value_json: _Optional[str] = ...) -> None: ...

class Sweep(_message.Message):
    __slots__ = ("number", "seed", "attempt")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    number: int
    seed: int
    attempt: int
    def __init__(self, number: _Optional[int] = ..., seed: _Optional[int] = ..., attempt: _Optional[int] = ...) -> None: ...
