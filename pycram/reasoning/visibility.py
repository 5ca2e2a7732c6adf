"""What a camera sees of an object (thesis 4.4.3, 4.4.4).

Two pictures are compared pixel by pixel: the object alone, and with all that may be before it. They show just the part
of the image in which the object can be, so that a few thousand pixels decide precisely however far it is. The object's
pixels outside of the camera's image count as not seen. Cameras look along z, x is to the right, y is down (as optical
frames do).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram import checks
from pycram.failures import BadArgument, NoWorld
from pycram.reasoning.twin import twin
from recorder import geometry
from recorder.geometry import IDENTITY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from pycram.engine import Engine, Picture
    from pycram.objects import Object
    from recorder.geometry import Pose

_PIXELS: Final = 80**2  # of the part that is looked at
_WIDE: Final = math.radians(60)  # field of view where only a position is given
_NEAR, _FAR = 0.02, 20.0  # m
_SHELL: Final = 0.1  # m that a body may be seen beyond the bounds of its collision shapes
_MARGIN: Final = 0.05  # of the part's size around the object


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera in the world.

    Attributes:
        pose: position in m and orientation xyzw of its optical frame.
        right: tangent of half the horizontal field of view.
        down: tangent of half the vertical field of view.
        near: m from which on it sees.
        far: m up to which it sees.
    """

    pose: Pose
    right: float
    down: float
    near: float = _NEAR
    far: float = _FAR

    def to_frame(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """World points (n, 3) in the optical frame, m."""
        turn = geometry.to_matrix(self.pose[1])
        seen: NDArray[np.float64] = (points - np.asarray(self.pose[0])) @ turn
        return seen

    def look(self, engine: Engine, window: Window, size: tuple[int, int]) -> Picture:
        """Takes a picture of a part of its image plane."""
        world_turn = geometry.to_matrix(self.pose[1])
        flip = np.diag([1.0, -1.0, -1.0])  # OpenGL looks along -z with y up
        view = np.eye(4)
        view[:3, :3] = flip @ world_turn.T
        view[:3, 3] = -view[:3, :3] @ np.asarray(self.pose[0])
        near, far = self.near, self.far
        left, right = window.left * near, window.right * near
        bottom, top = -window.bottom * near, -window.top * near
        projection = np.zeros((4, 4))
        projection[0, 0] = 2 * near / (right - left)
        projection[1, 1] = 2 * near / (top - bottom)
        projection[0, 2] = (right + left) / (right - left)
        projection[1, 2] = (top + bottom) / (top - bottom)
        projection[2, 2] = -(far + near) / (far - near)
        projection[2, 3] = -2 * far * near / (far - near)
        projection[3, 2] = -1.0
        return engine.picture(view, projection, near, far, size)


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the image plane, as tangents: x to the right, y down."""

    left: float
    top: float
    right: float
    bottom: float


@dataclass(frozen=True, slots=True)
class View:
    """What of an object is seen.

    Attributes:
        share: seen pixels of all its pixels, 0 to 1.
        alone: pixels that it would have if nothing else were there and the image had no border.
        seen: pixels of it that are seen.
        hiding: share of its pixels that each other object hides, most hiding first.
        reason: in words, where nothing is seen.
    """

    share: float
    alone: int
    seen: int
    hiding: Mapping[str, float]
    reason: str = ""

    def evidence(self) -> dict[str, object]:
        """As records carry it."""
        told: dict[str, object] = {"share": self.share, "pixels_seen": self.seen, "pixels_alone": self.alone}
        return told | {"hidden_by": dict(self.hiding)} | ({"reason": self.reason} if self.reason else {})


def camera_at(where: object, target: Object, robot: Object | None = None) -> Camera:
    """The camera that a query means.

    Args:
        where: a position (looks at the target), a pair of position and orientation of an optical frame, or the name of
            a robot's camera frame.
        target: what is looked at.
        robot: whose frame it is; the world's robot by default.

    Raises:
        NoWorld: a frame is named, but the world has no robot.
        UnknownName: the robot has no such frame.
        BadArgument: anything else.
    """
    if isinstance(where, str):
        return _of_robot(where, robot or target.world.robot)
    try:
        parts = list(where)  # type: ignore[call-overload]
    except TypeError:
        raise BadArgument("camera", where, "a position, a position and an orientation, or a frame's name") from None
    if len(parts) == 2:
        pose = (checks.vector("camera position", parts[0]), checks.quaternion("camera orientation", parts[1]))
    else:
        eye = checks.vector("camera position", parts)
        middle = _middle(target)
        inside = math.dist(eye, middle) < _NEAR  # it is seen from nowhere then, whatever the direction
        pose = (eye, IDENTITY[1] if inside else geometry.look_at(eye, middle))
    wide = math.tan(_WIDE / 2)
    return Camera(pose, wide, wide)


def _of_robot(frame: str, robot: Object | None) -> Camera:
    if robot is None:
        raise NoWorld("robot")
    position, orientation = robot.get_link_position_and_orientation(frame)
    pose = (checks.vector("position", position), checks.quaternion("orientation", orientation))
    description = robot.description
    if description is None or description.camera is None or description.camera.frame != frame:
        wide = math.tan(_WIDE / 2)
        return Camera(pose, wide, wide)
    camera = description.camera
    return Camera(pose, math.tan(camera.horizontal_fov / 2), math.tan(camera.vertical_fov / 2), camera.near, camera.far)


def _middle(body: Object) -> list[float]:
    low, high = body.get_AABB()
    return [(a + b) / 2 for a, b in zip(low, high, strict=True)]


def view(body: Object, camera: Camera) -> View:
    """Looks at an object.

    Args:
        body: the object.
        camera: the camera.
    """
    frame = Window(-camera.right, -camera.down, camera.right, camera.down)
    window, reason = _window(body, camera, frame)
    if window is None:
        return View(0.0, 0, 0, {}, reason)
    width, height = window.right - window.left, window.bottom - window.top
    scale = math.sqrt(_PIXELS / (width * height))
    size = (max(8, round(scale * width)), max(8, round(scale * height)))
    world = body.world
    studio = twin(world, "studio")
    lone = studio.sync([body])[body.name]
    mine = camera.look(studio.engine, window, size).bodies == lone.id
    alone = int(mine.sum())
    if not alone:
        return View(0.0, 0, 0, {}, "is out of view or too near" if window == frame else "is too thin to be seen")
    stage = twin(world, "stage")
    copies = stage.sync(_before(body, camera, window))
    full = camera.look(stage.engine, window, size).bodies
    inside = _inside(window, frame, size)
    names = {copy.id: name for name, copy in copies.items()}
    covering = [(names[number], count) for number, count in _counted(full[mine & inside]) if number in names]
    seen = next((count for name, count in covering if name == body.name), 0)
    hiding = {name: count / alone for name, count in covering if name != body.name}
    reason = "" if seen else "is hidden" if hiding else "is out of view"
    return View(seen / alone, alone, seen, hiding, reason)


def _counted(numbers: NDArray[np.int64]) -> list[tuple[int, int]]:
    """How often each number stands in an array, the most frequent first."""
    different, counts = np.unique(numbers, return_counts=True)
    return sorted(zip(different.tolist(), counts.tolist(), strict=True), key=lambda pair: -pair[1])


def _before(body: Object, camera: Camera, window: Window) -> list[Object]:
    """What can be in a part of the image and not behind the object, by its bounds; and the object."""
    others = body.world.objects
    boxes = np.array([other.get_AABB() for other in others])
    boxes += np.array([[-_SHELL], [_SHELL]])
    corners = np.array(list(itertools.product((0, 1), repeat=3)))
    points = camera.to_frame(boxes[:, corners, np.arange(3)])
    x, y, depth = points[..., 0], points[..., 1], points[..., 2]
    farthest = float(depth[others.index(body)].max())
    beyond = (  # each is one side of a plane through the camera, or across its axis
        x < window.left * depth,
        x > window.right * depth,
        y < window.top * depth,
        y > window.bottom * depth,
        depth < camera.near,
        depth > farthest,
    )
    outside = np.any([side.all(axis=1) for side in beyond], axis=0)
    return [other for other, out in zip(others, outside, strict=True) if not out or other is body]


def _window(body: Object, camera: Camera, frame: Window) -> tuple[Window | None, str]:
    """The part of the image plane that can show the object; None and why if none can."""
    low, high = body.get_AABB()
    if all(a <= x <= b for a, x, b in zip(low, camera.pose[0], high, strict=True)):
        return None, "is around the camera"
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    points = camera.to_frame(corners)
    depth = points[:, 2]
    if (depth < camera.near).all():
        return None, "is behind the camera or too near"
    if (depth > camera.far).all():
        return None, "is too far away"
    if (depth < camera.near).any():
        return frame, ""  # it reaches through the image plane
    x, y = points[:, 0] / depth, points[:, 1] / depth
    border = _MARGIN * max(float(np.ptp(x)), float(np.ptp(y)), 1e-6)
    window = Window(float(x.min()) - border, float(y.min()) - border, float(x.max()) + border, float(y.max()) + border)
    apart = (
        window.left > frame.right or window.right < frame.left or window.top > frame.bottom or window.bottom < frame.top
    )
    return (None, "is out of view") if apart else (window, "")


def _inside(window: Window, frame: Window, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Which pixels of a part lie within the camera's image."""
    width, height = size
    x = window.left + (np.arange(width) + 0.5) / width * (window.right - window.left)
    y = window.top + (np.arange(height) + 0.5) / height * (window.bottom - window.top)
    columns: NDArray[np.bool_] = (x >= frame.left) & (x <= frame.right)
    rows: NDArray[np.bool_] = (y >= frame.top) & (y <= frame.bottom)
    both: NDArray[np.bool_] = rows[:, None] & columns[None, :]
    return both
