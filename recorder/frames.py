"""Coordinate frames of bodies and links: those that a record changed, and as ``foxglove.FrameTransforms`` on /tf.

Frames are named ``BODY`` for a body's base and ``BODY/LINK`` for its other links, with ``WORLD/`` before them in all
worlds but the first. The root is ``world``. A transform's timestamp is simulated time, so that a simulated stretch can
be watched although it is one record.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import STEPS_PER_SECOND, Keyframe, LoadBody, Mutation
from recorder.urdf import Urdf

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from google.protobuf.message import Message

    from recorder.records import BodyState, Record

ROOT: Final = "world"
_NS: Final = 1_000_000_000


class Frame(NamedTuple):
    """Where a body or link is.

    Attributes:
        parent: name of the frame that it is told in.
        child: its own name.
        position: xyz in m.
        orientation: xyzw.
        body: the body.
        link: its link; "" for the base.
    """

    parent: str
    child: str
    position: tuple[float, ...]
    orientation: tuple[float, ...]
    body: str
    link: str


def frame_name(world: str, body: str, link: str = "") -> str:
    """The name of a body's or link's frame.

    Args:
        world: name of the world.
        body: name of the body.
        link: name of the link; "" for the body's base.
    """
    name = body if world == "world_1" else f"{world}/{body}"
    return f"{name}/{link}" if link else name


class FrameTree:
    """What is known of bodies' links, learnt from the records themselves."""

    def __init__(self) -> None:
        self._models: dict[str, Urdf] = {}
        self._bodies: dict[tuple[str, str], Urdf] = {}

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
        return self._bodies.get((world, body))

    def moved(self, record: Record) -> Iterator[tuple[int, BodyState, list[Frame]]]:
        """The bodies that a record moved, and their frames that changed.

        Args:
            record: any.

        Yields:
            The simulated step, what is told of the body, and its frames; moment by moment.
        """
        for step, bodies, whole in self._moments(record):
            for state in bodies:
                yield step, state, self._frames(record.world, state, whole=whole)

    def transforms(self, record: Record) -> Iterator[tuple[str, FrameTransforms]]:
        """The frames that a record changed, as messages.

        Args:
            record: any.

        Yields:
            Topic and message, one for each moment in which something moved.
        """
        for step, bodies, whole in self._moments(record):
            frames = [frame for state in bodies for frame in self._frames(record.world, state, whole=whole)]
            if frames:
                yield "/tf", _message(step, frames)

    def _moments(self, record: Record) -> Iterator[tuple[int, Iterable[BodyState], bool]]:
        """The moments of a record: simulated step, the bodies, and whether they are told whole."""
        if isinstance(record, Keyframe):
            for loaded in record.loaded:
                self._load(record.world, loaded)
            yield record.sim_step, record.bodies, True
        elif isinstance(record, Mutation):
            loading = record.WhichOneof("command") == "load_body"
            if loading:
                self._load(record.world, record.load_body)
            effect = record.effect
            for sample in effect.samples:
                yield sample.sim_step, sample.bodies, False
            yield record.sim_step, effect.bodies, loading

    def _load(self, world: str, loaded: LoadBody) -> None:
        model = self._models.get(loaded.assets[0].sha256) if loaded.assets else None
        if model is not None:
            self._bodies[world, loaded.body] = model

    def _frames(self, world: str, state: BodyState, *, whole: bool) -> list[Frame]:
        body = state.body
        name = frame_name(world, body)
        position = state.position
        frames = [Frame(ROOT, name, tuple(position), tuple(state.orientation), body, "")] if position else []
        model = self._bodies.get((world, body))
        if model is None:
            return frames
        values = dict(zip(state.joints, state.joint_positions, strict=True))
        joints = model.joints.values() if whole else [model.joint(joint) for joint in values]
        for joint in joints:
            parent = name if joint.parent == model.root else f"{name}/{joint.parent}"
            at, turn = joint.pose(values.get(joint.name, 0.0))
            frames.append(Frame(parent, f"{name}/{joint.child}", at, turn, body, joint.child))
        return frames


def _message(step: int, frames: Iterable[Frame]) -> FrameTransforms:
    message = FrameTransforms()
    seconds, steps = divmod(step, STEPS_PER_SECOND)
    nanos = steps * _NS // STEPS_PER_SECOND
    for told in frames:
        frame = message.transforms.add(parent_frame_id=told.parent, child_frame_id=told.child)
        frame.timestamp.seconds, frame.timestamp.nanos = seconds, nanos
        at, turn = frame.translation, frame.rotation
        at.x, at.y, at.z = told.position
        turn.x, turn.y, turn.z, turn.w = told.orientation
    return message
