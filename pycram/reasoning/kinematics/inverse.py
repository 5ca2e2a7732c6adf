"""Inverse kinematics within joint limits: in closed form if possible, otherwise by a search from many postures.

:mod:`pycram.reasoning.kinematics.closed_form` solves arms with a closed form. For other arms, and for misses of the
closed form, damped least squares search from near postures, named postures, and postures of a Halton sequence (Buss,
Introduction to Inverse Kinematics with Jacobian Transpose, Pseudoinverse and Damped Least Squares Methods, 2004).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

import numpy as np

from pycram.reasoning.kinematics.closed_form import ClosedForm
from pycram.reasoning.kinematics.forward import Chain, norms, rotation_error
from recorder import geometry
from recorder.geometry import IDENTITY, Array, Flags, Indices, Pose, PoseLike, Quaternion, Vector

if TYPE_CHECKING:
    from pycram.world.object import Object

    Target = tuple[Sequence[float], Sequence[float] | None]
    WorldTarget = tuple[Sequence[float], Sequence[float] | None, PoseLike | None]

POSITION_TOLERANCE: Final = 1e-3  # m
TURN_TOLERANCE: Final = 1e-2  # rad
_DAMPING: Final = 1e-2
_ITERATIONS: Final = 40
_MAX_STEP: Final = 0.5  # largest motion in rad or m of a joint in one iteration
_MAX_ERROR: Final = 0.6  # largest error in m or rad that one iteration corrects
_STALE: Final = (8, 0.9)  # a search ends if 8 iterations leave more than this share of its least error
_CLOSE: Final = 0.005  # a search with a smaller error in m or rad always continues
THRESHOLD: Final = 1e-3  # largest distance in m between the tool and a reached target (thesis 4.4.5)
_TURN_THRESHOLD: Final = math.radians(2)  # largest angle in rad between equal orientations
_BATCHES: Final = (4, 28)  # numbers of starting postures; first a few, because most targets are easy
_CHUNK: Final = 32  # maximum number of targets that are solved together
_MAX_COMPARED: Final = 60  # number of the closed form's misses that are compared
_MAX_STARTS: Final = 6  # maximum number of the closed form's misses that are starts of a search
_DIFFERENT: Final = 0.35  # minimum difference in rad or m of a joint between distinct postures
_MAX_POSTURES: Final = 16  # maximum number of returned postures
_MAX_STRAIN: Final = 1.0  # a posture with a larger strain in rad has no solution nearby
_MAX_SEARCHED: Final = 0.6  # largest strain in rad of a posture from which a search may succeed
_HOPELESS: Final = 0.02  # for a target that is farther out of reach, in m, a search is useless
_TOLERANCES: Final = (POSITION_TOLERANCE, TURN_TOLERANCE)
_MAX_CHAINS: Final = 16  # number of cached chains of a robot


def search_postures(
    chain: Chain, start: Array, goals: Array, turns: Array | None, targets: Indices, *, stop_early: bool
) -> tuple[Array, Flags]:
    """Search for postures that reach targets, from several starts for each target, all together.

    The results for a target don't depend on the other targets.

    Args:
        start: (n, joints) starting postures.
        goals: (n, 3) positions of the tool for each start, in the chain's base link, m.
        turns: (n, 3, 3) orientations of the tool; None for any orientation.
        targets: (n,) index of the target for each start, in ascending order.
        stop_early: whether the search for a target ends with the first posture that reaches it.

    Returns:
        (n, joints) postures, and whether they reach their targets.
    """
    found = chain.limited(start)
    reached = np.zeros(len(found), dtype=bool)
    rows = np.arange(len(found))  # indices of unfinished searches
    size = 3 if turns is None else 6
    damping = _DAMPING * np.eye(size)
    nearest = np.full(int(targets.max(initial=-1)) + 1, np.inf)
    first = _first_rows(targets)
    for iteration in range(_ITERATIONS):
        postures = found[rows]
        pose, jacobian = chain.forward(postures)
        error = np.zeros((len(rows), size))
        error[:, :3] = goals[rows] - pose[:, :3, 3]
        near = norms(error[:, :3]) < 0.5 * POSITION_TOLERANCE
        if turns is not None:
            error[:, 3:] = rotation_error(pose[:, :3, :3], turns[rows])
            near &= norms(error[:, 3:]) < 0.5 * TURN_TOLERANCE
        reached[rows] = near
        length = norms(error)
        ended = (np.logical_or if stop_early else np.logical_and).reduceat(near, first)
        if iteration % _STALE[0] == 0:
            which = targets[rows[first]]
            least = np.minimum.reduceat(length, first)
            ended |= (least > _STALE[1] * nearest[which]) & (least > _CLOSE)
            nearest[which] = least
        if ended.any():
            going = ~np.repeat(ended, np.diff(first, append=len(rows)))
            if not going.any():
                break
            rows, postures, near, error, length = (part[going] for part in (rows, postures, near, error, length))
            jacobian, first = jacobian[going], _first_rows(targets[rows])
        slopes = jacobian[:, :size]
        correction = error * np.minimum(1.0, _MAX_ERROR / np.maximum(length[:, None], 1e-9))
        gradient = np.einsum("nrj,nr->nj", slopes, correction)  # a joint at its limit doesn't move farther
        stuck = chain.bounded & (
            ((postures <= chain.lower + 1e-9) & (gradient < 0)) | ((postures >= chain.upper - 1e-9) & (gradient > 0))
        )
        j = np.where(stuck[:, None, :], 0.0, slopes)
        scale = np.minimum(1.0, (error**2).sum(axis=1))[:, None, None] + 1e-4
        inner = np.linalg.solve(j @ j.transpose(0, 2, 1) + damping * scale, correction[:, :, None])
        step: Array = (j.transpose(0, 2, 1) @ inner)[:, :, 0]
        step *= np.minimum(1.0, _MAX_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-9))
        found[rows] = chain.limited(np.where(near[:, None], postures, postures + step))
    return found, reached


def _first_rows(targets: Indices) -> Indices:
    """Return the first row of each target; ``targets`` has the target's index for each row, in ascending order."""
    return np.flatnonzero(np.diff(targets, prepend=-1))


