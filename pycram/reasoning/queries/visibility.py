"""Visibility: the part of an object that a camera sees (thesis 4.4.3, 4.4.4).

An image of the object alone is compared pixel by pixel with an image of the objects in front of it. Both images show
only the part of the image plane that can contain the object, so a few thousand pixels give a precise share. Pixels of
the object outside of the camera's picture aren't seen.
"""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument, MissingPart, NoWorld
from pycram.models.shapes import distinct
from pycram.reasoning.collision.ray_cast import center
from pycram.reasoning.kinematics import pan_tilt
from pycram.reasoning.queries.query import Found, Verdict, query
from pycram.vision import NEAR, Camera, Rendering, Window
from pycram.world.attachment import held
from pycram.world.object import Object
from pycram.world.world import BulletWorld
from recorder import geometry
from recorder.geometry import IDENTITY, Pose, PoseLike
from recorder.records import Picture

VISIBLE_SHARE: Final = 0.8  # minimum share of a visible object's pixels that the camera sees (thesis 4.4.3)

_PIXELS: Final = 80**2  # number of pixels of the rendered part
_FIELD: Final = math.tan(math.radians(60) / 2)  # tangent of half the field of view of cameras without a description
_MAX_NAMES: Final = 250  # maximum number of named objects in a picture
_MARGIN: Final = 0.05  # margin around the object as a share of the part's size
_RAY: Final = 1e-3  # half the width of a ray at a distance of 1 m
_AT: Final = 0.05  # distance in m from a point; nearer objects, such as the board under the point, don't hide it


@query
def visible(
    object: Object,
    camera: Sequence[float] | str,
    world: BulletWorld | None = None,
    *,
    robot: Object | None = None,
    threshold: float = VISIBLE_SHARE,
) -> Verdict:
    """Return whether an object is visible (thesis 4.4.3).

    Args:
        camera: a position in m of a camera that points at the object; the position and orientation of a camera's
            optical frame; or the name of a camera frame of the robot.
        robot: the owner of the camera frame; None for the world's robot.
        threshold: share of the object's pixels above which the object is visible.

    Returns:
        The answer. The evidence has the share, the numbers of pixels, the share outside of the picture, the hiding
        objects, and for a hiding object with several links, the link that hides most.

    Raises:
        NoWorld: The camera is the name of a frame, but the world has no robot.
        UnknownName: The robot has no such frame.
    """
    seen = view(object, _camera(camera, object, robot))
    return Verdict(seen.share > threshold, seen.evidence(), seen.picture())


@query
def occluding(
    object: Object, camera: Sequence[float] | str, world: BulletWorld | None = None, *, robot: Object | None = None
) -> Found[Object]:
    """Return the objects between an object and a camera (thesis 4.4.4).

    :func:`visible` describes the arguments.

    Returns:
        The objects, starting with the one that hides most. The evidence has their shares.
    """
    seen = view(object, _camera(camera, object, robot))
    return Found(map(object.world.get_object, seen.hiding), seen.evidence(), seen.picture())


@dataclass(frozen=True, slots=True)
class View:
    """A camera's view of an object."""

    share: float  # share of the object's pixels that the camera sees, 0 to 1
    alone: int  # number of the object's pixels if nothing hid the object and the picture had no border
    seen: int  # number of the object's pixels that the camera sees
    hiding: Mapping[str, float]  # share of the object's pixels that each hiding object hides, largest first
    reason: str = ""  # why the camera sees nothing of the object
    outside: float = 0.0  # share of the object's pixels outside of the picture
    links: Mapping[str, str] = field(default_factory=dict)  # the link that hides most, by hiding object
    bodies: Sequence[str] = ()  # names of the object and of the objects in front of it; empty without a picture
    pixels: NDArray[np.uint8] | None = None  # (height, width); a pixel has the number n of the n-th body, or 0

    def picture(self) -> Picture | None:
        """Return the rendered picture for a record."""
        if self.pixels is None:
            return None
        height, width = self.pixels.shape
        return Picture(width=width, height=height, bodies=self.bodies, pixels=zlib.compress(self.pixels.tobytes()))

    def evidence(self) -> dict[str, object]:
        """Return the view as evidence for a record."""
        counts: dict[str, object] = {"share": self.share, "pixels_seen": self.seen, "pixels_alone": self.alone}
        counts["hidden_by"] = dict(self.hiding)
        others = {"reason": self.reason, "outside": self.outside, "hiding_links": dict(self.links)}
        return counts | {key: value for key, value in others.items() if value}


