"""Inverse kinematics that keeps to joint limits and leaves no trace: arithmetic on the URDF, no engine.

Arms that can be solved in closed form are (:mod:`pycram.reasoning.closed_form`). What that misses, and every other arm,
is searched by damped least squares from many starting postures at once, each projected onto the joint limits at every
step: the nearest misses, or else the present posture, the named ones and a fixed low-discrepancy sequence. Everything
is deterministic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.closed_form import ClosedForm
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from recorder.urdf import Urdf
    from recorder.urdf_joint import Joint

    Array = NDArray[np.float64]

POSITION_TOLERANCE: Final = 1e-3  # m
TURN_TOLERANCE: Final = 1e-2  # rad
_DAMPING: Final = 1e-2
_ITERATIONS: Final = 40
_LONGEST_STEP: Final = 0.5  # rad or m a joint moves in one iteration
_BATCHES: Final = (4, 28)  # starting postures: a few first, as most targets are easy
_STALE: Final = (8, 0.9)  # iterations in which the nearest start's error has to fall by so much, or the search ends
_CLOSE: Final = 0.02  # m or rad of error below which a search is never given up
_CHUNK: Final = 16  # targets that are solved at once
_COMPARED: Final = 60  # misses of the closed form
_NEAREST: Final = 6  # misses of the closed form that are searched from
_DIFFERENT: Final = 0.35  # rad or m in some joint between postures that count as two
_MOST: Final = 16  # postures that are told of
_STRAINED: Final = 1.0  # rad of strain beyond which there is no solution nearby
_SEARCHED: Final = 0.6  # rad of strain that a search has ever overcome
_HOPELESS: Final = 0.02  # m of a proven miss beyond which no search is worth its time
_PRIMES: Final = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29)


@dataclass(frozen=True, slots=True)
class Posture:
    """A posture that was found.

    Attributes:
        positions: joint values in rad or m by name, within limits.
        position_error: m that the tool stays away from the target.
        turn_error: rad by which it is turned from the target; 0 where none was asked for.
        reached: both are within tolerance.
    """

    positions: Mapping[str, float]
    position_error: float
    turn_error: float
    reached: bool


@dataclass(frozen=True, slots=True)
class _Link:
    """One moving joint.

    Attributes:
        before: (4, 4) from the joint before it, at its zero.
        axis: its axis.
        cross: (3, 3) matrix of the cross product with the axis.
        square: its square.
        slides: whether it is prismatic.
    """

    before: Array
    axis: Array
    cross: Array
    square: Array
    slides: bool

    @classmethod
    def of(cls, before: Array, joint: Joint) -> _Link:
        """Of a joint of a URDF."""
        x, y, z = axis = np.asarray(joint.axis, dtype=np.float64)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return cls(before, axis, cross, cross @ cross, joint.type == "prismatic")

    def motion(self, values: Array) -> Array:
        """Transforms (n, 4, 4) at values (n,)."""
        moved = np.zeros((len(values), 4, 4))
        moved[:, 3, 3] = 1.0
        if self.slides:
            moved[:, :3, :3] = np.eye(3)
            moved[:, :3, 3] = values[:, None] * self.axis
        else:
            sine, cosine = np.sin(values)[:, None, None], np.cos(values)[:, None, None]
            moved[:, :3, :3] = np.eye(3) + sine * self.cross + (1 - cosine) * self.square
        return moved


class ArmKinematics:
    """A chain of joints with a tool at its end.

    Args:
        urdf: of the robot.
        base_link: the link that targets are given in.
        tool_link: the link that is to reach them.
        joints: names of the joints that may move, in order; others of the chain keep their value.
        fixed: values of those others; 0 by default.
    """

    def __init__(
        self,
        urdf: Urdf,
        base_link: str,
        tool_link: str,
        joints: Sequence[str],
        fixed: Mapping[str, float] | None = None,
    ) -> None:
        self.joints = tuple(joints)
        values = fixed or {}
        self._links: list[_Link] = []
        lower, upper = [], []
        before = np.eye(4)
        for joint in urdf.chain(base_link, tool_link):
            if joint.name in self.joints:
                before = before @ geometry.pose_matrix(joint.pose(0.0))
                self._links.append(_Link.of(before, joint))
                lower.append(joint.lower)
                upper.append(joint.upper)
                before = np.eye(4)
            else:
                before = before @ geometry.pose_matrix(joint.pose(values.get(joint.name, 0.0)))
        self._tool = before
        self._sliding = [index for index, link in enumerate(self._links) if link.slides]
        self._bounded = np.isfinite(np.array(lower))
        self._lower = np.where(self._bounded, lower, -np.pi)
        self._upper = np.where(self._bounded, upper, np.pi)
        pose, origins, axes = np.eye(4), [], []
        for link in self._links:
            pose = pose @ link.before
            origins.append(pose[:3, 3])
            axes.append(pose[:3, :3] @ link.axis)
        self._closed: ClosedForm | None = None
        if not self._sliding:
            self._closed = ClosedForm.of(
                np.array(origins), np.array(axes), pose @ before, self._lower, self._upper, self._bounded
            )
        self.length = float(
            sum(np.linalg.norm(link.before[:3, 3]) for link in self._links[1:]) + np.linalg.norm(before[:3, 3])
        )
        self.shoulder: Array = self._links[0].before[:3, 3] if self._links else np.zeros(3)
        self.length += float(sum(max(abs(self._lower[i]), abs(self._upper[i])) for i in self._sliding))

    def forward(self, postures: Array) -> tuple[Array, Array]:
        """Where the tool is, and how it moves.

        Args:
            postures: (n, joints).

        Returns:
            Poses (n, 4, 4) of the tool in the base link, and Jacobians (n, 6, joints): linear, then angular.
        """
        count = len(postures)
        pose = np.broadcast_to(np.eye(4), (count, 4, 4))
        origins, axes = [], []
        for index, link in enumerate(self._links):
            pose = pose @ link.before
            origins.append(pose[:, :3, 3])
            axes.append(pose[:, :3, :3] @ link.axis)
            pose = pose @ link.motion(postures[:, index])
        pose = pose @ self._tool
        at = pose[:, :3, 3]
        turning = np.stack(axes, axis=2)  # (n, 3, joints)
        lever = at[:, :, None] - np.stack(origins, axis=2)
        linear = np.stack(  # the cross product, spelt out: np.cross is ten times slower on arrays this small
            [
                turning[:, 1] * lever[:, 2] - turning[:, 2] * lever[:, 1],
                turning[:, 2] * lever[:, 0] - turning[:, 0] * lever[:, 2],
                turning[:, 0] * lever[:, 1] - turning[:, 1] * lever[:, 0],
            ],
            axis=1,
        )
        for index in self._sliding:
            linear[:, :, index] = turning[:, :, index]
            turning[:, :, index] = 0.0
        return pose, np.concatenate([linear, turning], axis=1)

    def poses(self, postures: Array) -> Array:
        """Poses (n, 4, 4) of the tool in the base link for postures (n, joints)."""
        pose = np.broadcast_to(np.eye(4), (len(postures), 4, 4))
        for index, link in enumerate(self._links):
            pose = pose @ link.before @ link.motion(postures[:, index])
        return pose @ self._tool

    def solve(
        self,
        position: Sequence[float],
        orientation: Sequence[float] | None = None,
        seeds: Iterable[Mapping[str, float]] = (),
    ) -> Posture:
        """Finds a posture that brings the tool to a target, near the first seed if there are several.

        Args:
            position: xyz in the base link, m.
            orientation: xyzw in the base link; None if any will do.
            seeds: postures to start from first.

        Returns:
            The posture; the nearest miss if none reaches.
        """
        return self.solve_all(position, orientation, seeds)[0]

    def solve_all(
        self,
        position: Sequence[float],
        orientation: Sequence[float] | None = None,
        seeds: Iterable[Mapping[str, float]] = (),
        *,
        thorough: bool = False,
        quick: bool = False,
        enough: float = POSITION_TOLERANCE,
    ) -> list[Posture]:
        """As :meth:`solve`, but all distinct postures found: those that reach, nearest to the first seed first.

        Args:
            position: xyz in the base link, m.
            orientation: xyzw in the base link; None if any will do.
            seeds: postures to start from first.
            thorough: start from all starting postures even if some reach soon.
            quick: start from a few only; a miss then proves nothing.
            enough: m to the target that a miss has to come near for being of any use.

        Returns:
            At least one; if the first doesn't reach, none does.
        """
        goal = np.asarray(position, dtype=np.float64)
        turn = None if orientation is None else geometry.to_matrix(orientation)
        first = [np.array([seed.get(name, 0.0) for name in self.joints]) for seed in seeds]
        home = self._limited(first[0] if first else np.zeros(len(self.joints)))
        if self._closed is not None:
            found, batches = self._written(self._closed, goal, turn, home, enough)
        else:
            found, batches = self._scattered(goal, home, first)
        if quick:
            batches = batches[:1] if self._closed is None else []
        tried = [found]
        for batch in batches:
            postures, reached = self._descend(batch, goal, turn, stop_early=not thorough)
            tried.append(postures)
            if reached.any() and not thorough:
                break
        found = np.vstack(tried)
        misses = self._misses(found, goal, turn)
        reaching = found[(misses < 1.0).all(axis=1)]
        if len(reaching):
            return self._told(self._distinct(reaching, home), goal, turn)
        return self._told(found[[int(np.argmin(misses.sum(axis=1)))]], goal, turn)

    def _written(
        self, closed: ClosedForm, goal: Array, turn: Array | None, home: Array, enough: float
    ) -> tuple[Array, list[Array]]:
        """Postures in closed form: solutions, or else misses and from which of them to search."""
        patience = math.inf if enough > _HOPELESS else 1.0
        (found,), (strain,) = closed.postures(goal[None], None if turn is None else turn[None], home)
        if (strain == 0.0).any():
            return self._distinct(found[strain == 0.0], home), []
        misses = self._nearest(found, strain, goal, turn)
        if strain.min() > patience * _STRAINED or closed.miss(goal, turn) > max(_HOPELESS, enough):
            return misses[:1], []
        if turn is not None:
            narrow, strain = closed.closer(goal, turn, misses)
            if (strain == 0.0).any():
                return self._distinct(narrow[strain == 0.0], home), []
            misses = self._nearest(narrow, strain, goal, turn)
        return misses, [misses] if strain.min() < patience * _SEARCHED else []

    def _scattered(self, goal: Array, home: Array, seeds: list[Array]) -> tuple[Array, list[Array]]:
        """Where to search from if nothing is known: the stretched arm if that is too short, else all over its range."""
        few, many = _BATCHES
        if float(np.linalg.norm(goal - self.shoulder)) - self.length > POSITION_TOLERANCE:
            return self._descend(home[None], goal, None, stop_early=True)[0], []
        return home[None], [np.vstack([home, *seeds, *self._samples(0, few)]), self._samples(few, many)]

    def _misses(self, postures: Array, goal: Array, turn: Array | None) -> Array:
        """Errors (n, 2) of position and orientation, in tolerances, for one target or one for each."""
        pose = self.poses(postures)
        misses = np.zeros((len(postures), 2))
        misses[:, 0] = np.linalg.norm(pose[:, :3, 3] - goal, axis=1) / POSITION_TOLERANCE
        if turn is not None:
            misses[:, 1] = np.linalg.norm(_turn_error(pose[:, :3, :3], turn), axis=1) / TURN_TOLERANCE
        return misses

    def at_once(
        self, targets: Sequence[tuple[Sequence[float], Sequence[float] | None]], seed: Mapping[str, float]
    ) -> list[list[Posture]]:
        """What closed form says of many targets, in a fraction of the time; searches nothing.

        Args:
            targets: positions in m and orientations xyzw in the base link; orientations for all or for none.
            seed: a posture; postures near it come first.

        Returns:
            For each target the postures that reach it; an empty list says nothing.
        """
        if self._closed is None:
            return [[] for _ in targets]
        home = self._limited(np.array([seed.get(name, 0.0) for name in self.joints]))
        told: list[list[Posture]] = []
        for start in range(0, len(targets), _CHUNK):
            chunk = targets[start : start + _CHUNK]
            goals = np.array([position for position, _ in chunk], dtype=np.float64)
            turns = [None if turn is None else geometry.to_matrix(turn) for _, turn in chunk]
            matrices = [turn for turn in turns if turn is not None]
            if matrices:
                exact = self._closed.solutions(goals, np.array(matrices), home)
            else:
                found, strain = self._closed.postures(goals, None, home)
                exact = [ways[strains == 0.0] for ways, strains in zip(found, strain, strict=True)]
            kept = [self._distinct(ways, home) if len(ways) else ways for ways in exact]
            which = np.repeat(np.arange(len(chunk)), [len(ways) for ways in kept])
            rows = self._told(np.concatenate(kept), goals[which], np.array(matrices)[which] if matrices else None)
            told += [[rows[row] for row in np.flatnonzero(which == number)] for number in range(len(chunk))]
        return told

    def _distinct(self, found: Array, home: Array) -> Array:
        """Postures that differ from each other, nearest to another first."""
        return self._different(found[np.argsort(np.abs(found - home).sum(axis=1), kind="stable")], _MOST)

    def _nearest(self, found: Array, strain: Array, goal: Array, turn: Array | None) -> Array:
        """Of the least strained misses those that come nearest within the limits, and differ from each other."""
        found = self._limited(found[np.argsort(strain, kind="stable")[:_COMPARED]])
        misses = self._misses(found, goal, turn).sum(axis=1)
        return self._different(found[np.argsort(misses, kind="stable")], _NEAREST)

    @staticmethod
    def _different(found: Array, most: int) -> Array:
        kept: list[Array] = []
        while len(found) and len(kept) < most:
            kept.append(found[0])
            found = found[np.abs(found - found[0]).max(axis=1) > _DIFFERENT]
        return np.array(kept)

    def _samples(self, start: int, count: int) -> Array:
        """Postures spread over joint space: a Halton sequence."""
        spread = _halton(start, count, len(self.joints))
        samples: Array = self._lower + spread * (self._upper - self._lower)
        return samples

    def _descend(
        self, start: Array, goal: Array, turn: Array | None, *, stop_early: bool
    ) -> tuple[Array, NDArray[np.bool_]]:
        postures = self._limited(start)
        rows = 3 if turn is None else 6
        reached = np.zeros(len(postures), dtype=bool)
        damping = _DAMPING * np.eye(rows)
        best = np.inf
        for iteration in range(_ITERATIONS):
            pose, jacobian = self.forward(postures)
            error = np.zeros((len(postures), rows))
            error[:, :3] = goal - pose[:, :3, 3]
            near = np.linalg.norm(error[:, :3], axis=1) < 0.5 * POSITION_TOLERANCE
            if turn is not None:
                error[:, 3:] = _turn_error(pose[:, :3, :3], turn)
                near &= np.linalg.norm(error[:, 3:], axis=1) < 0.5 * TURN_TOLERANCE
            reached = near
            if near.all() or (stop_early and near.any()):
                break
            length = np.linalg.norm(error, axis=1, keepdims=True)
            if iteration % _STALE[0] == 0:
                nearest = float(length.min())
                if nearest > _STALE[1] * best and nearest > _CLOSE:
                    break
                best = nearest
            pull = error * np.minimum(1.0, 0.6 / np.maximum(length, 1e-9))
            j = jacobian[:, :rows]
            # a joint at its limit that wants to go beyond takes no part
            gradient = np.einsum("nrj,nr->nj", j, pull)
            stuck = self._bounded & (
                ((postures <= self._lower + 1e-9) & (gradient < 0))
                | ((postures >= self._upper - 1e-9) & (gradient > 0))
            )
            j = np.where(stuck[:, None, :], 0.0, j)
            scale = np.minimum(1.0, (error**2).sum(axis=1))[:, None, None] + 1e-4
            inner = np.linalg.solve(j @ j.transpose(0, 2, 1) + damping * scale, pull[:, :, None])
            step = (j.transpose(0, 2, 1) @ inner)[:, :, 0]
            step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-9))
            postures = self._limited(np.where(near[:, None], postures, postures + step))
        return postures, reached

    def _limited(self, postures: Array) -> Array:
        wrapped = (postures + np.pi) % (2 * np.pi) - np.pi
        inside: Array = np.where(self._bounded, np.clip(postures, self._lower, self._upper), wrapped)
        return inside

    def _told(self, postures: Array, goal: Array, turn: Array | None) -> list[Posture]:
        postures = self._limited(postures)
        errors = self._misses(postures, goal, turn)
        reached = (errors < 1.0).all(axis=1)
        errors *= (POSITION_TOLERANCE, TURN_TOLERANCE)
        return [
            Posture(dict(zip(self.joints, values.tolist(), strict=True)), float(away), float(turned), bool(there))
            for values, (away, turned), there in zip(postures, errors, np.atleast_1d(reached), strict=True)
        ]


def _turn_error(now: Array, goal: Array) -> Array:
    """Rotation vectors (n, 3) in the base link that turn postures' orientations into the goal."""
    difference = goal @ now.transpose(0, 2, 1)
    vector = 0.5 * np.stack(
        [
            difference[:, 2, 1] - difference[:, 1, 2],
            difference[:, 0, 2] - difference[:, 2, 0],
            difference[:, 1, 0] - difference[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(vector, axis=1)
    cosine = 0.5 * (np.trace(difference, axis1=1, axis2=2) - 1)
    angle = np.arctan2(sine, cosine)
    # near half a turn the vector vanishes: any axis helps out of there
    flipped = (sine < 1e-6) & (cosine < 0)
    vector[flipped] = np.array([1e-3, 2e-3, 3e-3])
    sine = np.where(flipped, np.linalg.norm(vector, axis=1), sine)
    error: Array = vector * (angle / np.maximum(sine, 1e-12))[:, None]
    return error


@cache
def _halton(start: int, count: int, dimensions: int) -> Array:
    """Points (count, dimensions) of the Halton sequence."""
    return np.array(
        [[_radical_inverse(i + 1, _PRIMES[j]) for j in range(dimensions)] for i in range(start, start + count)]
    )


def _radical_inverse(index: int, base: int) -> float:
    result, fraction = 0.0, 1.0 / base
    while index:
        result += fraction * (index % base)
        index //= base
        fraction /= base
    return result