def halton_postures(chain: Chain, start: int, count: int) -> Array:
    """Return postures (count, joints) over a chain's range, from the index ``start`` of a Halton sequence on."""
    postures: Array = chain.lower + _halton(start, count, len(chain.joints)) * (chain.upper - chain.lower)
    return postures


@cache
def _halton(start: int, count: int, dimensions: int) -> Array:
    """Return points (count, dimensions) of the Halton sequence from an index on."""
    primes: list[int] = []
    number = 2
    while len(primes) < dimensions:
        if all(number % prime for prime in primes):
            primes.append(number)
        number += 1
    return np.array([[_radical_inverse(i + 1, prime) for prime in primes] for i in range(start, start + count)])


def _radical_inverse(index: int, base: int) -> float:
    result, fraction = 0.0, 1.0 / base
    while index:
        result += fraction * (index % base)
        index //= base
        fraction /= base
    return result


@dataclass(frozen=True, slots=True)
class Posture:
    """A posture of an arm and its errors for a target."""

    positions: Mapping[str, float]  # joint positions within limits, in rad or m by name
    position_error: float  # distance in m between the tool and the target
    turn_error: float  # angle in rad between the tool and the target; 0 for a target without an orientation

    def reaches(self, threshold: float = THRESHOLD) -> bool:
        """Return whether the tool is within ``threshold`` m and 2 degrees of the target."""
        return self.position_error <= threshold and self.turn_error < _TURN_THRESHOLD

    def evidence(self) -> dict[str, object]:
        """Return the posture as evidence for a record."""
        return {"joints": self.positions, "distance": self.position_error, "turn": self.turn_error}


