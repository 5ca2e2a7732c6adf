"""Recordings for Foxglove: an MCAP file by Foxglove's schemas, and a layout.

After a jump in time, Foxglove reads only the last message of each topic, so each body has its own topic. Foxglove
interpolates between poses, so the old pose is repeated immediately before a change. Meshes are converted to GLB,
because other formats don't define the axis that points up.
"""

from __future__ import annotations

import contextlib
import io
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message

from recorder import geometry
from recorder.geometry import Pose, Vector
from recorder.mcap_sink import definition
from recorder.mcap_writer import McapWriter
from recorder.packages import needed, versions
from recorder.records import STEPS_PER_SECOND, Check, Keyframe, LoadBody, Mutation, Record, Task, argument_values
from recorder.records.motion import ROOT, FrameTree, changed_bodies, frame_name
from recorder.records.text import has_line, text_of
from recorder.records.values import first_position
from recorder.tasks.tree import Lanes
from recorder.urdf import Shape, read_shapes
from replay.errors import NONSENSE, Damaged, nonsense

if TYPE_CHECKING:
    from replay.file.record_reader import RecordReader

_NS: Final = 1_000_000_000
_CHUNK: Final = 1 << 20  # number of bytes above which a chunk is closed
_FAILURES: Final = "/failures"
_RED: Final = (0.9, 0.1, 0.1, 1.0)
_ABOVE, _ABOVE_ROBOT = 0.15, 1.8  # height in m of a failure's label above its position or above the robot
_MAX_LETTERS: Final = 120  # longest label
_MAX_CURVES: Final = 8


