"""Where to look from: viewpoints around what a picture is of, and what is cut away if none of them has free sight.

A viewpoint is judged by rendering: how many pixels of a thing, drawn alone, are left when all else is drawn too. Each
thing is looked at through a window of the picture just around it, so small things count as large ones, and little else
has to be drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.vision.rasterizer import Window
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from pycram.vision.camera import Camera, Drawable, Rendering
    from recorder.geometry import Quaternion, Vector

#: Directions from what is looked at to the viewpoint, in the robot's frame, for each side that can be asked for.
SIDES: Final[dict[str, tuple[Vector, ...]]] = {
    "behind": ((-0.85, 0.0, 0.5), (-0.95, 0.0, 0.2), (-0.6, 0.0, 0.8)),
    "right": ((0.0, -0.85, 0.5), (0.0, -0.95, 0.2), (0.0, -0.6, 0.8)),
    "left": ((0.0, 0.85, 0.5), (0.0, 0.95, 0.2), (0.0, 0.6, 0.8)),
    "front": ((0.85, 0.0, 0.5), (0.95, 0.0, 0.2), (0.6, 0.0, 0.8)),
    "above": ((-0.02, 0.0, 1.0),),
}
#: Those that are tried first otherwise: over the robot's shoulders, then from before it.
_PREFERRED: Final = (
    (-0.55, -0.65, 0.55),
    (-0.55, 0.65, 0.55),
    (0.55, -0.65, 0.55),
    (0.55, 0.65, 0.55),
    (-0.4, 0.0, 0.9),
)
_CLOSER: Final = 0.6  # of the distance, where nothing is seen from farther away: the walls of a room may be nearer
_ENOUGH: Final = 0.7  # of the pixels: the first viewpoint that shows so many is taken
_TOO_LITTLE: Final = 0.3  # of the pixels: where the best viewpoint shows fewer, what hides them is cut away
_ROBOT_SHARE: Final = 0.4  # of a robot's pixels that are enough of it: what it works at hides the rest
_GLANCE: Final = (40, 40)  # pixels of the window around a thing
_MAX_CUTS: Final = 6  # layers of furniture and walls that are cut away
_ROOM: Final = 1.5  # m: what is smaller in one direction is furniture, and nobody looks from the inside of that
_CUT_GAP: Final = 0.02  # m before what is seen that a cut ends


@dataclass(frozen=True, slots=True)
class Part:
    """A link of a body, ready to be drawn."""

    drawable: Drawable  # the link alone
    fixed: bool  # whether it is of furniture or of a wall, which may be cut away

    @property
    def corners(self) -> NDArray[np.float64]:
        """The corners (8, 3) of its box in the world, m."""
        ends = np.concatenate([self.drawable.shapes.low, self.drawable.shapes.high])
        turned = ends[(_CORNERS, [0, 1, 2])] @ geometry.to_matrix(self.drawable.orientations[0]).T
        corners: NDArray[np.float64] = turned + self.drawable.positions[0]
        return corners


_CORNERS: Final = np.array([[(number >> axis) & 1 for axis in range(3)] for number in range(8)])


@dataclass(frozen=True, slots=True)
class Subject:
    """What a picture is of."""

    groups: tuple[tuple[int, ...], ...]  # numbers of the parts of each thing
    every: bool  # whether every single one has to be seen; else most of them


@dataclass(frozen=True, slots=True)
class View:
    """A camera, and what is cut away before it."""

    camera: Camera  # the camera
    cut: frozenset[int] = frozenset()  # numbers of the parts that are cut
    depth: float = 0.0  # m along the camera's axis up to which they are

    def draw(self, parts: Sequence[Part], window: Window, size: tuple[int, int]) -> Rendering:
        """Draw parts; the bodies of the rendering are their numbers."""
        whole = [number for number in range(len(parts)) if number not in self.cut]
        shown = _draw(self.camera, parts, whole, window, size)
        if not self.cut:
            return shown
        behind = replace(self.camera, near=max(self.camera.near, self.depth))
        return shown.before(_draw(behind, parts, sorted(self.cut), window, size))


def _draw(
    camera: Camera, parts: Sequence[Part], numbers: Sequence[int], window: Window, size: tuple[int, int]
) -> Rendering:
    drawn = camera.draw([parts[number].drawable for number in numbers], window, size)
    return replace(drawn, bodies=np.append(np.array(numbers, dtype=np.int64), -1)[drawn.bodies])


def bounds(parts: Sequence[Part], subject: Subject) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lowest and highest corner of what has to be seen, in m."""
    corners = [parts[number].corners for group in subject.groups for number in group]
    if not corners:  # of what has no shape
        return np.zeros(3), np.ones(3)
    return np.concatenate(corners).min(axis=0), np.concatenate(corners).max(axis=0)