class ArmKinematics:
    """Inverse kinematics of a chain of joints."""

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        self._latest: tuple[object, tuple[Array, Flags] | None] = None, None  # inputs, results of a search
        self._closed: ClosedForm | None = None
        if chain.joints and not chain.sliding:
            self._closed = ClosedForm.of(*chain.at_zero(), chain.lower, chain.upper, chain.bounded)

    def solve(
        self,
        targets: Sequence[Target],
        seeds: Iterable[Mapping[str, float]] = (),
        *,
        thorough: bool = False,
        quick: bool = False,
        enough: float = POSITION_TOLERANCE,
    ) -> list[list[Posture]]:
        """Return distinct postures for targets, nearest to the first seed first; see :meth:`Solver.search`.

        The targets are in the base link. The search begins at the ``seeds``. A tool within ``enough`` m of its target
        is useful to the caller.
        """
        goals, turns = _arrays(targets)
        first = [np.array([seed.get(name, 0.0) for name in self.chain.joints]) for seed in seeds]
        home = self.chain.limited((first[0] if first else np.zeros(len(self.chain.joints)))[None])[0]
        if self._closed is not None:
            starts = self._starts_of_closed_form(self._closed, goals, turns, home, enough)
        else:
            starts = [self._starts_of_search(goal, home, first) for goal in goals]
        tried = [[known] for known, _ in starts]
        pending = list(range(len(starts)))
        for level in range(0 if quick and self._closed is not None else 1 if quick else len(_BATCHES)):
            pending = [number for number in pending if len(starts[number][1]) > level]
            if not pending:
                break
            batches = [starts[number][1][level] for number in pending]
            counts = [len(batch) for batch in batches]
            which = np.repeat(np.array(pending, dtype=np.intp), counts)
            turned = None if turns is None else turns[which]
            start, wanted, stop_early = np.vstack(batches), goals[which], not thorough
            # the latest result is kept: long searches begin as quick ones do
            key = stop_early, *(None if part is None else part.tobytes() for part in (start, wanted, which, turned))
            latest = self._latest[1] if self._latest[0] == key else None
            if latest is None:
                latest = search_postures(self.chain, start, wanted, turned, which, stop_early=stop_early)
                self._latest = key, latest
            found, reached = latest
            ends = np.cumsum(counts)[:-1]
            for number, postures in zip(pending, np.split(found, ends), strict=True):
                tried[number].append(postures)
            if not thorough:
                missed = zip(pending, np.split(reached, ends), strict=True)
                pending = [number for number, each in missed if not each.any()]
        chosen = []
        for number, (known, *more) in enumerate(tried):
            found = np.vstack([known, *more])
            if more:  # the distinct postures that reach the goal, or the nearest miss
                errors = self.chain.errors(found, goals[number], None if turns is None else turns[number])
                misses = errors / _TOLERANCES
                reaching = found[(misses < 1.0).all(axis=1)]
                found = _distinct(reaching, home) if len(reaching) else found[[int(np.argmin(misses.sum(axis=1)))]]
            chosen.append(found)
        return self._postures(chosen, goals, turns)

    @property
    def in_closed_form(self) -> bool:
        """Whether the arm has a closed form."""
        return self._closed is not None

    def closed_form(self, targets: Sequence[Target], seed: Mapping[str, float]) -> list[list[Posture]]:
        """Return the solutions of the closed form for many targets, much faster than a search.

        For the targets, see :meth:`solve`. Postures near the seed come first. If there is no posture for a target, the
        target may still be reachable.
        """
        solved: list[list[Posture]] = [[] for _ in targets]
        if self._closed is None or not targets:
            return solved
        goals, turns = _arrays(targets)
        home = self.chain.limited(np.array([[seed.get(name, 0.0) for name in self.chain.joints]]))[0]
        within = np.flatnonzero(self._closed.miss(goals, turns) == 0.0)
        for start in range(0, len(within), _CHUNK):
            chunk = within[start : start + _CHUNK]
            if turns is not None:
                exact = self._closed.solutions(goals[chunk], turns[chunk], home)
            else:
                found, strains = self._closed.postures(goals[chunk], None, home)
                exact = [rows[strain == 0.0] for rows, strain in zip(found, strains, strict=True)]
            exact = [_distinct(rows, home) for rows in exact]
            postures = self._postures(exact, goals[chunk], None if turns is None else turns[chunk])
            for number, each in zip(chunk.tolist(), postures, strict=True):
                solved[number] = each
        return solved

    def _starts_of_closed_form(
        self, closed: ClosedForm, goals: Array, turns: Array | None, home: Array, enough: float
    ) -> list[tuple[Array, list[Array]]]:
        """Return each target's closed-form solutions or misses, and batches of postures to start a search from."""
        slack = math.inf if enough > _HOPELESS else 1.0
        near = closed.miss(goals, turns) <= max(_HOPELESS, enough)
        found, strains = closed.postures(goals, turns, home)
        starts: list[tuple[Array, list[Array]]] = []
        for number, known in enumerate(self._least_strained(found, strains, home, goals, turns)):
            postures, least = known, float(strains[number].min())
            if turns is not None and near[number] and 0.0 < least <= slack * _MAX_STRAIN:
                rows = slice(number, number + 1)
                closer, strain = closed.closer(goals[number], turns[number], known)
                (postures,) = self._least_strained(closer[None], strain[None], home, goals[rows], turns[rows])
                least = float(strain.min())
            batches = [postures] if near[number] and 0.0 < least < slack * _MAX_SEARCHED else []
            starts.append((postures if batches or not least else postures[:1], batches))
        return starts

    def _least_strained(
        self, found: Array, strain: Array, home: Array, goals: Array, turns: Array | None
    ) -> list[Array]:
        """Return the solutions among targets' postures (m, n, joints), or else the postures with the least strain."""
        kept = [_distinct(rows[strains == 0.0], home) for rows, strains in zip(found, strain, strict=True)]
        missed = np.array([number for number, rows in enumerate(kept) if not len(rows)], dtype=np.intp)
        if len(missed):
            least = np.argsort(strain[missed], axis=1, kind="stable")[:, :_MAX_COMPARED]
            limited = self.chain.limited(found[missed[:, None], least])
            which = np.repeat(missed, least.shape[1])
            turned = None if turns is None else turns[which]
            errors = self.chain.errors(limited.reshape(len(which), -1), goals[which], turned) / _TOLERANCES
            for number, rows, misses in zip(missed, limited, errors.sum(axis=1).reshape(least.shape), strict=True):
                kept[number] = _different(rows[np.argsort(misses, kind="stable")], _MAX_STARTS)
        return kept

    def _starts_of_search(self, goal: Array, home: Array, seeds: list[Array]) -> tuple[Array, list[Array]]:
        """Return a posture and batches of starting postures; only the stretched arm for a target that is too far."""
        few, many = _BATCHES
        if float(np.linalg.norm(goal - self.chain.shoulder)) - self.chain.length > POSITION_TOLERANCE:
            one = np.zeros(1, dtype=np.intp)
            return search_postures(self.chain, home[None], goal[None], None, one, stop_early=True)[0], []
        starts = [
            np.vstack([home, *seeds, *halton_postures(self.chain, 0, few)]),
            halton_postures(self.chain, few, many),
        ]
        return home[None], starts

    def _postures(self, found: Sequence[Array], goals: Array, turns: Array | None) -> list[list[Posture]]:
        """Return the rows (n, joints) of each target as postures with their errors."""
        which = np.repeat(np.arange(len(goals)), [len(rows) for rows in found])
        every = self.chain.limited(np.concatenate(found))
        errors = self.chain.errors(every, goals[which], None if turns is None else turns[which])
        postures = iter(
            Posture(dict(zip(self.chain.joints, row, strict=True)), *error)
            for row, error in zip(every.tolist(), errors.tolist(), strict=True)
        )
        return [list(itertools.islice(postures, len(rows))) for rows in found]