class FoxgloveTranslator:
    """A translator of a recording for Foxglove into a file."""

    def __init__(self, log: RecordReader, file: BinaryIO) -> None:
        self._log = log
        self._writer = McapWriter(file, f"pycram {versions()['pycram']}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}  # by topic
        self._size = 0  # number of bytes in the present chunk
        self.messages = 0
        self._now = self._clock = 0  # time in the file, and time of the wall clock, in ns since the Unix epoch
        self._simulated: dict[str, int] = {}  # number of simulated steps, by world
        self._frames = FrameTree()
        self._latest: dict[str, Any] = {}  # the latest transform of each frame
        self._bodies: dict[str, dict[str, LoadBody]] = {}  # bodies by world and name
        self._changes: Counter[str] = Counter()  # number of changes of each world
        self._moved: set[str] = set()  # frames that moved
        self._glb: dict[str, bytes] = {}  # converted meshes by name
        self._lanes = Lanes()
        self._positions: dict[int, Vector | None] = {}  # positions that running tasks name in their parameters
        self._failure: tuple[str, str] | None = None  # the shown failure; failed parent tasks have the same failure
        self._properties: dict[str, int] = {}  # number of each watched property

    def translate(self) -> dict[str, Any]:
        """Write all records, and return a layout for the file as JSON; raise Damaged if a record makes no sense."""
        for name in self._log.assets:
            if name.endswith(".urdf") and (content := self._file(name)):
                self._frames.add_urdf(name.partition("/")[0], content)
        for record in self._log.records():
            try:
                self._show(record)
            except NONSENSE as error:
                raise nonsense(self._log.path, f"step {record.seq}", error) from error
        self._writer.finish()
        return self._layout()

    def _add(self, topic: str, message: Message, step: int, time_ns: int) -> None:
        kind = message.DESCRIPTOR.full_name
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.add_schema(kind, "protobuf", definition(type(message)))
        if topic not in self._channels:
            self._channels[topic] = self._writer.add_channel(topic, "protobuf", self._schemas[kind])
        payload = message.SerializeToString()
        self._writer.add_messages([(self._channels[topic], step, time_ns, payload)])
        self.messages += 1
        self._size += len(payload)
        if self._size > _CHUNK:
            self._writer.flush()
            self._size = 0

    def _show(self, record: Record) -> None:
        # a simulation takes its simulated time; other records take the time of the wall clock since the previous record
        before, passed, steps = self._now or record.wall_time_ns, record.wall_time_ns - self._clock, 0
        self._clock = record.wall_time_ns
        if record.world:
            steps = record.sim_step - self._simulated.get(record.world, record.sim_step)
            self._simulated[record.world] = record.sim_step
        self._now += _duration(steps) if steps > 0 else max(passed, 0)
        if isinstance(record, Task):
            self._show_task(record)
        elif isinstance(record, Check):
            number = self._properties.setdefault(record.property, len(self._properties) + 1)
            state = "violated" if record.phase == Check.VIOLATED else "holds"
            self._add(f"/property/{number}", KeyValuePair(key=record.property, value=state), record.seq, self._now)
        elif isinstance(record, Mutation | Keyframe):
            self._show_change(record, before)
        if has_line(record):
            text, level = text_of(record)
            line = Log(level=level, message=f"#{record.seq} {text}", name=type(record).__name__.lower())
            line.file, line.line = getattr(record, "source_file", ""), getattr(record, "source_line", 0)
            line.timestamp.FromNanoseconds(self._now)
            self._add("/log", line, record.seq, self._now)

    def _show_change(self, record: Mutation | Keyframe, before: int) -> None:
        world, messages = record.world, list(self._frames.transforms(record))
        simulates = isinstance(record, Mutation) and record.HasField("simulate")
        held_ns = before if simulates else max(before, self._now - 1)
        changing = {each.child_frame_id: each for message in messages for each in message.transforms}
        held = FrameTransforms()
        for frame, after in changing.items():
            now = self._latest.get(frame, after)
            if (now.translation, now.rotation) != (after.translation, after.rotation):
                held.transforms.add().CopyFrom(now)
                self._moved.add(frame)
        if held.transforms:
            self._transform(held, record.seq, held_ns)
        for message in messages:
            first = message.transforms[0].timestamp  # in simulated time
            time_ns = self._now + first.ToNanoseconds() - _duration(record.sim_step)
            self._transform(message, record.seq, max(time_ns, before))
        bodies = self._bodies.setdefault(world, {})
        removed, added = changed_bodies(record, bodies)
        for name in removed:
            self._draw(bodies.pop(name), record, None)
        for loaded in added:
            bodies[loaded.body] = loaded
            self._draw(loaded, record, loaded.color)
        if isinstance(record, Mutation):
            self._changes[world] += 1
            if record.HasField("set_color") and record.set_color.body in bodies:
                self._draw(bodies[record.set_color.body], record, record.set_color.color)

    def _transform(self, message: FrameTransforms, step: int, time_ns: int) -> None:
        for each in message.transforms:
            each.timestamp.FromNanoseconds(time_ns)
            self._latest[each.child_frame_id] = each
        self._add("/tf", message, step, time_ns)

    def _file(self, name: str) -> bytes:
        """Return the content of an attached file; b"" if the file is missing or damaged. The recording notes damage."""
        with contextlib.suppress(Damaged):
            return self._log.assets.get(name, b"")
        return b""

    def _draw(self, body: LoadBody, record: Record, color: Sequence[float] | None) -> None:
        """Replace the shapes of a body. An empty colour means the colours of the model, None removes the shapes."""
        update, model = self._cleared(), self._frames.model(record.world, body.body)
        if color is not None and model is not None:
            urdf = self._file(f"{body.assets[0].sha256}/{body.assets[0].path.rpartition('/')[2]}")
            for link, shapes in read_shapes(urdf, "visual").items():
                frame = frame_name(record.world, body.body, "" if link == model.root else link)
                entity = update.entities.add(frame_id=frame, frame_locked=True, id=f"{body.body}/{link}")
                entity.timestamp.FromNanoseconds(self._now)
                for shape in shapes:
                    self._add_shape(entity, shape, tuple(color) or shape.color)
        self._add(f"/scene/{frame_name(record.world, body.body)}", update, record.seq, self._now)

    def _cleared(self) -> SceneUpdate:
        update = SceneUpdate()
        update.deletions.add(type=SceneEntityDeletion.ALL).timestamp.FromNanoseconds(self._now)
        return update

    def _add_shape(self, entity: Any, shape: Shape, color: Sequence[float]) -> None:
        width = 2 * shape.size[0]
        if shape.kind == "mesh":
            if shape.mesh not in self._glb:
                content = self._file(shape.mesh)
                self._glb[shape.mesh] = _glb(content, shape.mesh.rpartition(".")[2].lower()) if content else b""
            if glb := self._glb[shape.mesh]:
                model = entity.models.add(data=glb, media_type="model/gltf-binary", override_color=True)
                _place(model, "scale", shape.pose, color, shape.size)
        elif shape.kind == "box":
            _place(entity.cubes.add(), "size", shape.pose, color, shape.size)
        elif shape.kind == "sphere":
            _place(entity.spheres.add(), "size", shape.pose, color, (width, width, width))
        else:
            tube = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
            _place(tube, "size", shape.pose, color, (width, width, shape.size[1]))
        for end in (-0.5, 0.5) if shape.kind == "capsule" else ():
            at = geometry.transform(shape.pose, (0.0, 0.0, end * shape.size[1]))
            _place(entity.spheres.add(), "size", (at, shape.pose[1]), color, (width, width, width))

    def _show_task(self, record: Task) -> None:
        lane = self._lanes.follow(record)
        if lane is None:
            return
        failed = record.status == Task.FAILED
        if record.phase == Task.STARTED:
            self._positions[record.task] = self._position(record.world, record.parameters)
            self._mark_failure(None, None, record)
        elif failed:
            position = self._position(record.world, record.failure.data) or self._positions.get(record.task)
            self._mark_failure((record.failure.type, record.failure.message), position, record)
        state = record.name if record.phase == Task.STARTED else f"{record.name} failed" * failed
        topic = f"/task/{lane[0]}" + f"_{lane[1] + 1}" * bool(lane[1])
        self._add(topic, KeyValuePair(key=record.kind, value=state), record.seq, self._now)

    def _position(self, world: str, arguments: Any) -> Vector | None:
        objects = {name: at for name, (body, at) in self._placed(world).items() if not body.robot_description}
        return first_position(argument_values(arguments, strict=True), objects)

    def _placed(self, world: str) -> dict[str, tuple[LoadBody, Vector]]:
        """Return the bodies of a world with their positions, m."""
        placed = {}
        for name, body in self._bodies.get(world, {}).items():
            if (base := self._latest.get(frame_name(world, name))) is not None:
                placed[name] = body, (base.translation.x, base.translation.y, base.translation.z)
        return placed

    def _mark_failure(self, failure: tuple[str, str] | None, position: Vector | None, record: Task) -> None:
        """Show a failure until the next task begins; None removes it."""
        if failure == self._failure:
            return
        self._failure, update = failure, self._cleared()
        robots = [at for body, at in self._placed(record.world).values() if body.robot_description]
        if failure is not None:
            x, y, z = position or next(iter(robots), geometry.IDENTITY[0])
            top = x, y, z + (_ABOVE if position else _ABOVE_ROBOT)
            entity = update.entities.add(frame_id=ROOT, id="failure")
            entity.timestamp.FromNanoseconds(self._now)
            text = f"{record.name} failed: {': '.join(failure)}"[:_MAX_LETTERS]
            label = entity.texts.add(billboard=True, scale_invariant=True, font_size=14, text=text)
            _place(label, "", (top, geometry.IDENTITY[1]), _RED)
        self._add(_FAILURES, update, record.seq, self._now)

    def _layout(self) -> dict[str, Any]:
        """Return a layout: the scene above the tasks and properties, the log above the heights of moved objects."""
        world = next((name for name, _ in self._changes.most_common(1)), "")
        movable = {name: at for name, (body, at) in self._placed(world).items() if not body.fixed_base}
        topics = [*(f"/scene/{frame_name(world, name)}" for name in self._bodies.get(world, {})), _FAILURES]
        scene = {
            "followTf": ROOT,
            "followMode": "follow-none",
            "scene": {"transforms": {"visible": False, "enablePreloading": True}},
            "topics": {topic: {"visible": True} for topic in topics},
            "cameraState": {
                "distance": 4.5,
                "phi": 60,
                "thetaOffset": 135,
                "perspective": True,
                "targetOffset": np.mean([*movable.values()] or [(0.0, 0.0, 0.0)], axis=0).round(3).tolist(),
            },
        }
        states = [(f"{topic}.value", topic) for topic in self._channels if topic.startswith("/task/")]
        states += [(f"/property/{number}.value", text) for text, number in self._properties.items()]
        frames = {name: frame for name in movable if (frame := frame_name(world, name)) in self._moved}
        path = '/tf.transforms[:]{{child_frame_id=="{}"}}.translation.z'
        heights = [(path.format(frame), name) for name, frame in frames.items()][:_MAX_CURVES]
        log = _panel("Log", {"topicToRender": "/log", "minLogLevel": Log.INFO})
        left = _split("column", _panel("ThreeDee", scene), _panel("StateTransitions", _series(sorted(states))))
        right = _split("column", log, _panel("Plot", _series(heights) | {"yAxisLabel": "height in m"}))
        return {"version": 1, "content": _split("row", left, right)}


def _duration(steps: int) -> int:
    """Return the duration of simulated steps in ns."""
    return steps * _NS // STEPS_PER_SECOND


def _place(shape: Any, edges: str, pose: Pose, color: Sequence[float], size: Sequence[float] = ()) -> None:
    """Set the pose, the colour and the size of a shape. ``edges`` is the name of the field that contains the size."""
    at, turn = shape.pose.position, shape.pose.orientation
    (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w) = pose
    shape.color.r, shape.color.g, shape.color.b, shape.color.a = color
    if edges:
        field = getattr(shape, edges)
        field.x, field.y, field.z = size


def _glb(content: bytes, suffix: str) -> bytes:
    """Convert a mesh, in which z points up, to GLB, in which y points up."""
    with needed("render"):
        import trimesh  # noqa: PLC0415  takes a second
    mesh: Any = trimesh.load(io.BytesIO(content), file_type=suffix, force="mesh", process=False)
    x, y, z = np.asarray(mesh.vertices).T
    turned = trimesh.Trimesh(np.stack((x, z, -y), axis=1), mesh.faces, process=False)
    turned.merge_vertices()
    return bytes(turned.export(file_type="glb", include_normals=False))  # type: ignore[arg-type]


def _panel(kind: str, config: dict[str, Any]) -> dict[str, Any]:
    return {"type": "panel", "panelType": kind, "version": 1, "config": config}


def _series(paths: Iterable[tuple[str, str]]) -> dict[str, Any]:
    common = {"enabled": True, "timestampMethod": "receiveTime"}
    return {"isSynced": True, "paths": [{"value": value, "label": label, **common} for value, label in paths]}


def _split(direction: str, first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    items = [{"proportion": 3, "content": first}, {"proportion": 2, "content": second}]
    return {"type": "split", "direction": direction, "items": items}
