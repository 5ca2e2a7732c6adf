"""Pictures of a step, without a viewer and without the physics engine: our rasterizer draws the recorded state.

A picture shows the view of a robot's camera, from a given point, or from a viewpoint with a clear view of a target. The
target is an object or a link, by default the robot and the movable objects. Viewpoints are rated by the visible share
of an object's pixels in a window around the object, so small objects count as much as large ones. If no viewpoint has a
clear view, the furniture and walls in front of the target are cut away.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pycram.foundation.failures import PycramError
from recorder import geometry
from recorder.geometry import Pose, Quaternion, Vector
from recorder.packages import needed
from replay.errors import Damaged, NoSuchName, ReplayError
from replay.explain.why import Why, why
from replay.file.record_reader import RecordReader
from replay.state.state import Body

with needed("render"):
    from PIL import Image

    from pycram.models.shapes import shapes_of
    from pycram.vision import Camera, Drawable, Rendering, Window, drawable_link
    from replay.restore.recorded_world import description_of, model_of, world_state

_FIELD_OF_VIEW: Final = math.radians(60)  # default horizontal field of view of a camera
_NEAR, _FAR = 0.02, 30.0  # nearest and farthest distance in m that a camera sees
_OVERSAMPLING: Final = 2  # number of pixels per side of which a pixel's colour is the mean, for smooth edges
_SIZE: Final = (640, 480)  # default width and height of a picture in pixels
_MAX_SIDE: Final = 4096  # largest width and height in pixels
_SURROUNDINGS: Final = 0.7  # a picture shows at least this much of the scene in m, even around a small object
#: Directions from the target to the viewpoint in the robot's frame, by the side that the caller requests.
SIDES: Final[dict[str, tuple[Vector, ...]]] = {
    "behind": ((-0.85, 0.0, 0.5), (-0.95, 0.0, 0.2), (-0.6, 0.0, 0.8)),
    "right": ((0.0, -0.85, 0.5), (0.0, -0.95, 0.2), (0.0, -0.6, 0.8)),
    "left": ((0.0, 0.85, 0.5), (0.0, 0.95, 0.2), (0.0, 0.6, 0.8)),
    "front": ((0.85, 0.0, 0.5), (0.95, 0.0, 0.2), (0.6, 0.0, 0.8)),
    "above": ((-0.02, 0.0, 1.0),),
}
#: The first directions if the caller requests no side: over the robot's shoulders, and from the front.
_PREFERRED: Final = (
    (-0.55, -0.65, 0.55),
    (-0.55, 0.65, 0.55),
    (0.55, -0.65, 0.55),
    (0.55, 0.65, 0.55),
    (-0.4, 0.0, 0.9),
)
_CLOSER: Final = 0.6  # share of the distance at which viewpoints may be within the walls of a room
_ENOUGH: Final = 0.7  # a viewpoint that shows at least this share of the pixels is taken without comparing others
_TOO_LITTLE: Final = 0.3  # below this visible share of the pixels, the links that hide the target are cut away
_ROBOT_SHARE: Final = 0.4  # visible share of a robot's pixels that is enough, because objects hide the robot
_RATED: Final = 3  # number of moments of a film that are used to rate viewpoints
_GLANCE: Final = (40, 40)  # size in pixels of the window around an object
_MAX_CUTS: Final = 6  # maximum number of layers of furniture and walls that are cut away
_ROOM: Final = 1.5  # size in m below which a fixed link is furniture, so that no viewpoint is inside it
_CUT_GAP: Final = 0.02  # distance in m between a cut and the visible object
_CORNERS: Final = np.array([[(number >> axis) & 1 for axis in range(3)] for number in range(8)])


@dataclass(frozen=True, slots=True)
class _DrawnBody:
    """A body, with the poses of its links in the world."""

    body: Body
    frames: Mapping[str, Pose]
    parts: Mapping[str, int]  # numbers of the links with shapes, by name of the link


class DrawnWorld:
    """The bodies of a world after a step or at a moment (:func:`world_state`), for pictures.

    Raises:
        NotRestored: No world is open.
        Damaged: Records or files are lost or invalid.
    """

    def __init__(self, log: RecordReader, step: int, world: str | None = None, moment: float | None = None) -> None:
        state = world_state(log, step, world, moment)
        self._step = step
        self._bodies: dict[str, _DrawnBody] = {}
        self.parts: list[DrawnLink] = []
        try:
            for body in state.bodies.values():
                self._add(log, body)
        except (PycramError, ValueError) as error:
            raise Damaged(log.path, f"the world after step {step}", str(error)) from error
        self._robot = self._bodies.get(state.robot)

    def _add(self, log: RecordReader, body: Body) -> None:
        model = model_of(log, body.loaded)
        poses = model.urdf.link_poses(body.joints).items()
        frames = {link: geometry.multiply(body.pose, pose) for link, pose in poses}
        shapes = shapes_of(model.path)
        first = len(self.parts)
        self.parts += [
            DrawnLink(drawable_link(shapes, at, frames[link], body.color or None, is_robot=body.type == "robot"), fixed)
            for at, link in enumerate(shapes.links)
            for fixed in [body.type == "environment"]
        ]
        self._bodies[body.name] = _DrawnBody(body, frames, {link: first + at for at, link in enumerate(shapes.links)})

    @property
    def camera(self) -> str:
        """The frame of the robot's camera; "" if there is none."""
        description = description_of(self._robot.body.loaded.robot_description) if self._robot else None
        return description.camera.frame if description and description.camera else ""

    def picture(
        self,
        *,
        camera: str | None = None,
        eye: Sequence[float] | str | None = None,
        target: Sequence[float] | str | Sequence[str] | None = None,
        size: tuple[int, int] = _SIZE,
    ) -> Image.Image:
        """Return a picture of the world.

        If no viewpoint shows the target, furniture and walls in front are cut away. ``info`` of the picture has the
        "step", and the names of the cut links ("cut").

        Args:
            camera: A frame of the robot, such as "wide_stereo_optical_frame". A camera of the robot also determines the
                field of view and the range.
            eye: A viewpoint, xyz in m, or a side of the robot (:data:`SIDES`). By default, the viewpoint has a clear
                view.
            target: The middle of the picture: a point, xyz in m; an object; a link such as "kitchen.sink_area"; or
                several objects and links. By default, the target is the robot and the movable objects.
            size: Width and height, up to 4096 pixels each.

        Raises:
            NoSuchName: There is no such frame, object, link or side.
            ReplayError: The size or a point is impossible.
        """
        _check_size(size)
        own = None if camera is None else self._robot_camera(camera, size)
        view = self.view([self], eye, target, size) if own is None else CutawayView(own)
        cut = [name for name, at in self.numbers.items() if at in view.cut]
        return self.finished(self.draw(view, size).picture(view.camera.up), size, cut)

    def view(
        self,
        worlds: Sequence[DrawnWorld],
        eye: Sequence[float] | str | None,
        target: Sequence[float] | str | Sequence[str] | None,
        size: tuple[int, int],
        *,
        cuts: bool = True,
    ) -> CutawayView:
        """Return a view that shows a target in all given worlds; walls that hide the target here may be cut away."""
        subject, point = self.subject(target)
        scenes = []
        for world in [world for world in worlds if world.movable] or worlds:
            with suppress(NoSuchName):  # the target isn't loaded yet in this world
                scenes.append((world.parts, world.subject(target)[0]))
        corners = [bounds(*scene) for scene in scenes]
        low, high = np.min([low for low, _ in corners], axis=0), np.max([high for _, high in corners], axis=0)
        aim = _vector((low + high) / 2) if point is None else point
        if eye is not None and not isinstance(eye, str):
            viewpoint = _point("eye", eye)
            if math.dist(viewpoint, aim) < 1e-6:
                raise ReplayError(f"a picture from {list(viewpoint)} to the same point has no direction")
            return CutawayView(_pinhole((viewpoint, geometry.look_at(viewpoint, aim)), _FIELD_OF_VIEW, size))
        if eye is not None and eye not in SIDES:
            raise NoSuchName("side of the robot", eye, SIDES)
        heading = self._robot.body.orientation if self._robot else (0.0, 0.0, 0.0, 1.0)
        distance = 1.1 * max(_SURROUNDINGS if subject.every else 1.0, float(np.linalg.norm(high - low)))
        cameras = [
            _pinhole((viewpoint, geometry.look_at(viewpoint, aim)), _FIELD_OF_VIEW, size)
            for viewpoint in viewpoints(aim, distance, heading, eye)
        ]
        return free_view(cameras, [*scenes[: -1 : max(1, len(scenes) // _RATED)], (self.parts, subject)], cuts=cuts)

    def subjects(self, why: Why) -> list[str] | None:
        """Return the robot and the objects of a failed task as targets of a picture; None if there are none.

        Targets of furniture are the links that the task names, such as the handle of a drawer.
        """
        named = why.task.motion.parameters.values() if why.task is not None else ()
        targets: list[str] = []
        for involved in sorted(why.bodies, key=lambda involved: not involved.is_robot):
            drawn = self._bodies.get(involved.body.name)
            if drawn is None or not drawn.parts:
                continue
            if drawn.body.type != "environment":
                targets.append(drawn.body.name)
            else:
                links = [link for link in named if isinstance(link, str) and link in drawn.frames]
                targets += [f"{drawn.body.name}.{link}" for link in links]
        return targets or None

    def draw(self, view: CutawayView, size: tuple[int, int], numbers: Iterable[int] | None = None) -> Rendering:
        """Draw parts by number, by default all parts, with more pixels than the picture has."""
        return view.draw(self.parts, view.camera.window, (size[0] * _OVERSAMPLING, size[1] * _OVERSAMPLING), numbers)

    def finished(self, image: NDArray[np.uint8], size: tuple[int, int], cut: Iterable[str]) -> Image.Image:
        """Return a picture of the given size, made from an image with more pixels."""
        picture = Image.fromarray(image).resize(size, Image.Resampling.BOX)
        picture.info |= {"step": self._step, "cut": tuple(cut)}
        return picture

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Numbers of the drawn links by name, such as "kitchen.sink_area"."""
        return {f"{name}.{link}": at for name, drawn in self._bodies.items() for link, at in drawn.parts.items()}

    @cached_property
    def looks(self) -> dict[str, tuple[object, ...]]:
        """The data that determine the appearance of each drawn link."""
        return {
            f"{name}.{link}": (drawn.body.models, drawn.body.color, drawn.frames[link])
            for name, drawn in self._bodies.items()
            for link in drawn.parts
        }

    @property
    def movable(self) -> list[_DrawnBody]:
        """The robots and the objects that robots handle."""
        return [drawn for drawn in self._bodies.values() if drawn.body.type != "environment"]

    def subject(self, target: Sequence[float] | str | Sequence[str] | None) -> tuple[PictureSubject, Vector | None]:
        """Return the subject of a picture of a target, and the target if it is a point; raise NoSuchName if unknown."""
        names = [target] if isinstance(target, str) else list(target or ())
        if names and all(isinstance(name, str) for name in names):
            return PictureSubject(tuple(self._parts_of(str(name)) for name in names), every=True), None
        groups = (tuple(drawn.parts.values()) for drawn in self.movable or self._bodies.values())
        point = _point("target", target) if target is not None else None  # type: ignore[arg-type]
        return PictureSubject(tuple(group for group in groups if group), every=False), point

    def _parts_of(self, name: str) -> tuple[int, ...]:
        """Return the numbers of the drawn links of ``BODY`` or ``BODY.LINK``. A link without shapes means the body."""
        drawn = self._bodies.get(name)
        if drawn is not None:
            return tuple(drawn.parts.values())
        body = next((body for body in self._bodies if name.startswith(f"{body}.")), None)
        if body is None:
            raise NoSuchName("object", name, self._bodies)
        drawn, link = self._bodies[body], name[len(body) + 1 :]
        if link not in drawn.frames:
            raise NoSuchName(f"link of {body}", link, drawn.frames)
        return (drawn.parts[link],) if link in drawn.parts else tuple(drawn.parts.values())

    def _robot_camera(self, frame: str, size: tuple[int, int]) -> Camera:
        if self._robot is None:
            raise NoSuchName("robot with a camera", frame, ())
        if frame not in self._robot.frames:
            raise NoSuchName(f"frame of {self._robot.body.name}", frame, self._robot.frames)
        description = description_of(self._robot.body.loaded.robot_description)
        own = description.camera if description else None
        if own is None or own.frame != frame:
            return _pinhole(self._robot.frames[frame], _FIELD_OF_VIEW, size)
        return _pinhole(own.pose(self._robot.frames[frame]), own.horizontal_fov, size, max(own.near, _NEAR), own.far)


def film(
    worlds: Sequence[DrawnWorld],
    *,
    eye: Sequence[float] | str | None = None,
    target: Sequence[float] | str | Sequence[str] | None = None,
    size: tuple[int, int] = _SIZE,
) -> Iterator[Image.Image]:
    """Yield pictures of several moments, all from one viewpoint that has a clear view at the last moment.

    Links that look the same at all moments are drawn only once, so a film is much faster than single pictures.
    :meth:`DrawnWorld.picture` describes the arguments and errors.
    """
    _check_size(size)
    first, last = worlds[0], worlds[-1]
    view = last.view(worlds, eye, target, size)
    cut = [name for name, at in last.numbers.items() if at in view.cut]
    still = {name for name, place in first.looks.items() if all(each.looks.get(name) == place for each in worlds)}

    def draw(world: DrawnWorld, names: Iterable[str]) -> Rendering:
        there = frozenset(at for name, at in world.numbers.items() if name in cut)
        return world.draw(replace(view, cut=there), size, [world.numbers[name] for name in names])

    standing, up = draw(first, sorted(still)), view.camera.up
    behind = standing.picture(up)
    for world in worlds:
        moved = draw(world, sorted(world.numbers.keys() - still))
        yield world.finished(moved.picture_before(behind, standing.depth, up), size, cut)


def write_pictures(log: RecordReader, why: Why, folder: Path) -> list[Path]:
    """Write pictures of an explained failure; return their files. After an error, raise ReplayError."""
    files = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not why.bodies:
            return []
        scene = DrawnWorld(log, why.step, why.world.name if why.world is not None else None)
        about = scene.subjects(why)
        views: list[tuple[str, dict[str, Any]]] = [("robot", {"camera": scene.camera})] if scene.camera else []
        views.append(("side", {"target": about}))  # the robot is large, so this picture is from far away
        views += [(name, {"target": name}) for name in (about or ())[1:]]
        for name, view in views:
            part = re.sub(r"[^\w.-]", "_", name)  # characters that file names may contain
            files.append(folder / f"step_{why.step}_{part}.png")
            scene.picture(**view).save(files[-1])
    except OSError as error:
        raise ReplayError(f"{folder}: {error.strerror or error}") from error
    return files


def failure_view(log: RecordReader, step: int | None = None) -> tuple[Vector, Vector] | None:
    """Return a viewpoint for the failure of the plan, and the middle of its picture, m.

    No link is cut away for this viewpoint. Without a failure, and if ``step`` isn't its step, return None.
    """
    explained = why(log)
    if explained.failure is None or step not in (None, explained.step) or not explained.bodies:
        return None
    scene = DrawnWorld(log, explained.step, explained.world.name if explained.world is not None else None)
    about = scene.subjects(explained)
    low, high = bounds(scene.parts, scene.subject(about)[0])
    return scene.view([scene], None, about, _SIZE, cuts=False).camera.pose[0], _vector((low + high) / 2)


def _check_size(size: tuple[int, int]) -> None:
    if not all(isinstance(side, int) and 0 < side <= _MAX_SIDE for side in size):
        raise ReplayError(f"a picture can't have {size[0]} x {size[1]} pixels; use 1 to {_MAX_SIDE} per side")


def _pinhole(pose: Pose, angle: float, size: tuple[int, int], near: float = _NEAR, far: float = _FAR) -> Camera:
    right = math.tan(angle / 2)
    return Camera(pose, right, right * size[1] / size[0], near, far)


def _point(name: str, values: Sequence[float]) -> Vector:
    numbers = [float(value) for value in values]
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ReplayError(f"{name} = {list(values)}: expected 3 finite numbers x, y, z in m")
    return _vector(numbers)


def _vector(values: Sequence[float] | NDArray[np.float64]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True, slots=True)
class DrawnLink:
    """A link of a body, for pictures."""

    drawable: Drawable
    fixed: bool  # whether the link is furniture or a wall, which may be cut away

    @property
    def corners(self) -> NDArray[np.float64]:
        """The corners (8, 3) of the link's box in the world, m."""
        ends = np.concatenate([self.drawable.shapes.low, self.drawable.shapes.high])
        turned = ends[(_CORNERS, [0, 1, 2])] @ geometry.to_matrix(self.drawable.orientations[0]).T
        return turned + self.drawable.positions[0]


@dataclass(frozen=True, slots=True)
class PictureSubject:
    """The objects and links that a picture shows."""

    groups: tuple[tuple[int, ...], ...]  # numbers of the parts that belong to each object
    every: bool  # whether all objects must be visible, rather than most of them


@dataclass(frozen=True, slots=True)
class CutawayView:
    """A camera, and the links in front of it that are cut away."""

    camera: Camera
    cut: frozenset[int] = frozenset()  # numbers of the parts that are cut away
    depth: float = 0.0  # depth of the cut along the camera's axis, m

    def draw(
        self, parts: Sequence[DrawnLink], window: Window, size: tuple[int, int], numbers: Iterable[int] | None = None
    ) -> Rendering:
        """Draw parts by number, by default all parts; in the result, numbers of parts identify bodies."""
        drawn = range(len(parts)) if numbers is None else list(numbers)
        shown = _draw(self.camera, parts, [number for number in drawn if number not in self.cut], window, size)
        cut = sorted(self.cut.intersection(drawn))
        if not cut:
            return shown
        behind = replace(self.camera, near=max(self.camera.near, self.depth))
        return shown.before(_draw(behind, parts, cut, window, size))


def _draw(
    camera: Camera, parts: Sequence[DrawnLink], numbers: Sequence[int], window: Window, size: tuple[int, int]
) -> Rendering:
    drawn = camera.draw([parts[number].drawable for number in numbers], window, size)
    return replace(drawn, bodies=np.append(np.array(numbers, dtype=np.int64), -1)[drawn.bodies])


def bounds(parts: Sequence[DrawnLink], subject: PictureSubject) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and highest corner of a subject's bounding box in m."""
    corners = [parts[number].corners for group in subject.groups for number in group]
    if not corners:  # a subject without shapes
        return np.zeros(3), np.ones(3)
    return np.concatenate(corners).min(axis=0), np.concatenate(corners).max(axis=0)


def viewpoints(aim: Vector, distance: float, heading: Quaternion, side: str | None = None) -> Iterator[Vector]:
    """Yield viewpoints in the world at a distance in m from the target ``aim``, preferred viewpoints first.

    ``heading`` (xyzw) is the robot's orientation. With a ``side``, yield only viewpoints on this side.
    """
    if side is not None:
        directions: Sequence[Sequence[float]] = SIDES[side]
    else:
        ring = [(np.cos(angle), np.sin(angle)) for angle in np.radians(np.arange(180, 540, 45))]
        around = [(x * np.cos(up), y * np.cos(up), np.sin(up)) for up in np.radians([30, 60, 6]) for x, y in ring]
        directions = [*_PREFERRED, *around, *SIDES["above"]]
    for share in (1.0, _CLOSER):
        for direction in directions:
            turned = np.array(geometry.rotate(heading, direction))
            x, y, z = map(float, np.array(aim) + share * distance * turned / np.linalg.norm(turned))
            yield x, y, z


def free_view(
    cameras: Sequence[Camera], scenes: Sequence[tuple[Sequence[DrawnLink], PictureSubject]], *, cuts: bool = True
) -> CutawayView:
    """Return the first camera that sees enough of the subject in each scene, else the best camera.

    If no camera sees enough, links that hide the subject of the last scene are cut away, unless ``cuts`` is False.
    """
    parts, subject = scenes[-1]
    cameras = [camera for camera in cameras if not _in_furniture(camera, parts)] or cameras
    best, most = cameras[0], -1.0
    for camera in cameras:
        share = 1.0
        for scene in reversed(scenes):
            share = min(share, _seen(CutawayView(camera), *scene, most))
            if share <= most:
                break
        if share >= _ENOUGH:
            return CutawayView(camera)
        if share > most:
            best, most = camera, share
    return CutawayView(best) if most >= _TOO_LITTLE or not cuts else _cut_view(cameras, parts, subject)


def _in_furniture(camera: Camera, parts: Sequence[DrawnLink]) -> bool:
    for part in parts:
        low, high = part.drawable.shapes.low[0], part.drawable.shapes.high[0]
        if part.fixed and (high - low).min() < _ROOM:
            pose = tuple(part.drawable.positions[0]), tuple(part.drawable.orientations[0])
            eye = np.array(geometry.transform(geometry.invert(pose), camera.pose[0]))
            if ((eye >= low) & (eye <= high)).all():
                return True
    return False


def _seen(view: CutawayView, parts: Sequence[DrawnLink], subject: PictureSubject, most: float = -1.0) -> float:
    """Return the visible share of a subject, 0 to 1. A share up to ``most`` may be inexact."""
    shares = []
    for group in sorted(subject.groups, key=lambda group: parts[group[0]].drawable.is_robot):  # drawing robots is slow
        share = _Glance(view, parts, group).share
        shares.append(min(1.0, share / _ROBOT_SHARE) if parts[group[0]].drawable.is_robot else share)
        if subject.every and shares[-1] <= most:
            break
    return (min(shares) if subject.every else sum(shares) / len(shares)) if shares else 1.0


class _Glance:
    """The visible share of an object: the share of its pixels that other objects don't hide."""

    def __init__(self, view: CutawayView, parts: Sequence[DrawnLink], group: tuple[int, ...]) -> None:
        window = _window(view.camera, np.concatenate([parts[number].corners for number in group]))
        alone = _draw(view.camera, parts, group, window, _GLANCE)
        among = view.draw(parts, window, _GLANCE).bodies
        there = alone.bodies >= 0
        hidden = there & ~np.isin(among, group)
        self.share = 1.0 - float(hidden.sum() / there.sum()) if there.any() else 0.0
        # numbers of the parts of furniture and walls that hide the object
        self.hiding = frozenset(
            int(number) for number in np.unique(among[hidden]) if number >= 0 and parts[number].fixed
        )
        self.depth = float(alone.depth[hidden].min(initial=np.inf))  # of the nearest hidden pixel along the axis, m


def _window(camera: Camera, corners: NDArray[np.float64]) -> Window:
    x, y, z = camera.to_frame(corners).T
    if (z < camera.near).any():
        return camera.window
    across, down = np.clip(x / z, -camera.right, camera.right), np.clip(y / z, -camera.down, camera.down)
    gap = 1e-3
    return Window(
        float(across.min()) - gap, float(down.min()) - gap, float(across.max()) + gap, float(down.max()) + gap
    )


def _cut_view(cameras: Sequence[Camera], parts: Sequence[DrawnLink], subject: PictureSubject) -> CutawayView:
    """Cut away fixed links in front of the subject.

    Return the first view that shows enough of the subject, or else the best view.
    """
    best, most = CutawayView(cameras[0]), -1.0
    for camera in cameras:
        view = CutawayView(camera)
        for _ in range(_MAX_CUTS):
            glances = [_Glance(view, parts, group) for group in subject.groups]
            hiding = frozenset().union(*(glance.hiding for glance in glances))
            if hiding <= view.cut:
                break
            depth = min((glance.depth for glance in glances), default=np.inf) - _CUT_GAP
            view = CutawayView(camera, view.cut | hiding, min(depth, view.depth or depth))
        share = _seen(view, parts, subject, most)
        if share >= _ENOUGH:
            return view
        if share > most:
            best, most = view, share
    return best
