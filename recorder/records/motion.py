"""Motion, computed from records alone: frames of bodies and links, and progress on trajectories.

The topic /tf has the frames as ``foxglove.FrameTransforms``, at simulated times. A base is named ``BODY``, another link
``BODY/LINK``; outside of the first world, ``WORLD//`` precedes the name. ``/`` and ``%`` in names are percent-encoded.
Lists of records are copied (``[:]``) for iteration: protobuf's own iterators take three times as long.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from recorder.records import STEPS_PER_SECOND, BodyState, Following, Keyframe, LoadBody, Mutation, Record

if TYPE_CHECKING:
    from recorder.geometry import Pose
    from recorder.urdf import Urdf, UrdfJoint

ROOT: Final = "world"
_FIRST_WORLD: Final = "world_1"
_RERUN_PREFIX: Final = "tf#/"  # prefix of the frames that belong to Rerun
_NS: Final = 1_000_000_000


class Frame(NamedTuple):
    """The frame of a body or link."""

    parent: str  # name of the parent frame, which contains the pose
    child: str
    body: str
    link: str  # name of the link; "" for the base


def frame_name(world: str, body: str, link: str = "") -> str:
    """Return the name of the frame of a link; without a link, of the base."""
    name = _escaped(body) if world == _FIRST_WORLD else f"{_escaped(world)}//{_escaped(body)}"
    name = f"{name}/{_escaped(link)}" if link else name
    return f"%{ord(name[0]):X}{name[1:]}" if name == ROOT or name.startswith(_RERUN_PREFIX) else name


def _escaped(name: str) -> str:
    return name.replace("%", "%25").replace("/", "%2F")


class BodyMotion(NamedTuple):
    """The change of a body in a simulated step."""

    sim_step: int
    body: str
    frames: list[tuple[Frame, Pose]]  # the changed frames, with their poses in their parents
    joints: dict[str, float]  # positions of the changed joints, in rad or m, by name


class _Body:
    """A body's frames and its model."""

    def __init__(self, world: str, name: str, model: Urdf | None) -> None:
        self.model = model
        self.frame = Frame(ROOT, frame_name(world, name), name, "")
        self._names = world, name
        self._links: dict[str, tuple[UrdfJoint, Frame]] = {}  # frames of the joints' child links, by joint name

    def links(self, model: Urdf, joints: Iterable[str]) -> Iterator[tuple[UrdfJoint, Frame]]:
        """Yield the named joints and the frames of their child links."""
        for name in joints:
            link = self._links.get(name)
            if link is None:
                joint = model.joint(name)
                parent = self.frame.child if joint.parent == model.root else frame_name(*self._names, joint.parent)
                frame = Frame(parent, frame_name(*self._names, joint.child), self.frame.body, joint.child)
                link = self._links[name] = joint, frame
            yield link