def _arrays(targets: Sequence[Target]) -> tuple[Array, Array | None]:
    """Return the positions (n, 3) and the orientations (n, 3, 3) of targets; None for any orientation."""
    goals = np.array([position for position, _ in targets], dtype=np.float64)
    turns = [turn for _, turn in targets if turn is not None]
    return goals, geometry.to_matrices(np.array(turns)) if turns else None


def _distinct(found: Array, home: Array) -> Array:
    """Return distinct postures; the postures near ``home`` come first."""
    return _different(found[np.argsort(np.abs(found - home).sum(axis=1), kind="stable")], _MAX_POSTURES)


def _different(found: Array, most: int) -> Array:
    """Return the first posture of each group of similar postures (n, joints)."""
    left = np.arange(len(found))
    kept: list[int] = []
    while len(left) and len(kept) < most:
        kept.append(int(left[0]))
        left = left[(np.abs(found[left] - found[left[0]]) > _DIFFERENT).any(axis=1)]
    return found[kept]


def postures(
    robot: Object,
    link: str,
    position: Sequence[float],
    orientation: Sequence[float] | None,
    *,
    thorough: bool = False,
    quick: bool = False,
) -> list[Posture]:
    """Return postures that move a link of a robot to a pose in the world; see :meth:`Solver.search`."""
    return Solver(robot, link).search([(position, orientation, None)], thorough=thorough, quick=quick)[0]


