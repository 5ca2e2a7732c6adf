"""Coordinate frames of bodies and links as ``foxglove.FrameTransforms`` on /tf: those that a record changed.

Frames are named ``BODY`` for a body's base and ``BODY/LINK`` for its other links, with ``WORLD/`` before them in all
worlds but the first. The root is ``world``. A transform's timestamp is simulated time, so that a simulated stretch can
be watched although it is one record.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log

from recorder.records import Keyframe, LoadBody, Mutation
from recorder.urdf import Urdf

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from google.protobuf.message import Message

    from recorder.records import BodyState

_STEPS: Final = 240  # a simulated second
_NS: Final = 1_000_000_000


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

    def transforms(self, record: object) -> Iterator[tuple[str, FrameTransforms]]:
        """The frames that a record changed.

        Args:
            record: any.

        Yields:
            Topic and message, one for each moment.
        """
        if isinstance(record, Keyframe):
            for loaded in record.loaded:
                self._load(record.world, loaded)
            yield from self._message(record.world, record.sim_step, record.bodies, whole=True)
        elif isinstance(record, Mutation):
            loading = record.WhichOneof("command") == "load_body"
            if loading:
                self._load(record.world, record.load_body)
            for sample in record.effect.samples:
                yield from self._message(record.world, sample.sim_step, sample.bodies)
            yield from self._message(record.world, record.sim_step, record.effect.bodies, whole=loading)

    def _load(self, world: str, loaded: LoadBody) -> None:
        model = self._models.get(loaded.assets[0].sha256) if loaded.assets else None
        if model is not None:
            self._bodies[world, loaded.body] = model

    def _message(
        self, world: str, step: int, bodies: Iterable[BodyState], *, whole: bool = False
    ) -> Iterator[tuple[str, FrameTransforms]]:
        message = FrameTransforms()
        seconds, steps = divmod(step, _STEPS)
        nanos = steps * _NS // _STEPS

        def add(parent: str, child: str, at: Sequence[float], turn: Sequence[float]) -> None:
            frame = message.transforms.add(parent_frame_id=parent, child_frame_id=child)
            frame.timestamp.seconds, frame.timestamp.nanos = seconds, nanos
            frame.translation.x, frame.translation.y, frame.translation.z = at
            frame.rotation.x, frame.rotation.y, frame.rotation.z, frame.rotation.w = turn

        for state in bodies:
            name = state.body if world == "world_1" else f"{world}/{state.body}"
            if state.position:
                add("world", name, state.position, state.orientation)
            model = self._bodies.get((world, state.body))
            if model is None:
                continue
            values = dict(zip(state.joints, state.joint_positions, strict=True))
            joints = model.joints.values() if whole else [model.joint(joint) for joint in values]
            for joint in joints:
                parent = name if joint.parent == model.root else f"{name}/{joint.parent}"
                add(parent, f"{name}/{joint.child}", *joint.pose(values.get(joint.name, 0.0)))
        if message.transforms:
            yield "/tf", message
