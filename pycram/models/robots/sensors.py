"""Heads and cameras as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pycram.foundation import checks
from pycram.foundation.failures import BadArgument
from pycram.models.robots import tables
from recorder import geometry

if TYPE_CHECKING:
    from recorder.geometry import Pose, PoseLike

_MAX_SIGHT: Final = 1e4  # m
_MAX_FOV: Final = 3.1  # rad
_MAX_PIXELS: Final = 1e5


@dataclass(frozen=True, slots=True)
class Head:
    """A head that turns: names of its joints, "" for one that it doesn't have.

    Attributes:
        pan: turns the camera to the left and right.
        tilt: turns the camera up and down.
    """

    pan: str = ""
    tilt: str = ""

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that it has."""
        return tuple(joint for joint in (self.pan, self.tilt) if joint)


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """A camera.

    Attributes:
        frame: the link with its optical frame: z forward, x right, y down.
        offset: pose of the optical frame in that link, where that isn't the optical frame itself.
        horizontal_fov: field of view in rad.
        vertical_fov: field of view in rad.
        width: pixels.
        height: pixels.
        near: m from which on it sees.
        far: m up to which it sees.
    """

    frame: str
    offset: Pose
    horizontal_fov: float
    vertical_fov: float
    width: int
    height: int
    near: float
    far: float

    def pose(self, link_pose: PoseLike) -> Pose:
        """Return the optical frame's pose for the pose of its link, both in the same frame."""
        return geometry.multiply(link_pose, self.offset)


def read_head(table: tables.Table) -> Head:
    """Return the head of a TOML table, checked.

    Raises:
        BadArgument: An entry is unknown or impossible, or there is none.
    """
    tables.only(table, "pan", "tilt")
    if not table:
        raise BadArgument("head", table, "the name of a pan joint, of a tilt joint, or of both")
    return Head(**{key: checks.text(key, value) for key, value in table.items()})


def read_camera(table: tables.Table) -> CameraDescription:
    """Return the camera of a TOML table, checked.

    Raises:
        KeyError: An entry is missing.
        BadArgument: An entry is unknown or impossible.
    """
    tables.only(table, "frame", "frame_offset", "horizontal_fov", "vertical_fov", "width", "height", "near", "far")
    wide, high = (checks.in_range(key, table[key], 1e-3, _MAX_FOV) for key in ("horizontal_fov", "vertical_fov"))
    width, height = (int(checks.in_range(key, table[key], 1, _MAX_PIXELS)) for key in ("width", "height"))
    near = checks.in_range("near", table["near"], 1e-4, _MAX_SIGHT)
    return CameraDescription(
        frame=checks.text("frame", table["frame"]),
        offset=tables.pose(table, "frame_offset"),
        horizontal_fov=wide,
        vertical_fov=high,
        width=width,
        height=height,
        near=near,
        far=checks.in_range("far", table["far"], near, _MAX_SIGHT),
    )
