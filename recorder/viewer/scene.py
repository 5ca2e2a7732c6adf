"""Bodies in the viewer's 3D scene: their shapes at the poses that records give.

A link's entity holds its transform, between frames named as on ``/tf``; entities below it hold shapes and name their
frame. What isn't there yet, or no more, has no shapes; but its frames always exist, as the viewer complains of entities
without a path to the root.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import rerun as rr

from recorder import geometry
from recorder.records import Keyframe
from recorder.records.motion import ROOT, FrameTree, frame_name
from recorder.urdf import read_shapes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from recorder.geometry import Pose, Vector
    from recorder.records import LoadBody, Mutation
    from recorder.records.motion import BodyMotion, Frame
    from recorder.records.values import AssetFile
    from recorder.urdf import Color, Shape
    from recorder.viewer.rerun_stream import Columns, Series, TimePoint


BODIES: Final = "bodies"
COLLISION: Final = "collision"
_ROLES: Final = {BODIES: "visual", COLLISION: "collision"}
_COLLISION_COLOR: Final = (0.9, 0.2, 0.9, 0.5)


@dataclass(slots=True)
class _Link:
    """A link's latest pose, and the buffer of its poses."""

    transforms: Series
    pose: Pose | None = None


@dataclass(slots=True)
class SceneBody:
    """A body in the scene."""

    loaded: LoadBody  # how it was loaded
    joints: dict[str, float] = field(default_factory=dict)  # positions in rad or m by name
    pose: Pose = geometry.IDENTITY  # of its base in the world
    shapes: set[str] = field(default_factory=set)  # paths of its shapes' entities
    links: dict[str, _Link] = field(default_factory=dict)  # those that records gave poses for, by name; "" is its base


