"""Bodies in the viewer's 3D scene: their shapes at the recorded poses.

The entity of a link has the link's transform between frames with the names of ``/tf``; the entities below it have the
shapes. If a body is removed, its frames stay, because the viewer needs the path from a frame to the root.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import rerun as rr

from recorder import geometry
from recorder.geometry import Pose, Vector
from recorder.records import Keyframe, LoadBody, Mutation
from recorder.records.motion import ROOT, BodyMotion, Frame, FrameTree, changed_bodies, frame_name
from recorder.records.values import AssetFile
from recorder.urdf import GREY, Color, Shape, Urdf, read_shapes

if TYPE_CHECKING:
    from recorder.viewer.rerun_stream import Columns, Series, TimePoint

BODIES: Final = "bodies"
COLLISION: Final = "collision"
_ROLES: Final = {BODIES: "visual", COLLISION: "collision"}
_COLLISION_COLOR: Final = (0.9, 0.2, 0.9, 0.5)


@dataclass(slots=True)
class _Link:
    """The latest pose of a link, and the buffer of its poses."""

    transforms: Series
    pose: Pose | None = None


@dataclass(slots=True)
class SceneBody:
    """A body in the scene."""

    loaded: LoadBody
    joints: dict[str, float] = field(default_factory=dict)  # positions of joints in rad or m, by name
    color: tuple[float, ...] = ()  # RGBA 0..1; empty for the model's colours
    pose: Pose = geometry.IDENTITY  # pose of the base in the world
    shapes: set[str] = field(default_factory=set)  # paths of the shapes' entities
    links: dict[str, _Link] = field(default_factory=dict)  # links with recorded poses, by name; "" is the base


class ViewerScene:
    """The bodies of all worlds; the names of all frames begin with ``prefix``."""

    def __init__(self, columns: Columns, prefix: str = "") -> None:
        self._columns = columns
        self._prefix = prefix
        self.frames = FrameTree()
        self._files: dict[str, bytes] = {}
        self._transforms: dict[tuple[str, str], Series] = {}  # poses by world and frame, of removed bodies, too
        self._first: TimePoint | None = None
        self.bodies: dict[str, dict[str, SceneBody]] = {}  # the bodies by world and name
        self.robots: dict[str, str] = {}  # names of the controlled robots, by world
        self.absent: dict[str, None] = {}  # missing files, ``<sha256>/<file name>``, one for each body

    def attach(self, asset: AssetFile) -> None:
        """Take an attached file. Models and meshes must precede the records that use them."""
        if asset.name.endswith(".urdf"):
            self.frames.add_urdf(asset.sha256, asset.content)
        self._files[asset.sha256] = asset.content

    def frame(self, world: str, body: str = "", link: str = "") -> str:
        """Return the viewer's name of the frame of a world's root, a body's base or a link."""
        model = self.frames.model(world, body)
        if model is not None and link == model.root:
            link = ""
        return self._prefix + (frame_name(world, body, link) if body else ROOT)

    def pose(self, world: str, body: str, link: str = "") -> Pose | None:
        """Return the current pose of a body's base or link in the world; None if there is none."""
        if not link:
            scene_body = self.bodies.get(world, {}).get(body)
            return scene_body.pose if scene_body is not None else None
        found = self._with_link(world, body, link)
        if found is None:
            return None
        scene_body, model = found
        return geometry.multiply(scene_body.pose, model.forward_kinematics(scene_body.joints, link))

    def _with_link(self, world: str, body: str, link: str) -> tuple[SceneBody, Urdf] | None:
        """Return a body and its model; None if one is missing."""
        scene_body, model = self.bodies.get(world, {}).get(body), self.frames.model(world, body)
        return (scene_body, model) if scene_body is not None and model is not None and link in model.links else None

    def robot(self, world: str, name: str = "") -> tuple[str, SceneBody] | None:
        """Return the robot with the name, or else the controlled robot, or else another robot; None without a robot."""
        bodies = self.bodies.get(world, {})
        for candidate in (name, self.robots.get(world, "")):
            if candidate in bodies:
                return candidate, bodies[candidate]
        return next(((name, body) for name, body in bodies.items() if body.loaded.robot_description), None)

    def centre(self, world: str) -> Vector:
        """Return the mean position of objects and robots in m; the origin in an empty world."""
        bodies = self.bodies.get(world, {}).values()
        positions = [body.pose[0] for body in bodies if body.loaded.robot_description or not body.loaded.fixed_base]
        x, y, z = (sum(position[axis] for position in positions) / max(len(positions), 1) for axis in range(3))
        return x, y, z

    def posture(self, world: str, body: str, link: str, joints: dict[str, float]) -> list[Vector]:
        """Return the positions (m, in the world) of the joints from the first given joint to a link.

        ``joints`` contains positions in rad or m; other joints don't move. Without a model, the list is empty.
        """
        found = self._with_link(world, body, link)
        if found is None:
            return []
        scene_body, model = found
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
        """Return a function from joint positions (rad or m) to a link's point in the base; None without the link."""
        found = self._with_link(world, body, link)
        if found is None:
            return None
        scene_body, model = found

        def position(joints: Mapping[str, float]) -> Vector:
            values = {**scene_body.joints, **joints, **model.followers(joints)}
            return geometry.transform(model.forward_kinematics(values, link), offset)

        return position

    def begin(self, record: Mutation | Keyframe, now: TimePoint) -> None:
        """Show the bodies that a record added or removed. Then call :meth:`move` for the motions of the record."""
        if self._first is None:
            self._first = now
        bodies = self.bodies.get(record.world)
        if bodies is None:
            bodies = self.bodies[record.world] = {}
            self._columns.set_frame(self._columns.path(record.world), self.frame(record.world))
        removed, added = changed_bodies(record, {name: body.loaded for name, body in bodies.items()})
        for name in removed:
            for path in bodies.pop(name).shapes:
                self._columns.clear(path, now)
        for loaded in added:
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
        """Move a body, and return the body; None if there is none."""
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
        """Return the buffer of a frame's poses. The first pose is valid from the beginning of the recording."""
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

    def _mesh(self, name: str) -> bytes | None:
        """Return the content of a mesh. In recorded models, the name of a mesh is ``<sha256>/<file>``."""
        return self._files.get(name.partition("/")[0])

    def shapes(self, world: str, body: str) -> list[Shape]:
        """Return the visual shapes of a body in the frame of its base; [] if it has no model."""
        scene_body, model = self.bodies.get(world, {}).get(body), self.frames.model(world, body)
        content = self._files.get(scene_body.loaded.assets[0].sha256) if scene_body is not None and model else None
        if scene_body is None or model is None or content is None:
            return []
        poses, links = model.link_poses(scene_body.joints), read_shapes(content, "visual")
        return [
            replace(shape, pose=geometry.multiply(poses[link], shape.pose)) for link in links for shape in links[link]
        ]

    def color(self, world: str, body: str) -> tuple[int, int, int]:
        """Return the colour of a body; otherwise the mean colour of its shapes, or grey."""
        own = self.bodies[world][body].color if body in self.bodies.get(world, {}) else ()
        colors = [own] if own else [shape.color for shape in self.shapes(world, body)] or [GREY]
        red, green, blue = (round(255 * sum(color[at] for color in colors) / len(colors)) for at in range(3))
        return red, green, blue

    def ghost(self, world: str, body: str, pose: Pose, color: Color) -> Iterator[tuple[str, list[rr.AsComponents]]]:
        """Yield the entities of a body's shapes at a pose in the world, as :func:`draw` does."""
        shapes = [replace(shape, pose=geometry.multiply(pose, shape.pose)) for shape in self.shapes(world, body)]
        return draw(shapes, self._mesh, color)

    def _draw(self, world: str, body: SceneBody, color: tuple[float, ...], now: TimePoint) -> None:
        loaded = body.loaded
        model = self._files.get(loaded.assets[0].sha256) if loaded.assets else None
        if model is None:
            return
        body.color = color
        for entity, role in _ROLES.items():
            paint: Any = _COLLISION_COLOR if entity == COLLISION else (color or None)
            for link, shapes in read_shapes(model, role).items():
                frame = self.frame(world, loaded.body, link)
                for name, archetypes in draw(shapes, self._mesh, paint):
                    path = self._columns.path(world, entity, loaded.body, link, name)
                    self._columns.set_frame(path, frame)
                    self._columns.send(path, now, *archetypes)
                    body.shapes.add(path)