def _camera(given: object, target: Object, robot: Object | None) -> Camera:
    """Return the camera of a query: in a frame of the robot, at a pose, or at a position and directed to the target."""
    if isinstance(given, str):
        if robot is None:
            raise NoWorld("robot")
        position, orientation = robot.get_link_position_and_orientation(given)
        pose = (checks.vector("position", position), checks.quaternion("orientation", orientation))
        description = robot.description
        if description is None or description.camera is None or description.camera.frame != given:
            return Camera(pose, _FIELD, _FIELD)
        camera = description.camera
        pose = camera.pose(pose)
        return Camera(
            pose, math.tan(camera.horizontal_fov / 2), math.tan(camera.vertical_fov / 2), camera.near, camera.far
        )
    try:
        parts = list(cast("Iterable[object]", given))
    except TypeError:
        raise BadArgument("camera", given, "a position, a position and an orientation, or a frame's name") from None
    if len(parts) == 2:
        pose = (checks.vector("camera position", parts[0]), checks.quaternion("camera orientation", parts[1]))
    else:
        eye = checks.vector("camera position", parts)
        aim = center(target)
        inside = math.dist(eye, aim) < NEAR  # a camera with this position sees nothing in any direction
        pose = (eye, IDENTITY[1] if inside else geometry.look_at(eye, aim))
    return Camera(pose, _FIELD, _FIELD)


def view(body: Object, camera: Camera, without: Collection[Object] = ()) -> View:
    """Return a camera's view of an object; the caller holds the world's lock. Objects in ``without`` hide nothing."""
    frame = camera.window
    window, reason = _window(body, camera, frame)
    if window is None:
        return View(0.0, 0, 0, {}, reason)
    width, height = window.right - window.left, window.bottom - window.top
    scale = math.sqrt(_PIXELS / (width * height))
    size = (max(8, round(scale * width)), max(8, round(scale * height)))
    alone = camera.render([body], window, size)
    covered = alone.bodies == 0
    pixels = int(covered.sum())
    if not pixels:
        return View(0.0, 0, 0, {}, "is out of view or too near" if window == frame else "is too thin to be seen")
    others = [other for other in body.world.objects if other is not body and other not in without]
    before = camera.render(others, window, size, float(alone.depth[covered].max()))
    inside = covered & _inside(window, frame, size)
    hidden = inside & (before.depth < alone.depth)
    seen = int(inside.sum() - hidden.sum())
    counts = np.bincount(before.bodies[hidden], minlength=len(others))
    shares = {other.name: int(count) / pixels for other, count in zip(others, counts, strict=True) if count}
    hiding = dict(sorted(shares.items(), key=lambda item: -item[1]))
    links = {}
    for index in np.flatnonzero(counts):
        if len(others[index].urdf.links) > 1:
            parts = before.numbers[before.seen[hidden & (before.bodies == index)]]
            links[others[index].name] = before.links[int(np.bincount(parts).argmax())]
    reason = "" if seen else "is hidden" if hiding else "is out of view"
    outside = 1 - int(inside.sum()) / pixels
    return View(seen / pixels, pixels, seen, hiding, reason, outside, links, *_pixels(body, others, alone, before))


