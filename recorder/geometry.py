"""Poses, rotations, and convex polygons of the plane.

A pose is ``(position, orientation)``: xyz in metres and a unit quaternion in the order xyzw. ``a_T_b`` is the pose of
frame b in frame a, so that ``multiply(a_T_b, b_T_c)`` is ``a_T_c``. Single poses are tuples of floats, because
arithmetic on tuples is several times faster than on arrays of 3 numbers. Use arrays of matrices for thousands of poses.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Vector: TypeAlias = tuple[float, float, float]  # a vector xyz; a position is in m
Quaternion: TypeAlias = tuple[float, float, float, float]  # a rotation, xyzw
Pose: TypeAlias = tuple[Vector, Quaternion]  # position in m and orientation xyzw
Array: TypeAlias = "NDArray[np.float64]"  # an array of numbers, of any shape
Flags: TypeAlias = "NDArray[np.bool_]"  # an array of truth values, of any shape
Indices: TypeAlias = "NDArray[np.intp]"  # an array of indices, of any shape
Numbers: TypeAlias = "Sequence[float] | Array"  # the type of arguments that are a vector or a quaternion
PoseLike: TypeAlias = "tuple[Numbers, Numbers]"  # the type of arguments that are a pose
Point: TypeAlias = tuple[float, float]  # a point of the plane
Polygon: TypeAlias = "Sequence[Point]"  # counterclockwise corners; fewer than three corners without area

IDENTITY: Pose = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))  # the pose of a frame in itself

_DECIMALS: Final = 6  # number of decimals to which points in the plane are rounded
_TINY = 1e-12
_VERTICAL = 1e-9  # a unit axis with a smaller horizontal part is vertical; roll and yaw are then the same

# A rotation matrix minus identity is linear in the products of the quaternion's components. Rows of _PRODUCTS are these
# products; columns are elements of the matrix, row by row.
_FIRST, _SECOND = np.array([[0, 0, 0, 0, 1, 1, 1, 2, 2], [0, 1, 2, 3, 1, 2, 3, 2, 3]])
_PRODUCTS = 2.0 * np.array(
    [
        [0, 0, 0, 0, -1, 0, 0, 0, -1],  # xx
        [0, 1, 0, 1, 0, 0, 0, 0, 0],  # xy
        [0, 0, 1, 0, 0, 0, 1, 0, 0],  # xz
        [0, 0, 0, 0, 0, -1, 0, 1, 0],  # xw
        [-1, 0, 0, 0, 0, 0, 0, 0, -1],  # yy
        [0, 0, 0, 0, 0, 1, 0, 1, 0],  # yz
        [0, 0, 1, 0, 0, 0, -1, 0, 0],  # yw
        [-1, 0, 0, 0, -1, 0, 0, 0, 0],  # zz
        [0, -1, 0, 1, 0, 0, 0, 0, 0],  # zw
    ]
)


def product(a: Numbers, b: Numbers) -> Quaternion:
    """Return the rotation that first turns by b, then by a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(rotation: Numbers) -> Quaternion:
    """Return the inverse rotation."""
    x, y, z, w = rotation
    return -x, -y, -z, w


def rotate(rotation: Numbers, vector: Numbers) -> Vector:
    """Return the rotated vector."""
    x, y, z, w = rotation
    a, b, c = vector
    tx = 2.0 * (y * c - z * b)
    ty = 2.0 * (z * a - x * c)
    tz = 2.0 * (x * b - y * a)
    return (a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx)


def multiply(a_T_b: PoseLike, b_T_c: PoseLike) -> Pose:
    """Return the pose of c in a."""
    (x, y, z), outer = a_T_b
    position, inner = b_T_c
    dx, dy, dz = rotate(outer, position)
    return (x + dx, y + dy, z + dz), product(outer, inner)


def invert(a_T_b: PoseLike) -> Pose:
    """Return the pose of a in b."""
    position, orientation = a_T_b
    inverse = conjugate(orientation)
    x, y, z = rotate(inverse, position)
    return (-x, -y, -z), inverse


def transform(a_T_b: PoseLike, point: Numbers) -> Vector:
    """Convert a point (xyz in m) from frame b to frame a."""
    (x, y, z), orientation = a_T_b
    dx, dy, dz = rotate(orientation, point)
    return x + dx, y + dy, z + dz


def angle(a: Numbers, b: Numbers) -> float:
    """Return the angle between two rotations in rad, 0..pi. The result is also exact for tiny angles."""
    x, y, z, w = product(conjugate(a), b)
    return 2.0 * math.atan2(math.hypot(x, y, z), abs(w))


def rotation_vector(rotation: Numbers) -> Vector:
    """Return the axis of a rotation, multiplied by its angle in rad (0 to pi)."""
    x, y, z, w = rotation
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0:
        return 0.0, 0.0, 0.0
    scale = math.copysign(2 * math.atan2(sine, abs(w)) / sine, w)
    return x * scale, y * scale, z * scale


def lean(a: Numbers, b: Numbers) -> float:
    """Return the angle between the z axes of two rotations in rad, 0..pi."""
    up, other_up = rotate(a, (0.0, 0.0, 1.0)), rotate(b, (0.0, 0.0, 1.0))
    return math.acos(max(-1.0, min(1.0, sum(x * y for x, y in zip(up, other_up, strict=True)))))


def yaw_of(rotation: Numbers) -> float:
    """Return the heading of the rotated x axis: its angle about the vertical in rad."""
    x, y, _ = rotate(rotation, (1.0, 0.0, 0.0))
    return math.atan2(y, x)