def _transforms(parent: str, child: str, rows: Sequence[tuple[Any, ...]]) -> rr.ComponentColumnList:
    count = len(rows)
    numbers = chain.from_iterable(chain.from_iterable(rows))  # each row contains one pose
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
    """Yield the entities of a link's shapes: one for all boxes, one for each mesh, and so on.

    Each entity has a name, which is unique within the link, and components. ``meshes`` returns the content of a mesh;
    None for a missing mesh. If ``color`` is None, shapes have the colours of the model.
    """
    for kind in ("box", "cylinder", "sphere", "capsule"):
        alike = [shape for shape in shapes if shape.kind == kind]
        if alike:
            yield kind, [_solids(kind, alike, [color or shape.color for shape in alike])]
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


def _solids(kind: str, shapes: Sequence[Shape], colors: Sequence[Color]) -> rr.AsComponents:
    centers, turns = zip(*(shape.pose for shape in shapes), strict=True)
    sizes = [shape.size for shape in shapes]
    look: dict[str, Any] = {"colors": colors, "fill_mode": "solid"}
    if kind == "box":
        half = [[edge / 2 for edge in size] for size in sizes]
        return rr.Boxes3D(half_sizes=half, centers=centers, quaternions=turns, **look)
    if kind == "sphere":
        return rr.Ellipsoids3D(radii=[radius for (radius,) in sizes], centers=centers, **look)
    radii, lengths = zip(*sizes, strict=True)
    if kind == "cylinder":
        return rr.Cylinders3D(lengths=lengths, radii=radii, centers=centers, quaternions=turns, **look)
    # the viewer's capsules have their origin in the center of the lower cap, capsules of a URDF in their own center
    feet = [geometry.transform(shape.pose, (0.0, 0.0, -shape.size[1] / 2)) for shape in shapes]
    return rr.Capsules3D(lengths=lengths, radii=radii, translations=feet, quaternions=turns, **look)


def table(robot: LoadBody, name: str) -> Mapping[str, Any]:
    """Return a table of a robot's description; an empty table if it is missing."""
    try:
        found = tomllib.loads(robot.robot_description).get(name, {})
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def offset(described: Mapping[str, Any], name: str) -> Pose:
    """Return a described pose in a link; without a description, the pose of the link's frame."""
    found = described.get(name, {})
    x, y, z = found.get("xyz", (0.0, 0.0, 0.0))
    return (x, y, z), geometry.from_rpy(*found.get("rpy", (0.0, 0.0, 0.0)))