class Solver:
    """Inverse kinematics of a link of a robot in its present state, for targets in the world.

    The tool frame of an arm represents the tool. UnknownName is raised if the robot has no such link.
    """

    def __init__(self, robot: Object, link: str) -> None:
        robot.check_link(link)
        self._arm = robot.description.arm_of(link) if robot.description else None
        if self._arm is not None:
            root, self.joints = self._arm.base_link, self._arm.joints
        else:
            chain = robot.urdf.chain(robot.base_link, link)
            turning = [joint for joint in chain if joint.movable and joint.type != "prismatic"]
            root = turning[0].parent if turning else robot.base_link
            self.joints = tuple(joint.name for joint in turning)  # joints that move the link
        self._now = robot.get_joint_positions()
        tool = self._arm.tool_offset if self._arm else IDENTITY
        self._kinematics = _kinematics(robot, root, link, self.joints, self._now, tool)
        self._root_T_world = geometry.invert(robot.get_link_position_and_orientation(root))
        self._root_T_link = geometry.transform(self._root_T_world, robot.get_link_position(link))
        self._root_T_base = geometry.multiply(self._root_T_world, robot.get_position_and_orientation())

    def search(
        self,
        targets: Sequence[WorldTarget],
        *,
        thorough: bool = False,
        quick: bool = False,
        seed: Mapping[str, float] | None = None,
        threshold: float = THRESHOLD,
    ) -> list[list[Posture]]:
        """Return postures for targets; postures near the seed come first.

        Args:
            targets: positions, orientations and poses of the base in the world; all have an orientation, or none.
            thorough: whether to use all starting postures, even if some reach the target.
            quick: whether to use only a few starting postures; if they fail, the target may still be reachable.
            seed: the first starting posture; None for the present posture.
            threshold: m, largest distance between the tool and a reached target.

        Returns:
            At least one posture for each target; if the first posture misses the target, no posture reaches it.
        """
        if not self.joints:
            distances = (math.dist(geometry.transform(self._root_T_world, at), self._root_T_link) for at, *_ in targets)
            return [[Posture({}, distance, 0.0)] for distance in distances]
        if not targets:
            return []
        seeds = [self._now if seed is None else seed]
        if self._arm is not None:
            seeds += [self._arm.posture(name) for name in self._arm.poses]
        goals = [self._in_root(*target) for target in targets]
        return self._kinematics.solve(goals, seeds, thorough=thorough, quick=quick, enough=threshold)

    @property
    def in_closed_form(self) -> bool:
        """Whether the joints have a closed form."""
        return bool(self.joints) and self._kinematics.in_closed_form

    def closed_form(
        self, targets: Sequence[WorldTarget], seed: Mapping[str, float] | None = None
    ) -> list[list[Posture]]:
        """Return the closed form's solutions, nearest first; a target without a solution may be reachable."""
        if not self.joints:
            return [[] for _ in targets]
        goals = [self._in_root(*target) for target in targets]
        return self._kinematics.closed_form(goals, self._now if seed is None else seed)

    def _in_root(
        self, position: Sequence[float], orientation: Sequence[float] | None, base: PoseLike | None
    ) -> tuple[Vector, Quaternion | None]:
        root_T_world = self._root_T_world
        if base is not None:
            root_T_world = geometry.multiply(self._root_T_base, geometry.invert(base))
        turn = None if orientation is None else geometry.product(root_T_world[1], orientation)
        return geometry.transform(root_T_world, position), turn


_chains: WeakKeyDictionary[Object, dict[Hashable, ArmKinematics]] = WeakKeyDictionary()


def _kinematics(
    robot: Object, root: str, link: str, joints: Sequence[str], now: Mapping[str, float], tool: Pose
) -> ArmKinematics:
    """Return a chain's kinematics, from a cache, because creating kinematics takes as long as solving a target."""
    others = [joint.name for joint in robot.urdf.chain(root, link) if joint.movable and joint.name not in joints]
    key = (link, *(now[name] for name in others))
    chains = _chains.setdefault(robot, {})
    if key not in chains:
        if len(chains) >= _MAX_CHAINS:
            chains.clear()
        chains[key] = ArmKinematics(Chain(robot.urdf, root, link, joints, now, tool))
    return chains[key]