def from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation of URDF angles in rad: roll, pitch and yaw turn about the fixed axes x, then y, then z."""
    sr, cr = math.sin(roll / 2.0), math.cos(roll / 2.0)
    sp, cp = math.sin(pitch / 2.0), math.cos(pitch / 2.0)
    sy, cy = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def to_rpy(rotation: Numbers) -> Vector:
    """Return the roll, pitch and yaw of :func:`from_rpy`, rad. For a pitch of +-90 degrees, yaw is 0."""
    m = to_matrix(rotation).tolist()
    level = math.hypot(m[0][0], m[1][0])
    pitch = math.atan2(-m[2][0], level)
    if level < _VERTICAL:
        return math.atan2(-m[1][2], m[1][1]), pitch, 0.0
    return math.atan2(m[2][1], m[2][2]), pitch, math.atan2(m[1][0], m[0][0])


def to_matrix(rotation: Numbers) -> NDArray[np.float64]:
    """Return the rotation as a 3 x 3 matrix, whose columns are the rotated axes."""
    matrix: NDArray[np.float64] = to_matrices(np.array([rotation]))[0]
    return matrix


def to_matrices(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation matrices (n, 3, 3) of unit quaternions xyzw (n, 4)."""
    products = rotations.take(_FIRST, axis=1) * rotations.take(_SECOND, axis=1)
    matrices: NDArray[np.float64] = (products @ _PRODUCTS).reshape(-1, 3, 3) + np.eye(3)
    return matrices


def pose_matrix(a_T_b: PoseLike) -> NDArray[np.float64]:
    """Return the pose as a homogeneous 4 x 4 matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = to_matrix(a_T_b[1])
    matrix[:3, 3] = a_T_b[0]
    return matrix


def from_matrix(matrix: NDArray[np.float64]) -> Quaternion:
    """Return a 3 x 3 rotation matrix as a unit quaternion xyzw with w >= 0."""
    (a, d, e), (f, b, g), (h, k, c) = matrix.tolist()
    # ``outer`` is four times the outer product of the quaternion with itself, so each of its rows is a multiple of the
    # quaternion. The row with the largest diagonal element is numerically stable for every rotation.
    outer = (
        (1.0 + a - b - c, d + f, e + h, k - g),
        (d + f, 1.0 - a + b - c, g + k, e - h),
        (e + h, g + k, 1.0 - a - b + c, f - d),
        (k - g, e - h, f - d, 1.0 + a + b + c),
    )
    row = max(range(4), key=lambda i: outer[i][i])
    length = math.copysign(math.hypot(*outer[row]), outer[row][3])
    x, y, z, w = (value / length for value in outer[row])
    return x, y, z, w


def look_at(eye: Numbers, target: Numbers) -> Quaternion:
    """Return the orientation of an optical frame (z forward, x right, y down) that looks from ``eye`` at ``target``.

    Points are xyz in m. The z axis of the world points up in the picture, unless the view is vertical. If the points
    coincide, ValueError is raised.
    """
    z = np.asarray(target, dtype=np.float64) - np.asarray(eye, dtype=np.float64)
    length = float(np.linalg.norm(z))
    if not length > _TINY:
        raise ValueError("eye and target coincide: there is no direction to look in")
    z /= length
    x = np.cross(z, np.array([0.0, 0.0, 1.0]))
    if float(np.linalg.norm(x)) < 1e-9:
        x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    return from_matrix(np.column_stack([x, np.cross(z, x), z]))


def convex_hull(points: NDArray[np.float64]) -> Polygon:
    """Return the convex hull of points (n, 2) (monotone chain)."""
    ordered = sorted(set(map(tuple, points.round(_DECIMALS).tolist())))

    def half(sequence: Iterable[Point]) -> list[Point]:
        chain: list[Point] = []
        for point in sequence:
            while len(chain) > 1 and _side(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return half(ordered) + half(reversed(ordered)) if len(ordered) > 2 else ordered


def polygon_intersection(polygon: Polygon, other: Polygon) -> Polygon:
    """Return the intersection of two convex polygons (Sutherland and Hodgman)."""
    kept = list(polygon)
    for a, b in itertools.pairwise([*other, other[0]]):
        corners, kept = kept, []
        for now, after in zip(corners, [*corners[1:], *corners[:1]], strict=True):
            left, follows = _side(a, b, now), _side(a, b, after)
            if left >= 0:
                kept.append(now)
            if left * follows < 0:
                share = left / (left - follows)
                kept.append((now[0] + (after[0] - now[0]) * share, now[1] + (after[1] - now[1]) * share))
    return kept


def margin_in_polygon(polygon: Polygon, point: Sequence[float]) -> float:
    """Return the distance (m) from a point to a convex polygon's boundary; negative outside, -inf without an area."""
    if len(polygon) < 3:
        return -math.inf
    x, y = point
    return min(_side(a, b, (x, y)) / max(math.dist(a, b), 1e-9) for a, b in itertools.pairwise([*polygon, polygon[0]]))


def narrowest_width(polygon: Polygon) -> tuple[float, float]:
    """Return the smallest width of a convex polygon in m, and the direction in rad of the side across that width."""
    return min(
        (max(_side(a, b, corner) for corner in polygon) / math.dist(a, b), math.atan2(b[1] - a[1], b[0] - a[0]))
        for a, b in itertools.pairwise([*polygon, polygon[0]])
    )


def _side(a: Point, b: Point, point: Point) -> float:
    """Return a number above 0 if a point lies left of the line from a to b."""
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])
