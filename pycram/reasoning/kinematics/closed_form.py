"""Inverse kinematics in closed form, for arms with seven joints and a spherical shoulder and wrist, as in the PR2.

Axes 2 and 3 must meet in a shoulder, and axes 5, 6 and 7 in a wrist. Joint 1 is sampled; subproblems of Paden and Kahan
give the other joints (Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, section 3.3.2).
Points are columns (3, n), axes are unit vectors (3,), angles are (n,) in rad. A strain is roughly the missing angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.models.shapes import distinct
from pycram.reasoning.kinematics import forward
from recorder.geometry import Array, Flags, Indices

if TYPE_CHECKING:
    Hinge = tuple[Array, Array, Array]

_ROUNDING: Final = 1e-9  # tolerance in rad beyond a limit
_MEET: Final = 1e-6  # largest distance in m of axes that meet
_SAMPLES: Final = 44  # number of samples of joint 1 for a pose
_SAMPLES_AROUND_A_MISS: Final = 13  # samples of joint 1
_SAMPLES_FOR_A_POSITION: Final = (8, 6, 4)  # numbers of samples of joints 1, 5 and 6 for a position
_ROUNDING_ANGLE: Final = 1e-9  # tolerance of a cosine


@dataclass(frozen=True, slots=True)
class ClosedForm:
    """The geometry of an arm that has a closed form."""

    origins: Array  # (7, 3) a point of each axis with all joints at zero, in the base link, m
    axes: Array  # (7, 3) unit vectors of the axes with all joints at zero
    tool: Array  # (4, 4) pose of the tool with all joints at zero
    shoulder: Array  # intersection of axes 2 and 3 with all joints at zero
    wrist: Array  # intersection of axes 5, 6 and 7 with all joints at zero
    lower: Array  # lower limits, rad; -pi for joints without limits
    upper: Array  # upper limits, rad; pi for joints without limits
    bounded: Flags  # whether each joint has limits
    span: tuple[float, float]  # least and greatest distance between the wrist and the shoulder, m
    shoulders: Array  # (n, 3) positions of the shoulder for samples of joint 1
    swing: float  # largest distance in m between the shoulder and the nearest of these positions
    elbow: Hinge  # how joint 4 determines the distance between the shoulder and the wrist
    rotations: Array  # (7, 3, 3, 3) constant parts of each joint's rotation (:func:`forward.constant_parts`)
    hand: Array  # (2, 3) two perpendicular unit vectors, also perpendicular to the last axis with all joints at zero

    @classmethod
    def of(
        cls, origins: Array, axes: Array, tool: Array, lower: Array, upper: Array, bounded: Flags
    ) -> ClosedForm | None:
        """Return the closed form of an arm from its geometry; None if its axes don't meet."""
        if len(axes) != 7:
            return None
        shoulder = _meeting(origins[1], axes[1], origins[2], axes[2])
        wrist = _meeting(origins[4], axes[4], origins[5], axes[5])
        if shoulder is None or wrist is None:
            return None
        if float(np.linalg.norm(np.cross(wrist - origins[6], axes[6]))) > _MEET or _parallel(axes[5], axes[6]):
            return None
        q4 = np.linspace(lower[3], upper[3], _SAMPLES)
        bent = turned(axes[3], q4, (wrist - origins[3])[:, None])
        spans = np.linalg.norm(bent + (origins[3] - shoulder)[:, None], axis=0)
        slack = _radius(wrist, origins[3], axes[3]) * float(q4[1] - q4[0]) / 2  # change between two samples
        span = float(spans.min()) - slack, float(spans.max()) + slack
        q1 = np.linspace(lower[0], upper[0], _SAMPLES)
        shoulders = (turned(axes[0], q1, (shoulder - origins[0])[:, None]) + origins[0][:, None]).T
        swing = _radius(shoulder, origins[0], axes[0]) * float(q1[1] - q1[0]) / 2
        x, y, z = axes[6]
        vector = (0.0, z, -y) if abs(x) <= min(abs(y), abs(z)) else (-z, 0.0, x) if abs(y) <= abs(z) else (y, -x, 0.0)
        across: Array = np.array(vector) / math.hypot(*vector)  # a unit vector, perpendicular to the last axis
        return cls(
            origins=origins,
            axes=axes,
            tool=tool,
            shoulder=shoulder,
            wrist=wrist,
            lower=lower,
            upper=upper,
            bounded=bounded,
            span=span,
            shoulders=shoulders,
            swing=swing,
            elbow=_hinge(origins[3], axes[3], wrist[:, None], shoulder),
            rotations=forward.constant_parts(axes, origins, np.zeros(7, dtype=bool))[:, :3, :3, :3],
            hand=np.array([across, np.cross(axes[6], across)]),
        )

    def postures(self, positions: Array, turns: Array | None, home: Array) -> tuple[Array, Array]:
        """Return postures (m, n, 7) for targets, also postures that miss their targets, and their strains (m, n).

        The targets are positions (m, 3) of the tool in the base link, m, and orientations (m, 3, 3); None for any
        orientation. The joint positions of ``home`` (7,) are also sampled, to find near solutions. A strain is 0 for a
        solution within the limits, otherwise roughly the missing or excessive angle in rad.
        """
        if turns is None:
            return self._by_target(len(positions), *self._at_positions(positions, home))
        return self._by_target(len(positions), *self._at_poses(positions, turns, self._samples(0, _SAMPLES, home)))

    def solutions(self, positions: Array, turns: Array, home: Array) -> list[Array]:
        """Return the postures (n, 7) without strain for each target; faster than :meth:`postures`."""
        rotations, wrists, q1 = self._wrists(positions, turns, self._samples(0, _SAMPLES, home))
        rows = q1.shape[1]
        q1, goals = q1.ravel(), np.repeat(wrists.T, rows, axis=1)
        away, q4, strain = self._bent(q1, self.elbow, goals)
        q4 = self._wrapped(q4[:, None], slice(3, 4))
        kept = np.flatnonzero((strain == 0.0) & self._within(q4, slice(3, 4)))
        number = kept % len(q1)
        q2, q3, strain = self._pointed(q4[kept, 0], self.wrist[:, None], away[:, number])
        twice = np.concatenate([number, number])
        found = np.stack([q1[twice], q2, q3, np.concatenate([q4[kept, 0]] * 2)], axis=1)
        found[:, :3] = self._wrapped(found[:, :3], slice(0, 3))
        kept = np.flatnonzero((strain == 0.0) & self._within(found, slice(0, 4)))
        found, target = found[kept], twice[kept] // rows
        wrist, strain = self._to_turn(found, rotations, target)
        found = np.concatenate([np.concatenate([found, found]), self._wrapped(wrist, slice(4, 7))], axis=1)
        target = np.concatenate([target, target])
        kept = np.flatnonzero((np.concatenate([strain, strain]) == 0.0) & self._within(found, slice(0, 7)))
        found, target = found[kept], target[kept]
        return [found[target == number] for number in range(len(positions))]

    def closer(self, position: Array, turn: Array, misses: Array) -> tuple[Array, Array]:
        """Return postures (n, 7) for positions of joint 1 between the samples of :meth:`postures`, and strains (n,).

        The target has a position (3,) in the base link, m, and an orientation (3, 3). ``misses`` (k, 7) are postures
        that may be near solutions.
        """
        step = float(self.upper[0] - self.lower[0]) / (_SAMPLES - 1)  # angle between samples of joint 1, rad
        values = (misses[:, :1] + np.linspace(-step, step, _SAMPLES_AROUND_A_MISS)).ravel()
        samples = distinct(np.clip(values, self.lower[0], self.upper[0]))
        (found,), (strain,) = self._by_target(1, *self._at_poses(position[None], turn[None], samples))
        return found, strain

    def _by_target(self, targets: int, branches: int, found: Array, strain: Array) -> tuple[Array, Array]:
        """Group results by target, and add the strain beyond limits; results are ordered by branch, then by target."""
        found = self._wrapped(found)
        beyond = np.maximum(np.maximum(self.lower - found, found - self.upper) - _ROUNDING, 0.0)
        strain = strain + beyond @ self.bounded
        each = targets, -1
        shape = branches, targets, len(found) // (branches * targets)
        return (
            found.reshape(*shape, 7).transpose(1, 0, 2, 3).reshape(*each, 7),
            strain.reshape(shape).transpose(1, 0, 2).reshape(each),
        )

    def miss(self, positions: Array, turns: Array | None) -> Array:
        """Return a lower bound (m,) of the distance in m between the tool and targets; see :meth:`postures`.

        For targets with an orientation, the bound is for the wrist with the exact orientation.
        """
        hand = self.wrist - self.tool[:3, 3]
        goals = positions if turns is None else positions + turns @ (self.tool[:3, :3].T @ hand)
        away = goals[:, None] - self.shoulders
        far = np.sqrt((away * away).sum(axis=2))
        slack = self.swing
        if turns is None:
            slack += float(np.linalg.norm(hand))
        short, long = self.span
        missed: Array = np.maximum(np.maximum(far.min(axis=1) - long, short - far.max(axis=1)) - slack, 0.0)
        return missed

    def _at_poses(self, positions: Array, turns: Array, samples: Array) -> tuple[int, Array, Array]:
        """Return the number of branches of the solution, the postures and their strains, for samples of joint 1."""
        rotations, wrists, q1 = self._wrists(positions, turns, samples)
        rows = q1.shape[1]
        arm, strain = self._to_point(q1.ravel(), self.wrist[:, None], np.repeat(wrists.T, rows, axis=1))
        wrist, short = self._to_turn(arm, rotations, np.tile(np.repeat(np.arange(len(positions)), rows), 4))
        return 8, np.concatenate([np.tile(arm, (2, 1)), wrist], axis=1), np.tile(strain + short, 2)

    def _wrists(self, positions: Array, turns: Array, samples: Array) -> tuple[Array, Array, Array]:
        """Return the tool's rotations from zero, the positions of the wrist, and positions (m, n) of joint 1."""
        rotations = turns @ self.tool[:3, :3].T
        wrists = positions + rotations @ (self.wrist - self.tool[:3, 3])
        return rotations, wrists, self._with_straight(wrists, samples)

    def _to_turn(self, arm: Array, rotations: Array, target: Indices) -> tuple[Array, Array]:
        """Return positions (2n, 3) of the wrist's joints that turn the hand to targets (n,), and their strains (n,)."""
        w = self.axes
        first, second, third, fourth = forward.transforms(self.rotations[:4], arm.T)
        # the wrist's rotation is the hand's rotation without the rotations of joints 1 to 4
        left = (first @ second @ third @ fourth).transpose(0, 2, 1) @ rotations[target]
        q5, q6, short = two_turns(w[4], w[5], w[6][:, None], (left @ w[6]).T)
        outer, inner = forward.transforms(self.rotations[4:6], np.array([q5.ravel(), q6.ravel()]))
        side = np.concatenate([left @ self.hand[0]] * 2)
        across, beside = self.hand @ ((outer @ inner).transpose(0, 2, 1) @ side[:, :, None])[:, :, 0].T
        return np.array([q5.ravel(), q6.ravel(), np.arctan2(beside, across)]).T, short

    def _at_positions(self, positions: Array, home: Array) -> tuple[int, Array, Array]:
        """Return the result of :meth:`_at_poses` for positions with any orientation."""
        w = self.axes
        q1, *wrist = (
            self._samples(joint, n, home) for joint, n in zip((0, 4, 5), _SAMPLES_FOR_A_POSITION, strict=True)
        )
        q1 = self._with_straight(positions, q1)
        q5, q6 = (np.tile(grid.ravel(), q1.size) for grid in np.meshgrid(*wrist, indexing="ij"))
        q1 = np.repeat(q1.ravel(), len(q5) // q1.size)
        tool = (self.tool[:3, 3] - self.wrist)[:, None]
        for joint, angle in ((6, home[6:]), (5, q6), (4, q5)):
            tool = turned(w[joint], angle, tool)
        goals = np.repeat(positions.T, len(q1) // len(positions), axis=1)
        arm, strain = self._to_point(q1, self.wrist[:, None] + tool, goals)
        rest = (np.tile(values, len(strain) // len(q1)) for values in (q5, q6, np.full(len(q1), home[6])))
        return 4, np.column_stack([arm, *rest]), strain

    def _to_point(self, q1: Array, point: Array, goals: Array) -> tuple[Array, Array]:
        """Return positions (4n, 4) of joints 1 to 4 that move a point of the forearm to goals, and their strains."""
        away, q4, strain = self._bent(q1, _hinge(self.origins[3], self.axes[3], point, self.shoulder), goals)
        q2, q3, short = self._pointed(q4, twice(point), twice(away))
        return np.stack([np.tile(q1, 4), q2, q3, np.tile(q4, 2)], axis=1), np.tile(strain, 2) + short

    def _bent(self, q1: Array, elbow: Hinge, goals: Array) -> tuple[Array, Array, Array]:
        """Return vectors (3, n) from the shoulder to goals without joint 1; positions (2n,) of joint 4; strains."""
        base = self.origins[0][:, None]
        away = base + turned(self.axes[0], -q1, goals - base) - self.shoulder[:, None]
        q4, strain = opened(elbow, np.sqrt((away * away).sum(axis=0)))
        return away, q4.ravel(), np.concatenate([strain, strain])

    def _pointed(self, q4: Array, point: Array, away: Array) -> tuple[Array, Array, Array]:
        """Return positions (2n,) of joints 2 and 3 that move a point of the forearm to vectors (3, n), and strains."""
        elbow = self.origins[3][:, None]
        bent = turned(self.axes[3], q4, point - elbow) + elbow - self.shoulder[:, None]
        q2, q3, short = two_turns(self.axes[1], self.axes[2], bent, away)
        return q2.ravel(), q3.ravel(), np.concatenate([short, short])

    def _samples(self, joint: int, count: int, home: Array) -> Array:
        """Return samples of a joint's positions over its range, and its position at home."""
        low, high = float(self.lower[joint]), float(self.upper[joint])
        spread = np.linspace(low, high, count, endpoint=bool(self.bounded[joint]))
        return np.append(spread, min(max(float(home[joint]), low), high))

    def _with_straight(self, points: Array, samples: Array) -> Array:
        """Return positions (m, n) of joint 1: the samples, and the position that points at each target."""
        base = self.origins[0][:, None]
        straight = angle_between(self.axes[0], self.shoulder[:, None] - base, points.T - base)
        values = np.empty((len(points), len(samples) + 1))
        values[:, :-1] = samples
        values[:, -1] = np.minimum(np.maximum(straight, self.lower[0]), self.upper[0])
        return values

    def _wrapped(self, postures: Array, joints: slice = slice(None)) -> Array:
        """Return equivalent angles of joints that are as near as possible to the middle of the joints' ranges."""
        middle = (self.lower[joints] + self.upper[joints]) / 2
        return middle + (postures - middle + np.pi) % (2 * np.pi) - np.pi

    def _within(self, postures: Array, joints: slice) -> Flags:
        """Return whether positions (n, joints) of some joints are within the limits."""
        beyond = np.maximum(self.lower[joints] - postures, postures - self.upper[joints]) > _ROUNDING
        beyond &= self.bounded[joints]
        within: Flags = ~np.any(beyond, axis=1)
        return within


def _meeting(a: Array, along_a: Array, b: Array, along_b: Array) -> Array | None:
    """Return the intersection of two axes; None if they don't meet."""
    if _parallel(along_a, along_b):
        return None
    (s, t), *_ = np.linalg.lstsq(np.column_stack([along_a, -along_b]), b - a, rcond=None)
    on_a, on_b = a + s * along_a, b + t * along_b
    return (on_a + on_b) / 2 if float(np.linalg.norm(on_a - on_b)) < _MEET else None


def _hinge(origin: Array, axis: Array, points: Array, end: Array) -> Hinge:
    """Return how the angle about an axis determines the distance between points (3, n) and a fixed point."""
    return hinge(axis, points - origin[:, None], (end - origin)[:, None])


def _radius(point: Array, origin: Array, axis: Array) -> float:
    return float(np.linalg.norm(np.cross(point - origin, axis)))


def _parallel(a: Array, b: Array) -> bool:
    return float(np.linalg.norm(np.cross(a, b))) < 1e-6


def turned(axis: Array, angle: Array, vector: Array) -> Array:
    """Return vectors turned about an axis through the origin (Rodrigues' formula)."""
    along, across, beside = _parts(axis, vector)
    return along + np.cos(angle) * across + np.sin(angle) * beside


def _parts(axis: Array, vector: Array) -> tuple[Array, Array, Array]:
    """Return parts of vectors: along an axis, perpendicular to the axis, and the latter after a quarter turn."""
    along, across, beside = (_split(axis.tobytes()) @ vector).reshape(3, 3, -1)
    return along, across, beside


@lru_cache(maxsize=256)
def _split(axis: bytes) -> Array:
    """Return the matrix (9, 3) for :func:`_parts`, from a cache, because arms have few axes."""
    x, y, z = unit = np.frombuffer(axis)
    along = np.outer(unit, unit)
    return np.vstack([along, np.eye(3) - along, [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]])


def _dot(some: Array, others: Array) -> Array:
    products: Array = np.einsum("in,in->n", some, others)
    return products


def angle_between(axis: Array, start: Array, end: Array) -> Array:
    """Return the angle about an axis from one vector to another, without their parts along the axis: subproblem 1."""
    _, across, beside = _parts(axis, start)
    return np.arctan2(_dot(beside, end), _dot(across, end))


def two_turns(first: Array, second: Array, start: Array, end: Array) -> tuple[Array, Array, Array]:
    """Return two angles about two axes through the origin, not parallel, that turn a vector to another: subproblem 2.

    The vector ``start`` is turned about ``second`` and then about ``first``. Only the direction of ``end`` counts. Both
    solutions are returned: angles (2, n) about the first axis, angles (2, n) about the second axis, and strains (n,).
    """
    cosine, sine, outer_frame, inner_frame = _crossing(first.tobytes(), second.tobytes())
    # components of both vectors: along the other axis, perpendicular to both axes, and along their own axis
    x, y, z = inner_frame @ start
    squares = x * x + y * y
    lengths = squares + z * z
    ends = outer_frame @ end
    u, v, w = ends * np.sqrt(lengths / np.maximum((ends * ends).sum(axis=0), 1e-12))
    # between the turns, the vector has the components along both axes, and one of two perpendicular components
    inner, outer = (w - cosine * z) / sine, (z - cosine * w) / sine
    rest = squares - inner * inner
    across = np.sqrt(np.maximum(rest, 0.0))
    inner, outer = np.arctan2(across, inner), np.arctan2(across, outer)
    before, after = np.arctan2(y, x), np.arctan2(v, u)
    return (
        np.array([after - outer, after + outer]),
        np.array([-inner - before, inner - before]),
        np.sqrt(np.maximum(-rest / (sine * sine * np.maximum(lengths, 1e-12)) - _ROUNDING_ANGLE, 0.0)),
    )


@lru_cache(maxsize=64)
def _crossing(first: bytes, second: bytes) -> tuple[float, float, Array, Array]:
    """Return cosine and sine between two axes, and frames (3, 3): towards the other axis, across both, along one."""
    a, b = np.frombuffer(first), np.frombuffer(second)
    cosine = float(a @ b)
    sine = math.sqrt(1.0 - cosine * cosine)
    frames = []
    for axis, beside in ((a, b), (b, a)):
        towards = (beside - cosine * axis) / sine
        frames.append(np.stack([towards, np.cross(axis, towards), axis]))
    return cosine, sine, frames[0], frames[1]


def twice(vectors: Array) -> Array:
    """Return vectors (3, 2n): the vectors (3, n) twice; a single vector (3, 1) is returned unchanged."""
    return vectors if vectors.shape[1] == 1 else np.concatenate([vectors, vectors], axis=1)


def hinge(axis: Array, start: Array, end: Array) -> Hinge:
    """Return the part of subproblem 3 that doesn't depend on the distance between a turned and a fixed point.

    The three arrays (n,) or (1,) are the angle of the least distance, the mean of the squares of the least and the
    greatest distance, and half of the difference of these squares.
    """
    _, a, beside = _parts(axis, start)
    _, b, _ = _parts(axis, end)
    apart = axis @ (start - end)
    squares = _dot(a, a), _dot(b, b)
    straight = np.arctan2(_dot(beside, b), _dot(a, b))
    return straight, squares[0] + squares[1] + apart * apart, 2.0 * np.sqrt(squares[0] * squares[1])


def opened(hinge: Hinge, distance: Array) -> tuple[Array, Array]:
    """Return the angles about an axis that move a point to distances (n,) in m from another point: subproblem 3.

    The angles (2, n) are both solutions; the other result is their strain (n,).
    """
    straight, mean, half = hinge
    cosine = (mean - distance * distance) / np.maximum(half, 1e-12)
    away = np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0))
    strain = np.sqrt(2.0 * np.maximum(np.abs(cosine) - 1.0 - _ROUNDING_ANGLE, 0.0))
    return np.array([straight + away, straight - away]), strain