def _pixels(
    body: Object, others: Sequence[Object], alone: Rendering, before: Rendering
) -> tuple[list[str], NDArray[np.uint8]]:
    """Return the names of the bodies in a picture, and the number of the body at each pixel."""
    # the number 0 stands for the object, -1 for no object
    owners = np.where(before.depth < alone.depth, before.bodies + 1, alone.bodies)
    near = [int(owner) for owner in distinct(owners) if owner > 0][:_MAX_NAMES]
    numbers = np.zeros(len(others) + 2, dtype=np.uint8)  # of each owner; the last is for pixels without an object
    numbers[0] = 1
    numbers[near] = range(2, len(near) + 2)
    return [body.name, *(others[owner - 1].name for owner in near)], numbers[owners]


def _window(body: Object, camera: Camera, frame: Window) -> tuple[Window | None, str]:
    """Return the part of the image plane that can show the object; or None and the reason."""
    low, high = body.get_AABB()
    if all(a <= x <= b for a, x, b in zip(low, camera.pose[0], high, strict=True)):
        return None, "is around the camera"
    points = camera.to_frame(np.array(list(itertools.product(*zip(low, high, strict=True)))))
    depth = points[:, 2]
    if (depth < camera.near).all():
        return None, "is behind the camera or too near"
    if (depth > camera.far).all():
        return None, "is too far away"
    if (depth < camera.near).any():
        return frame, ""  # the object crosses the image plane
    x, y = points[:, 0] / depth, points[:, 1] / depth
    border = _MARGIN * max(float(np.ptp(x)), float(np.ptp(y)), 1e-6)
    window = Window(float(x.min()) - border, float(y.min()) - border, float(x.max()) + border, float(y.max()) + border)
    apart = (
        window.left > frame.right or window.right < frame.left or window.top > frame.bottom or window.bottom < frame.top
    )
    return (None, "is out of view") if apart else (window, "")


def _inside(window: Window, frame: Window, size: tuple[int, int]) -> NDArray[np.bool_]:
    width, height = size
    x = window.left + (np.arange(width) + 0.5) / width * (window.right - window.left)
    y = window.top + (np.arange(height) + 0.5) / height * (window.bottom - window.top)
    columns: NDArray[np.bool_] = (x >= frame.left) & (x <= frame.right)
    rows: NDArray[np.bool_] = (y >= frame.top) & (y <= frame.bottom)
    return rows[:, None] & columns[None, :]


def seen_share(robot: Object, body: Object, base: Pose) -> View:
    """Return the view of an object by a robot's camera, with the robot's base at a pose.

    The robot and held objects hide nothing. The caller holds the world's lock.
    """
    return view(body, _eye(robot, center(body), base), without=(robot, *held(robot)))


def in_sight(robot: Object, point: Sequence[float], base: PoseLike) -> bool:
    """Return whether no fixed object is between a point (xyz, m) and the robot's camera, which is turned to the point.

    The robot's base is at the pose ``base``. The caller holds the world's lock.
    """
    eye = _eye(robot, point, base)
    x, y, z = eye.to_frame(np.asarray(point, dtype=np.float64))
    if not eye.near < z < eye.far or abs(x) > eye.right * z or abs(y) > eye.down * z:
        return False
    ray = Window(x / z - _RAY, y / z - _RAY, x / z + _RAY, y / z + _RAY)
    fixed = [body for body in robot.world.objects if body.fixed and not body.is_robot]
    return bool(eye.render(fixed, ray, (1, 1), float(z)).depth[0, 0] > z - _AT)


def _eye(robot: Object, point: Sequence[float], base: PoseLike) -> Camera:
    """Return a robot's camera with the robot's base at a pose and the head turned to a point."""
    description = robot.description
    if description is None or description.camera is None:
        raise MissingPart(robot.name, "camera")
    camera, now = description.camera, robot.get_joint_positions()
    joints = description.head.joints if description.head else ()
    turned, _ = pan_tilt.aim_camera(robot.urdf, joints, camera, geometry.transform(geometry.invert(base), point), now)
    pose = camera.pose(geometry.multiply(base, robot.urdf.forward_kinematics({**now, **turned}, camera.frame)))
    return Camera(pose, math.tan(camera.horizontal_fov / 2), math.tan(camera.vertical_fov / 2), camera.near, camera.far)
