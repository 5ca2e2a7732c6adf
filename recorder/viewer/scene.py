"""Bodies in the viewer's 3D scene: their shapes where they are, as the records say it.

A link's entity holds its transform, between frames named as on ``/tf``; entities below it hold shapes and name their
frame. What isn't there yet, or no more, has no shapes; but its frames are there at any time, as the viewer complains of
entities that have no way to the root.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import rerun as rr

from recorder import geometry
from recorder.geometry.shapes import read_shapes
from recorder.records import Keyframe
from recorder.records.frames import ROOT, frame_name
from recorder.viewer.shapes import drawn

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from recorder.geometry import Pose, Vector
    from recorder.records import LoadBody, Mutation
    from recorder.records.asset import AssetFile
    from recorder.records.frames import Frame, FrameTree, Moved
    from recorder.viewer.columns import Columns, Moment, Series

BODIES: Final = "bodies"
COLLISION: Final = "collision"
_ROLES: Final = {BODIES: "visual", COLLISION: "collision"}
_UNSEEN: Final = (0.9, 0.2, 0.9, 0.5)  # of collision shapes


@dataclass(slots=True)
class _Link:
    """Where a link was last, and where its poses are gathered."""

    moves: Series
    pose: Pose | None = None


@dataclass(slots=True)
class Body:
    """A body that is there.

    Attributes:
        loaded: how it was loaded.
        joints: values in rad or m by name.
        pose: of its base in the world.
        shapes: paths of the entities of its shapes.
        links: those that were told of, by name; "" is its base.
    """

    loaded: LoadBody
    joints: dict[str, float] = field(default_factory=dict)
    pose: Pose = geometry.IDENTITY
    shapes: set[str] = field(default_factory=set)
    links: dict[str, _Link] = field(default_factory=dict)


class Scene:
    """All worlds' bodies.

    Args:
        columns: where it goes.
        frames: what is known of bodies' links.
        prefix: before the names of all frames.

    Attributes:
        bodies: by world, then name.
        robots: names of those that plans control, by world.
        absent: files that bodies are made of and that were not attached, as ``<sha256>/<file name>``; one a body.
    """

    def __init__(self, columns: Columns, frames: FrameTree, prefix: str = "") -> None:
        self._columns = columns
        self._prefix = prefix
        self._frames = frames
        self._files: dict[str, bytes] = {}
        self._moves: dict[tuple[str, str], Series] = {}  # of links' entities, by world and frame; of all that ever were
        self._begin: Moment | None = None
        self.bodies: dict[str, dict[str, Body]] = {}
        self.robots: dict[str, str] = {}
        self.absent: dict[str, None] = {}

    def attach(self, asset: AssetFile) -> None:
        """Takes a model or mesh."""
        self._files[asset.sha256] = asset.content

    def frame(self, world: str, body: str = "", link: str = "") -> str:
        """The name of a frame in the viewer.

        Args:
            world: name of the world.
            body: name of a body; "" for the root.
            link: name of a link; "" for the body's base.
        """
        model = self._frames.model(world, body)
        if model is not None and link == model.root:
            link = ""
        return self._prefix + (frame_name(world, body, link) if body else ROOT)

    def pose(self, world: str, body: str, link: str = "") -> Pose | None:
        """Where a body or link is now; None if there is no such thing.

        Args:
            world: name of the world.
            body: name of the body.
            link: name of the link; "" for the base.
        """
        found = self.bodies.get(world, {}).get(body)
        if found is None or not link:
            return found.pose if found is not None else None
        model = self._frames.model(world, body)
        if model is None or link not in model.links:
            return None
        return geometry.multiply(found.pose, model.forward_kinematics(found.joints, link))

    def middle(self, world: str) -> Vector:
        """Where things and robots are on average, m; the origin if there are none.

        Args:
            world: name of the world.
        """
        bodies = self.bodies.get(world, {}).values()
        places = [body.pose[0] for body in bodies if body.loaded.robot_description or not body.loaded.fixed_base]
        x, y, z = (sum(place[axis] for place in places) / max(len(places), 1) for axis in range(3))
        return x, y, z

    def posture(self, world: str, body: str, link: str, joints: dict[str, float]) -> list[Vector]:
        """Where the joints that lead to a link would be.

        Args:
            world: name of the world.
            body: name of the body.
            link: name of the link.
            joints: values of some joints in rad or m; the others are as they are.

        Returns:
            Points in the world in m, from the first of these joints out to the link; empty if nothing is known of it.
        """
        found, model = self.bodies.get(world, {}).get(body), self._frames.model(world, body)
        if found is None or model is None or link not in model.links:
            return []
        points: list[Vector] = []
        pose, values = found.pose, found.joints | joints
        for joint in model.chain(model.root, link):
            pose = geometry.multiply(pose, joint.pose(values.get(joint.name, 0.0)))
            if points or joint.name in joints:
                points.append(pose[0])
        return points

    def begin(self, record: Mutation | Keyframe, now: Moment) -> None:
        """Shows what a record brought or took away, before what it moved is told.

        Args:
            record: the record.
            now: when.
        """
        if self._begin is None:
            self._begin = now
        there = self.bodies.get(record.world)
        if there is None:
            there = self.bodies[record.world] = {}
            self._columns.stand(self._columns.path(record.world), self.frame(record.world))
        for name in _gone(record, there):
            self._remove(there.pop(name), now)
        for loaded in _came(record, there):
            there[loaded.body] = self._load(record.world, loaded, now)
        if isinstance(record, Keyframe):
            self.robots[record.world] = record.robot
        elif record.HasField("set_robot"):
            self.robots[record.world] = record.set_robot.body
        elif record.HasField("set_color"):
            self._paint(record.world, record.set_color.body, tuple(record.set_color.color), now)

    def move(self, world: str, moved: Moved, now: Moment) -> Body | None:
        """Shows what was told of a body.

        Args:
            world: name of the world.
            moved: what was told.
            now: when.

        Returns:
            The body; None if it isn't there.
        """
        body = self.bodies[world].get(moved.body)
        if body is None:
            return None
        for frame, pose in moved.frames:
            name = frame.link
            link = body.links.get(name)
            if link is None:
                link = body.links[name] = _Link(self._moves_of(world, frame, pose))
            if link.pose != pose:
                link.pose = pose
                link.moves.add(now, pose)
            if not name:
                body.pose = pose
        if moved.joints:
            body.joints.update(moved.joints)
        return body

    def _moves_of(self, world: str, frame: Frame, pose: Pose) -> Series:
        """Where a frame's poses are gathered; the first one holds from the beginning on."""
        moves = self._moves.get((world, frame.child))
        if moves is None:
            path = self._columns.path(world, BODIES, frame.body, *([frame.link] if frame.link else []))
            maker = partial(_transforms, self._prefix + frame.parent, self._prefix + frame.child)
            moves = self._moves[world, frame.child] = self._columns.series(path, maker)
            if self._begin is not None:
                moves.add(self._begin, pose)
        return moves

    def _load(self, world: str, loaded: LoadBody, now: Moment) -> Body:
        body = Body(loaded)
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

    def _draw(self, world: str, body: Body, color: tuple[float, ...], now: Moment) -> None:
        loaded = body.loaded
        model = self._files.get(loaded.assets[0].sha256) if loaded.assets else None
        if model is None:
            return
        for place, role in _ROLES.items():
            paint: Any = _UNSEEN if place == COLLISION else (color or None)
            for link, shapes in read_shapes(model, role).items():
                frame = self.frame(world, loaded.body, link)
                for name, archetypes in drawn(shapes, self._mesh, paint):
                    path = self._columns.path(world, place, loaded.body, link, name)
                    self._columns.stand(path, frame)
                    self._columns.put(path, now, *archetypes)
                    body.shapes.add(path)

    def _mesh(self, name: str) -> bytes | None:
        """The content of a mesh; models in recordings name it ``<sha256>/<file>``."""
        return self._files.get(name.partition("/")[0])

    def _paint(self, world: str, name: str, color: tuple[float, ...], now: Moment) -> None:
        body = self.bodies[world].get(name)
        if body is not None:
            self._draw(world, body, color, now)

    def _remove(self, body: Body, now: Moment) -> None:
        for path in body.shapes:
            self._columns.clear(path, now)


def _gone(record: Mutation | Keyframe, there: Mapping[str, Body]) -> list[str]:
    """Names of bodies that are no more, or are others than before."""
    if isinstance(record, Keyframe):
        kept = {loaded.body for loaded in record.loaded if _same(there.get(loaded.body), loaded)}
        return [name for name in there if name not in kept]
    command = record.WhichOneof("command")
    if command == "open_world":  # what a world had when it was closed is shown on: there is nothing more to see
        return list(there)
    lost = {*record.effect.removed, record.load_body.body} if command == "load_body" else record.effect.removed
    return [name for name in lost if name in there]


def _came(record: Mutation | Keyframe, there: Mapping[str, Body]) -> list[LoadBody]:
    """What was loaded and isn't there yet."""
    if isinstance(record, Keyframe):
        return [loaded for loaded in record.loaded if loaded.body not in there]
    return [record.load_body] if record.WhichOneof("command") == "load_body" else []


def _same(body: Body | None, loaded: LoadBody) -> bool:
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