def viewpoints(aim: Vector, distance: float, heading: Quaternion, side: str | None = None) -> Iterator[Vector]:
    """Yield points in the world to look at another one from, the usual ones first.

    Args:
        aim: the point to look at, m.
        distance: of the points from it, m.
        heading: orientation of the robot, xyzw, whose sides are meant.
        side: only those of a side: one of :data:`SIDES`.
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


def free_view(cameras: Sequence[Camera], parts: Sequence[Part], subject: Subject) -> View:
    """Return the first camera from which enough of a subject is seen, else the best; if that is little, with a cut."""
    cameras = [camera for camera in cameras if not _in_furniture(camera, parts)] or cameras
    best, most = cameras[0], -1.0
    for camera in cameras:
        share = _seen(View(camera), parts, subject, most)
        if share >= _ENOUGH:
            return View(camera)
        if share > most:
            best, most = camera, share
    return View(best) if most >= _TOO_LITTLE else _cut_view(cameras, parts, subject)


def _in_furniture(camera: Camera, parts: Sequence[Part]) -> bool:
    """Return whether a camera is within the box of a fixed part that is no room."""
    for part in parts:
        low, high = part.drawable.shapes.low[0], part.drawable.shapes.high[0]
        if part.fixed and (high - low).min() < _ROOM:
            pose = tuple(part.drawable.positions[0]), tuple(part.drawable.orientations[0])
            eye = np.array(geometry.transform(geometry.invert(pose), camera.pose[0]))
            if ((eye >= low) & (eye <= high)).all():
                return True
    return False


def _seen(view: View, parts: Sequence[Part], subject: Subject, most: float = -1.0) -> float:
    """Return which share of a subject is seen, of what would be if nothing else were there.

    Where that isn't above ``most``, it may be any other share that isn't.
    """
    shares = []
    for group in sorted(subject.groups, key=lambda group: parts[group[0]].drawable.is_robot):  # these cost the most
        share = _Glance(view, parts, group).share
        shares.append(min(1.0, share / _ROBOT_SHARE) if parts[group[0]].drawable.is_robot else share)
        if subject.every and shares[-1] <= most:
            break
    return (min(shares) if subject.every else sum(shares) / len(shares)) if shares else 1.0


class _Glance:
    """One thing alone and among all others, through the window just around it."""

    def __init__(self, view: View, parts: Sequence[Part], group: tuple[int, ...]) -> None:
        window = _window(view.camera, np.concatenate([parts[number].corners for number in group]))
        alone = _draw(view.camera, parts, group, window, _GLANCE)
        among = view.draw(parts, window, _GLANCE).bodies
        there = alone.bodies >= 0
        hidden = there & ~np.isin(among, group)
        self.share = 1.0 - float(hidden.sum() / there.sum()) if there.any() else 0.0  # of its pixels that are seen
        # numbers of the parts of furniture and walls that hide others of them
        self.hiding = frozenset(
            int(number) for number in np.unique(among[hidden]) if number >= 0 and parts[number].fixed
        )
        # m along the camera's axis at which the nearest hidden one is
        self.depth = float(alone.depth[hidden].min(initial=np.inf))


def _window(camera: Camera, corners: NDArray[np.float64]) -> Window:
    """Return the part of the picture that a box around points can be in."""
    x, y, z = camera.to_frame(corners).T
    if (z < camera.near).any():
        return camera.window
    across, down = np.clip(x / z, -camera.right, camera.right), np.clip(y / z, -camera.down, camera.down)
    gap = 1e-3
    return Window(
        float(across.min()) - gap, float(down.min()) - gap, float(across.max()) + gap, float(down.max()) + gap
    )


def _cut_view(cameras: Sequence[Camera], parts: Sequence[Part], subject: Subject) -> View:
    """Return a view in which what is fixed and hides the subject is cut away: the first that shows enough then."""
    best, most = View(cameras[0]), -1.0
    for camera in cameras:
        view = View(camera)
        for _ in range(_MAX_CUTS):
            glances = [_Glance(view, parts, group) for group in subject.groups]
            hiding = frozenset().union(*(glance.hiding for glance in glances))
            if hiding <= view.cut:
                break
            depth = min((glance.depth for glance in glances), default=np.inf) - _CUT_GAP
            view = View(camera, view.cut | hiding, min(depth, view.depth or depth))
        share = _seen(view, parts, subject, most)
        if share >= _ENOUGH:
            return view
        if share > most:
            best, most = view, share
    return best