class ViewerScene:
    """The bodies of all worlds; the names of all frames begin with a prefix."""

    def __init__(self, columns: Columns, prefix: str = "") -> None:
        self._columns = columns
        self._prefix = prefix
        self._frames = FrameTree()
        self._files: dict[str, bytes] = {}
        self._transforms: dict[tuple[str, str], Series] = {}  # by world and frame; also of bodies that are gone
        self._first: TimePoint | None = None
        self.bodies: dict[str, dict[str, SceneBody]] = {}  # by world, then name
        self.robots: dict[str, str] = {}  # names of those that plans control, by world
        #: Files that bodies are made of and that were not attached, as ``<sha256>/<file name>``; one a body.
        self.absent: dict[str, None] = {}

    def attach(self, asset: AssetFile) -> None:
        """Takes a model or mesh, before the records that use it, or anything else."""
        if asset.name.endswith(".urdf"):
            self._frames.add_urdf(asset.sha256, asset.content)
        self._files[asset.sha256] = asset.content

    def frame(self, world: str, body: str = "", link: str = "") -> str:
        """Name of a frame in the viewer: of the world's root, a body's base or one of its links."""
        model = self._frames.model(world, body)
        if model is not None and link == model.root:
            link = ""
        return self._prefix + (frame_name(world, body, link) if body else ROOT)

    def pose(self, world: str, body: str, link: str = "") -> Pose | None:
        """Current pose of a body's base or link in the world; None if there is no such thing."""
        scene_body = self.bodies.get(world, {}).get(body)
        if scene_body is None or not link:
            return scene_body.pose if scene_body is not None else None
        model = self._frames.model(world, body)
        if model is None or link not in model.links:
            return None
        return geometry.multiply(scene_body.pose, model.forward_kinematics(scene_body.joints, link))

    def robot(self, world: str, name: str = "") -> tuple[str, SceneBody] | None:
        """The robot of that name, else the one that plans control, else any; None if the world has none."""
        bodies = self.bodies.get(world, {})
        for candidate in (name, self.robots.get(world, "")):
            if candidate in bodies:
                return candidate, bodies[candidate]
        return next(((name, body) for name, body in bodies.items() if body.loaded.robot_description), None)

    def centre(self, world: str) -> Vector:
        """Mean position of objects and robots in m; the origin if there are none."""
        bodies = self.bodies.get(world, {}).values()
        positions = [body.pose[0] for body in bodies if body.loaded.robot_description or not body.loaded.fixed_base]
        x, y, z = (sum(position[axis] for position in positions) / max(len(positions), 1) for axis in range(3))
        return x, y, z

    def posture(self, world: str, body: str, link: str, joints: dict[str, float]) -> list[Vector]:
        """Points in the world, in m, of the joints from the first of the given ones (rad or m) to a link.

        The other joints are as they are; there are no points without a model.
        """
        scene_body, model = self.bodies.get(world, {}).get(body), self._frames.model(world, body)
        if scene_body is None or model is None or link not in model.links:
            return []
        points: list[Vector] = []
        pose, values = scene_body.pose, scene_body.joints | joints
        for joint in model.chain(model.root, link):
            pose = geometry.multiply(pose, joint.pose(values.get(joint.name, 0.0)))
            if points or joint.name in joints:
                points.append(pose[0])
        return points

    def link_position(
        self, world: str, body: str, link: str, offset: Vector
    ) -> Callable[[Mapping[str, float]], Vector] | None:
        """What gives where a point of a link is in its body's base, in m; None without a model that has the link.

        It takes positions of joints in rad or m; the other joints are as they are when it is called.
        """
        scene_body, model = self.bodies.get(world, {}).get(body), self._frames.model(world, body)
        if scene_body is None or model is None or link not in model.links:
            return None

        def position(joints: Mapping[str, float]) -> Vector:
            values = {**scene_body.joints, **joints, **model.followers(joints)}
            return geometry.transform(model.forward_kinematics(values, link), offset)

        return position

    def motions(self, record: Mutation | Keyframe) -> list[BodyMotion]:
        """What a record moved, in the order of simulated time; also takes the models of what it adds."""
        return self._frames.motions(record)

    def begin(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        """Shows which bodies a record added or removed; what it moved comes after that."""
        if self._first is None:
            self._first = now
        bodies = self.bodies.get(record.world)
        if bodies is None:
            bodies = self.bodies[record.world] = {}
            self._columns.set_frame(self._columns.path(record.world), self.frame(record.world))
        for name in _removed(record, bodies):
            for path in bodies.pop(name).shapes:
                self._columns.clear(path, now)
        for loaded in _added(record, bodies):
            bodies[loaded.body] = self._load(record.world, loaded, now)
        if isinstance(record, Keyframe):
            self.robots[record.world] = record.robot
        elif record.HasField("restore"):
            self.robots[record.world] = record.restore.robot
        elif record.HasField("set_robot"):
            self.robots[record.world] = record.set_robot.body
        elif record.HasField("set_color") and record.set_color.body in bodies:
            self._draw(record.world, bodies[record.set_color.body], tuple(record.set_color.color), now)

    def move(self, world: str, motion: BodyMotion, now: TimePoint) -> SceneBody | None:
        """Moves a body, and returns it; None if it isn't there."""
        body = self.bodies[world].get(motion.body)
        if body is None:
            return None
        for frame, pose in motion.frames:
            name = frame.link
            link = body.links.get(name)
            if link is None:
                link = body.links[name] = _Link(self._transforms_of(world, frame, pose))
            if link.pose != pose:
                link.pose = pose
                link.transforms.add(now, pose)
            if not name:
                body.pose = pose
        if motion.joints:
            body.joints.update(motion.joints)
        return body

    def _transforms_of(self, world: str, frame: Frame, pose: Pose) -> Series:
        """The buffer of a frame's poses; the first one holds from the beginning on."""
        transforms = self._transforms.get((world, frame.child))
        if transforms is None:
            path = self._columns.path(world, BODIES, frame.body, *([frame.link] if frame.link else []))
            maker = partial(_transforms, self._prefix + frame.parent, self._prefix + frame.child)
            transforms = self._transforms[world, frame.child] = self._columns.series(path, maker)
            if self._first is not None:
                transforms.add(self._first, pose)
        return transforms

    def _load(self, world: str, loaded: LoadBody, now: TimePoint) -> SceneBody:
        body = SceneBody(loaded)
        if loaded.position:
            x, y, z = loaded.position
            i, j, k, w = loaded.orientation or geometry.IDENTITY[1]
            body.pose = ((x, y, z), (i, j, k, w))
        for asset in loaded.assets:
            if asset.sha256 not in self._files:
                self.absent[f"{asset.sha256}/{PurePath(asset.path).name}"] = None
                break
        self._draw(world, body, tuple(loaded.color), now)
        return body

    def _draw(self, world: str, body: SceneBody, color: tuple[float, ...], now: TimePoint) -> None:
        loaded = body.loaded
        model = self._files.get(loaded.assets[0].sha256) if loaded.assets else None
        if model is None:
            return
        for entity, role in _ROLES.items():
            paint: Any = _COLLISION_COLOR if entity == COLLISION else (color or None)
            for link, shapes in read_shapes(model, role).items():
                frame = self.frame(world, loaded.body, link)
                for name, archetypes in draw(shapes, self._mesh, paint):
                    path = self._columns.path(world, entity, loaded.body, link, name)
                    self._columns.set_frame(path, frame)
                    self._columns.send(path, now, *archetypes)
                    body.shapes.add(path)

    def _mesh(self, name: str) -> bytes | None:
        """The content of a mesh; models in recordings name it ``<sha256>/<file>``."""
        return self._files.get(name.partition("/")[0])


def _removed(record: Mutation | Keyframe, bodies: Mapping[str, SceneBody]) -> list[str]:
    """Names of bodies that are no more, or have another model than before."""
    if isinstance(record, Keyframe):
        unchanged = {loaded.body for loaded in record.loaded if _is_same(bodies.get(loaded.body), loaded)}
        return [name for name in bodies if name not in unchanged]
    command = record.WhichOneof("command")
    if command == "open_world":  # what a world had when it was closed is shown on: there is nothing more to see
        return list(bodies)
    removed = {*record.effect.removed, record.load_body.body} if command == "load_body" else record.effect.removed
    return [name for name in removed if name in bodies]


def _added(record: Mutation | Keyframe, bodies: Mapping[str, SceneBody]) -> list[LoadBody]:
    if isinstance(record, Keyframe):
        return [loaded for loaded in record.loaded if loaded.body not in bodies]
    return [record.load_body] if record.WhichOneof("command") == "load_body" else []


def _is_same(body: SceneBody | None, loaded: LoadBody) -> bool:
    return body is not None and [asset.sha256 for asset in body.loaded.assets] == [
        asset.sha256 for asset in loaded.assets
    ]


def _transforms(parent: str, child: str, rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    count = len(rows)
    numbers = chain.from_iterable(chain.from_iterable(rows))  # each row is a pose
    poses = np.fromiter(numbers, np.float32, 7 * count).reshape(-1, 7)
    return rr.Transform3D.columns(
        translation=poses[:, :3],
        quaternion=poses[:, 3:],
        parent_frame=pa.repeat(parent, count),
        child_frame=pa.repeat(child, count),
    )


_MEDIA_TYPES: Final = {"stl": "model/stl", "obj": "model/obj"}


def draw(
    shapes: Sequence[Shape], meshes: Callable[[str], bytes | None], color: Color | None
) -> Iterator[tuple[str, list[rr.AsComponents]]]:
    """Draw a link's shapes: one entity for all boxes, one for all cylinders, one for each mesh.

    ``meshes`` gives a mesh's content, None if it is not known; without a color of the body, shapes have their own.
    Yields names, unique within the link, and what is shown there.
    """
    for kind, solids in _SOLIDS.items():
        alike = [shape for shape in shapes if shape.kind == kind]
        if alike:
            yield kind, [solids(alike, [color or shape.color for shape in alike])]
    number = 0
    for shape in shapes:
        content = meshes(shape.mesh) if shape.kind == "mesh" else None
        if content is not None:
            media = _MEDIA_TYPES[shape.mesh.rpartition(".")[2].lower()]
            asset = rr.Asset3D(contents=content, media_type=media, albedo_factor=color or shape.color)
            position, orientation = shape.pose
            pose = rr.InstancePoses3D(translations=[position], quaternions=[orientation], scales=[shape.size])
            yield f"mesh_{number}", [asset, pose]
            number += 1


def _boxes(shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    half = [[edge / 2 for edge in shape.size] for shape in shapes]
    centers, turns = zip(*(shape.pose for shape in shapes), strict=True)
    return rr.Boxes3D(half_sizes=half, centers=centers, quaternions=turns, colors=colors, fill_mode="solid")


def _cylinders(shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    centers, turns = zip(*(shape.pose for shape in shapes), strict=True)
    radii, lengths = zip(*(shape.size for shape in shapes), strict=True)
    return rr.Cylinders3D(
        lengths=lengths, radii=radii, centers=centers, quaternions=turns, colors=colors, fill_mode="solid"
    )


def _spheres(shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    radii, centers = [shape.size[0] for shape in shapes], [shape.pose[0] for shape in shapes]
    return rr.Ellipsoids3D(radii=radii, centers=centers, colors=colors, fill_mode="solid")


def _capsules(shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    """The viewer's capsules begin at their origin and have no length of their caps; a URDF's are centred."""
    radii, lengths = zip(*(shape.size for shape in shapes), strict=True)
    turns = [shape.pose[1] for shape in shapes]
    feet = [geometry.transform(shape.pose, (0.0, 0.0, -shape.size[1] / 2)) for shape in shapes]
    return rr.Capsules3D(
        lengths=lengths, radii=radii, translations=feet, quaternions=turns, colors=colors, fill_mode="solid"
    )


_SOLIDS: Final = {"box": _boxes, "cylinder": _cylinders, "sphere": _spheres, "capsule": _capsules}


def table(robot: LoadBody, name: str) -> Mapping[str, Any]:
    """A table of a robot's description; empty if there is none."""
    try:
        found = tomllib.loads(robot.robot_description).get(name, {})
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def offset(described: Mapping[str, Any], name: str) -> Pose:
    """A described pose in a link; by default the link's own."""
    found = described.get(name, {})
    x, y, z = found.get("xyz", (0.0, 0.0, 0.0))
    return (x, y, z), geometry.from_rpy(*found.get("rpy", (0.0, 0.0, 0.0)))
