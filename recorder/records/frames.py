"""Coordinate frames of bodies and links: those that a record changed, and as ``foxglove.FrameTransforms`` on /tf.

Frames are named ``BODY`` for a body's base and ``BODY/LINK`` for its other links, with ``WORLD//`` before them in all
worlds but the first. The root is ``world``. No two frames share a name, however worlds, bodies and links are called:
what would be mistaken stands as in URLs (``/`` as ``%2F``). A transform's timestamp is simulated time, so that a
simulated stretch can be watched although it is one record.

All this is done for every change while a plan runs. So lists of records are copied (``[:]``) to go through them:
protobuf's own iterators take three times as long.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.geometry.urdf import Urdf
from recorder.records import STEPS_PER_SECOND, Keyframe, LoadBody, Mutation

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from google.protobuf.message import Message

    from recorder.geometry import Pose
    from recorder.geometry.joints import Joint
    from recorder.records import BodyState, Record

ROOT: Final = "world"
_FIRST: Final = "world_1"
_VIEWERS: Final = "tf#/"  # so begin the names that Rerun gives frames itself
_NS: Final = 1_000_000_000


class Frame(NamedTuple):
    """The frame of a body or link.

    Attributes:
        parent: name of the frame that its pose is told in.
        child: its own name.
        body: the body.
        link: its link; "" for the base.
    """

    parent: str
    child: str
    body: str
    link: str


def frame_name(world: str, body: str, link: str = "") -> str:
    """The name of a body's or link's frame.

    Args:
        world: name of the world.
        body: name of the body.
        link: name of the link; "" for the body's base.
    """
    name = _escaped(body) if world == _FIRST else f"{_escaped(world)}//{_escaped(body)}"
    if link:
        return _free(f"{name}/{_escaped(link)}")
    return _free(name)


def _escaped(name: str) -> str:
    return name.replace("%", "%25").replace("/", "%2F")


def _free(name: str) -> str:
    taken = name == ROOT or name.startswith(_VIEWERS)
    return f"%{ord(name[0]):X}{name[1:]}" if taken else name


class Moved(NamedTuple):
    """What was told of a body at a moment.

    Attributes:
        step: the simulated step.
        body: its name.
        frames: those of its frames that changed, with their poses.
        joints: values in rad or m by name, of those that were told.
    """

    step: int
    body: str
    frames: list[tuple[Frame, Pose]]
    joints: dict[str, float]


class _Link(NamedTuple):
    """A link's joint, and its frame."""

    joint: Joint
    frame: Frame


class _Body:
    """A body that was told of: names of its frames, and its model, if that is known."""

    def __init__(self, world: str, name: str, model: Urdf | None) -> None:
        self.model = model
        self.frame = Frame(ROOT, frame_name(world, name), name, "")
        self._names = world, name
        self._links: dict[str, _Link] = {}  # by joint; as far as they were asked for

    def links(self, model: Urdf, joints: Iterable[str]) -> Iterator[_Link]:
        """The links that hang on joints."""
        for name in joints:
            link = self._links.get(name)
            if link is None:
                joint = model.joint(name)
                parent = self.frame.child if joint.parent == model.root else frame_name(*self._names, joint.parent)
                frame = Frame(parent, frame_name(*self._names, joint.child), self.frame.body, joint.child)
                link = self._links[name] = _Link(joint, frame)
            yield link


class FrameTree:
    """What is known of bodies' links, learnt from the records themselves."""

    def __init__(self) -> None:
        self._models: dict[str, Urdf] = {}
        self._bodies: dict[tuple[str, str], _Body] = {}

    @staticmethod
    def channels() -> list[tuple[str, type[Message]]]:
        """Topics and messages for other people's tools."""
        return [("/tf", FrameTransforms), ("/log", Log)]

    def learn(self, sha256: str, content: bytes) -> None:
        """Takes a URDF.

        Args:
            sha256: of its content.
            content: its text.
        """
        self._models[sha256] = Urdf.parse(content)

    def model(self, world: str, body: str) -> Urdf | None:
        """The model of a body that was loaded; None if it is not known.

        Args:
            world: name of the world.
            body: name of the body.
        """
        known = self._bodies.get((world, body))
        return known.model if known is not None else None

    def moved(self, record: Record) -> list[Moved]:
        """The bodies that a record moved, moment by moment, with their frames that changed.

        Args:
            record: any.
        """
        world = record.world
        return [
            self._moved(world, step, state, whole=whole)
            for step, bodies, whole in self._moments(record)
            for state in bodies
        ]

    def transforms(self, record: Record) -> Iterator[tuple[str, FrameTransforms]]:
        """The frames that a record changed, as messages.

        Args:
            record: any.

        Yields:
            Topic and message, one for each moment in which something moved.
        """
        for step, bodies, whole in self._moments(record):
            moved = [self._moved(record.world, step, state, whole=whole) for state in bodies]
            frames = [frame for one in moved for frame in one.frames]
            if frames:
                yield "/tf", _message(step, frames)

    def _moments(self, record: Record) -> list[tuple[int, Sequence[BodyState], bool]]:
        """The moments of a record: simulated step, the bodies, and whether they are told whole."""
        if isinstance(record, Mutation):
            loading = record.HasField("load_body")
            if loading:
                self._load(record.world, record.load_body)
            effect = record.effect
            last = (record.sim_step, effect.bodies[:], loading)
            return [*[(sample.sim_step, sample.bodies[:], False) for sample in effect.samples[:]], last]
        if isinstance(record, Keyframe):
            for loaded in record.loaded[:]:
                self._load(record.world, loaded)
            return [(record.sim_step, record.bodies[:], True)]
        return []

    def _load(self, world: str, loaded: LoadBody) -> None:
        model = self._models.get(loaded.assets[0].sha256) if loaded.assets else None
        known = self._bodies.get((world, loaded.body))
        if known is None or known.model is not model:
            self._bodies[world, loaded.body] = _Body(world, loaded.body, model)

    def _moved(self, world: str, step: int, state: BodyState, *, whole: bool) -> Moved:
        body = state.body
        known = self._bodies.get((world, body))
        if known is None:
            known = self._bodies[world, body] = _Body(world, body, None)
        frames = []
        position, joints = state.position[:], state.joints[:]
        if position:
            x, y, z = position
            i, j, k, w = state.orientation[:]
            frames.append((known.frame, ((x, y, z), (i, j, k, w))))
        values = dict(zip(joints, state.joint_positions[:], strict=True)) if joints else {}
        model = known.model
        if model is not None and (whole or values):
            for joint, frame in known.links(model, model.joints if whole else values):
                frames.append((frame, joint.pose(values.get(joint.name, 0.0))))
        return Moved(step, body, frames, values)


def _message(step: int, frames: Iterable[tuple[Frame, Pose]]) -> FrameTransforms:
    message = FrameTransforms()
    seconds, steps = divmod(step, STEPS_PER_SECOND)
    nanos = steps * _NS // STEPS_PER_SECOND
    for told, pose in frames:
        frame = message.transforms.add(parent_frame_id=told.parent, child_frame_id=told.child)
        frame.timestamp.seconds, frame.timestamp.nanos = seconds, nanos
        at, turn = frame.translation, frame.rotation
        (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w) = pose
    return message