class FrameTree:
    """The models and frames of all bodies in a recording."""

    def __init__(self) -> None:
        self._models: dict[str, Urdf] = {}
        self._bodies: dict[tuple[str, str], _Body] = {}

    def add_urdf(self, sha256: str, content: bytes) -> None:
        """Add a model. The file must come before the records that use the model."""
        from recorder.urdf import Urdf  # noqa: PLC0415  loads NumPy

        self._models[sha256] = Urdf.parse(content)

    def model(self, world: str, body: str) -> Urdf | None:
        """Return the model of a loaded body; None if unknown."""
        loaded = self._bodies.get((world, body))
        return loaded.model if loaded is not None else None

    def motions(self, record: Record) -> list[BodyMotion]:
        """Return the motions of bodies in a record, in the order of simulated time."""
        world = record.world
        return [
            self._motion(world, sim_step, state, whole=whole)
            for sim_step, states, whole in self._states(record)
            for state in states
        ]

    def transforms(self, record: Record) -> Iterator[FrameTransforms]:
        """Yield, for each simulated step of a record, a message with the changed frames."""
        for sim_step, states, whole in self._states(record):
            motions = [self._motion(record.world, sim_step, state, whole=whole) for state in states]
            frames = [frame for motion in motions for frame in motion.frames]
            if not frames:
                continue
            message = FrameTransforms()
            seconds, steps = divmod(sim_step, STEPS_PER_SECOND)
            nanos = steps * _NS // STEPS_PER_SECOND
            for frame, pose in frames:
                transform = message.transforms.add(parent_frame_id=frame.parent, child_frame_id=frame.child)
                transform.timestamp.seconds, transform.timestamp.nanos = seconds, nanos
                at, turn = transform.translation, transform.rotation
                (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w) = pose
            yield message

    def _states(self, record: Record) -> list[tuple[int, Sequence[BodyState], bool]]:
        """Return the simulated steps of a record: number, states of bodies, and whether all states are complete."""
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
        current = self._bodies.get((world, loaded.body))
        if current is None or current.model is not model:
            self._bodies[world, loaded.body] = _Body(world, loaded.body, model)

    def _motion(self, world: str, sim_step: int, state: BodyState, *, whole: bool) -> BodyMotion:
        name = state.body
        body = self._bodies.get((world, name))
        if body is None:
            body = self._bodies[world, name] = _Body(world, name, None)
        frames = []
        position, joints = state.position[:], state.joints[:]
        if position:
            x, y, z = position
            i, j, k, w = state.orientation[:]
            frames.append((body.frame, ((x, y, z), (i, j, k, w))))
        values = dict(zip(joints, state.joint_positions[:], strict=True)) if joints else {}
        model = body.model
        if model is not None and (whole or values):
            for joint, frame in body.links(model, model.joints if whole else values):
                frames.append((frame, joint.pose(values.get(joint.name, 0.0))))
        return BodyMotion(sim_step, name, frames, values)


def changed_bodies(record: Mutation | Keyframe, bodies: Mapping[str, LoadBody]) -> tuple[list[str], list[LoadBody]]:
    """Return which ``bodies`` of the record's world are removed or get another model, and the loaded bodies."""
    if isinstance(record, Keyframe):
        models = {name: [asset.sha256 for asset in loaded.assets] for name, loaded in bodies.items()}
        added = [
            loaded for loaded in record.loaded if models.get(loaded.body) != [asset.sha256 for asset in loaded.assets]
        ]
        unchanged = {loaded.body for loaded in record.loaded} - {loaded.body for loaded in added}
        return [name for name in bodies if name not in unchanged], added
    command = record.WhichOneof("command")
    if command == "open_world":  # bodies of a closed world stay until a world with the same name opens
        return list(bodies), []
    added = [record.load_body] if command == "load_body" else []
    removed = {*record.effect.removed, *(loaded.body for loaded in added)}
    return [name for name in bodies if name in removed], added


BASE_COORDINATES: Final = ("x", "y", "yaw")  # coordinates of a base's trajectory in the world, m and rad

STOPPING_STEPS: Final = 36
"""A stopped trajectory slows down for this number of simulated steps (0.15 s).

The number of steps must never change, because recordings are executed again.
"""


def time_of(following: Following, sim_step: int) -> float:
    """Return the time on a trajectory in s at a simulated step. A stopped trajectory slows down evenly."""
    if not following.stopped or sim_step <= following.stopped:
        return (sim_step - following.began) / STEPS_PER_SECOND
    slowing = min(sim_step - following.stopped, STOPPING_STEPS)
    return (following.stopped - following.began + slowing - slowing * slowing / (2 * STOPPING_STEPS)) / STEPS_PER_SECOND


def has_ended(following: Following, sim_step: int) -> bool:
    """Return whether a trajectory is complete or has stopped at a simulated step."""
    if following.stopped and sim_step >= following.stopped + STOPPING_STEPS:
        return True
    times = following.begin.trajectory.times
    return bool(times) and sim_step > following.began and time_of(following, sim_step) >= times[-1]
