"""What a robot would touch in other postures or at another place (thesis 4.4.6): tried in a twin, never in the world.

One rehearsal tries many postures: the twin is brought to the world's state once. Boxes say at once which links could
touch in all of them (:mod:`pycram.reasoning.collision.boxes`); the engine looks closely only at these pairs, when it is
asked.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from pycram.reasoning.collision.boxes import meeting, together
from pycram.reasoning.collision.inscribed_spheres import FEW, inscribed_spheres
from pycram.reasoning.collision.moving_links import MovingLinks, arm_depths
from pycram.reasoning.collision.simulation_clone import twin
from pycram.reasoning.collision.surroundings import Surroundings
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
    from types import TracebackType
    from typing import Self

    from numpy.typing import NDArray

    from pycram.physics.contacts import ClosestPoint
    from pycram.world.object import Object
    from recorder.geometry import Pose

    Pair = tuple[Object, str, Object, str]

DEPTH: Final = 2e-3  # m of overlap below which shapes, which the engine pads, don't count as in the way
_SURE: Final = 1e-3  # m by which balls inside of shapes may overlap deeper than the engine says
_OWN_DEPTH: Final = 0.02  # m; the robot's own shapes are hulls, which overlap where the robot doesn't
_STANDING: Final = 0.9  # of a normal's length pointing up
_FEET: Final = 0.02  # m above the ground


@dataclass(frozen=True, slots=True)
class Candidate:
    """A posture, and what could touch in it.

    Attributes:
        positions: joint values in rad or m by name; the others stay.
        base: pose of the robot's base; None where it stands.
        meets: (n,) numbers of boxes that move, and of the others that they meet.
        centers: (k, 3) of all boxes that move, m.
        axes: (k, 3, 3) of these boxes.
        moved: (joints + 1, 4, 4) how the joints carry things there.
        seen: touches of the pairs that have been looked at.
        pairs: links that move, with whose they are, and the others that they could touch; once it has been taken.
    """

    positions: Mapping[str, float]
    base: Pose | None
    meets: tuple[NDArray[np.intp], NDArray[np.intp]]
    centers: NDArray[np.float64]
    axes: NDArray[np.float64]
    moved: NDArray[np.float64]
    seen: dict[Pair, list[ClosestPoint]] = field(default_factory=dict)
    pairs: list[Pair] = field(default_factory=list)


class CollisionChecker:
    """A robot that is put into postures in a twin. Use it as a context manager, with the world's lock held.

    Args:
        robot: the robot.
        joints: names of the joints that will be moved; what they don't move isn't looked at.
        ignored: objects that don't count.
        everything: look at all links of the robot, not just those that the joints move.
    """

    def __init__(
        self,
        robot: Object,
        joints: Iterable[str],
        ignored: Iterable[Object] = (),
        *,
        everything: bool = False,
    ) -> None:
        world = robot.world
        self.robot = robot
        self._twin = twin(world, "reach")
        self._engine = self._twin.engine
        self._bodies = bodies = self._twin.sync()
        self._body = bodies[robot.name]
        self._joints = tuple(joints)
        self._limbs = limbs = self._twin.known(
            robot,
            (MovingLinks, self._joints, everything),
            lambda copy: MovingLinks(
                self._engine, copy, robot, self._twin.boxes(robot), self._joints, everything=everything
            ),
        )
        self._held = [(other, bodies[other.name], link, pose) for other, link, pose in _held(robot)]
        skipped = {robot, *(other for other, *_ in self._held), *ignored}
        obstacles = [other for other in world.objects if other not in skipped]
        self._at_base = limbs.stand
        held = [(other, self._twin.boxes(other), link) for other, _, link, _ in self._held if link in limbs.moving]
        self._owners = [(robot, link, link) for link in limbs.boxes.links]
        self._at = {other: link for other, _, link, _ in self._held}
        self._owners += [(other, own, link) for other, boxes, link in held for own in boxes.links]
        carriers = limbs.articulation.carriers
        loaded = [carriers[link] for _, boxes, link in held for _ in boxes.links]
        self._carriers = np.concatenate([limbs.carriers, np.array(loaded, dtype=np.intp)])
        self._mine = together([limbs.boxes, *(boxes for _, boxes, _ in held)])
        self._around = Surroundings(obstacles, [self._twin.boxes(other) for other in obstacles])
        none, nothing = np.zeros(0, dtype=np.intp), np.zeros(0)
        self._taken = Candidate({}, None, (none, none), nothing, nothing, nothing)
        self._there = self._moved = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._moved:
            self._twin.disturbed(self.robot.name, *(other.name for other, *_ in self._held))

    def predict(self, postures: Sequence[Mapping[str, float]], base: Pose | None = None) -> list[Candidate]:
        """Finds out what could touch in postures, all at once.

        Args:
            postures: joint values in rad or m by name; the others stay.
            base: pose of the robot's base in them; it stays by default.
        """
        moved = self._limbs.articulation.moved(postures)
        there = moved
        if base is not None:
            there = geometry.pose_matrix(geometry.multiply(base, geometry.invert(self._limbs.stand))) @ moved
        centers, axes = self._mine.carried(there[:, self._carriers])
        posture, box, other = meeting(centers, axes, self._mine.halves, self._around.boxes)
        ends = itertools.pairwise(np.searchsorted(posture, np.arange(len(postures) + 1)).tolist())
        return [
            Candidate(positions, base, (box[start:end], other[start:end]), *there)
            for positions, (start, end), *there in zip(postures, ends, centers, axes, moved, strict=True)
        ]

    def take(self, positions: Mapping[str, float] | Candidate, base: Pose | None = None) -> None:
        """Puts the robot into a posture.

        Args:
            positions: one that was foreseen, or joint values in rad or m by name; the others stay.
            base: pose of its base; it stays by default.
        """
        if not isinstance(positions, Candidate):
            (positions,) = self.predict([positions], base)
        if positions is not self._taken:
            self._taken = positions
            self._there = False
            if not positions.pairs:
                positions.pairs.extend(_in_turn(self._pairs(*positions.meets)))

    def surely(self, postures: Sequence[Candidate], links: Collection[str]) -> list[dict[Object, float]]:
        """What postures touch for sure, without asking the engine.

        Args:
            postures: that were foreseen.
            links: the robot's links that are looked at.

        Returns:
            For each, things that some of these links touch, and how deep at least, m.
        """
        found: list[dict[Object, float]] = [{} for _ in postures]
        looked = np.array([mover is self.robot and link in links for mover, link, _ in self._owners], dtype=bool)
        which = np.repeat(np.arange(len(postures)), [len(posture.meets[0]) for posture in postures])
        box, other = np.concatenate([posture.meets for posture in postures], axis=1)
        some = np.flatnonzero(looked[box] & self._around.loose[other])
        if not len(some):
            return found
        which, box, other = which[some], box[some], other[some]
        centers = np.array([posture.centers for posture in postures])[which, box]
        axes = np.array([posture.axes for posture in postures])[which, box]
        balls = inscribed_spheres(self.robot.model.path).of(self._limbs.numbers[box], FEW)
        depths = self._around.overlaps(balls, centers, axes, other)
        for number in np.flatnonzero(depths > DEPTH + _SURE).tolist():
            touched, thing = found[which[number]], self._around.whose[other[number]]
            touched[thing] = max(touched.get(thing, 0.0), float(depths[number]) - _SURE)
        return found

    def _pairs(self, boxes: NDArray[np.intp], others: NDArray[np.intp]) -> Iterable[Pair]:
        """The links that boxes are around, with those of others; in order, each pair once."""
        found: dict[Pair, None] = {}
        for box, other in zip(boxes.tolist(), others.tolist(), strict=True):
            mover, link, _ = self._owners[box]
            found[mover, link, self._around.whose[other], self._around.boxes.links[other]] = None
        return found

    def _look(self, pair: Pair) -> list[ClosestPoint]:
        """Where two links touch; the twin's robot is put there only for this."""
        engine, taken = self._engine, self._taken
        if pair in taken.seen:
            return taken.seen[pair]
        if not self._there:
            self._moved = True
            if (taken.base or self._limbs.stand) != self._at_base:
                self._at_base = taken.base or self._limbs.stand
                engine.set_pose(self._body, self._at_base)
            engine.pose_joints(self._body, {**self._limbs.now, **taken.positions})
            for _, body, link, pose in self._held:
                engine.set_pose(body, geometry.multiply(engine.link_pose(self._body, link), pose))
            self._there = True
        mover, link, other, other_link = pair
        bodies = self._bodies[mover.name], self._bodies[other.name]
        taken.seen[pair] = engine.link_closest_points(bodies[0], link, bodies[1], link_b=other_link)
        return taken.seen[pair]

    def hits(self, links: Collection[str] | None = None) -> Iterator[tuple[Object, list[ClosestPoint]]]:
        """Touches in the posture that it has taken, as they are found; what was looked at once is known.

        Args:
            links: the robot's links that are looked at, and what it holds with them; all that move by default.

        Yields:
            What is touched, and where one of its links is by one other, at least at one place. The floor that a robot
            stands on isn't in the way of its wheels; what it holds moves along and may be in the way of others too.
        """
        for pair in self._taken.pairs:
            mover, link, other, _ = pair
            if links is not None and self._at.get(mover, link) not in links:
                continue
            standing = mover.is_robot and other.is_environment
            touches = [
                touch
                for touch in self._look(pair)
                if touch.distance <= -DEPTH and not (standing and _carries_wheels(touch))
            ]
            if touches:
                yield other, touches

    def touched(self) -> dict[Object, dict[str, object]]:
        """What it touches in the posture that it has taken.

        Returns:
            For each object, the robot's links that touch it, its own links, and the depth in m; deepest first.
        """
        found: dict[Object, list[ClosestPoint]] = {}
        for other, touches in self.hits():
            found.setdefault(other, []).extend(touches)
        told = {other: _told(touches) for other, touches in found.items()}
        return dict(sorted(told.items(), key=lambda item: (-float(str(item[1]["depth"])), item[0].name)))

    def touches_itself(self) -> list[tuple[str, str]]:
        """Pairs of its own links, more than a shoulder apart, that overlap in the posture that it has taken."""
        return [
            (link, other)
            for link, other in self._limbs.meeting(self._taken.moved)
            if any(touch.distance <= -_OWN_DEPTH for touch in self._look((self.robot, link, self.robot, other)))
        ]

    def moving(self) -> set[str]:
        """The robot's links that are looked at."""
        return set(self._limbs.moving)

    def beyond(self, joints: Collection[str]) -> set[str]:
        """The robot's links that hang on all of some joints: with an arm's joints its hand.

        Args:
            joints: names of some of those that will be moved, one after the other.
        """
        urdf, named = self.robot.urdf, tuple(joints)
        counts = self._twin.known(self.robot, (arm_depths, named), lambda _: arm_depths(urdf, named))
        return {link for link, depth in counts.items() if depth == len(joints)}

    def settled(self, link: str | None) -> set[str]:
        """The robot's links that are where they are whatever the joints do.

        Args:
            link: stays at one pose as well, as the hand in all postures for one grasp.
        """
        depths = {0} if link is None else {0, self._limbs.depth[link]}
        return {other for other, depth in self._limbs.depth.items() if depth in depths}


def _in_turn(pairs: Iterable[Pair]) -> list[Pair]:
    """Each object's first pair, then each one's second, and so on, as first it counts who is hit; furniture first."""
    turns: dict[Object, int] = {}
    order: dict[Pair, tuple[int, bool]] = {}
    for pair in pairs:
        other = pair[2]
        turns[other] = turn = turns.get(other, 0) + 1
        order[pair] = turn, not other.fixed
    return sorted(order, key=order.__getitem__)


def _told(touches: list[ClosestPoint]) -> dict[str, object]:
    return {
        "links": sorted({touch.link_a for touch in touches}),
        "by": sorted({touch.link_b for touch in touches}),
        "depth": max(-touch.distance for touch in touches),
    }


def _held(robot: Object) -> list[tuple[Object, str, Pose]]:
    """What a robot carries, directly and through other things: object, the robot's link, pose in that link."""
    held: list[tuple[Object, str, Pose]] = []
    queue = [(attachment.body, attachment.carrier_link) for attachment in robot.carried]
    while queue:
        body, link = queue.pop()
        link_T_world = geometry.invert(robot.get_link_position_and_orientation(link))
        held.append((body, link, geometry.multiply(link_T_world, body.get_position_and_orientation())))
        queue.extend((attachment.body, link) for attachment in body.carried)
    return held


def _carries_wheels(touch: ClosestPoint) -> bool:
    """Whether a robot stands there rather than bumps: a contact from below, at the height of its base's feet."""
    return touch.normal[2] > _STANDING and touch.position_b[2] < _FEET


def in_the_way(
    robot: Object,
    positions: Mapping[str, float],
    ignored: Iterable[Object] = (),
    base: Pose | None = None,
    *,
    everything: bool = False,
) -> dict[Object, dict[str, object]]:
    """What a robot would touch in one other posture or at one other place; see :meth:`CollisionChecker.touched`.

    Args:
        robot: the robot.
        positions: joint values in rad or m by name that differ from the present ones.
        ignored: objects that don't count.
        base: pose of the robot's base; the present one by default.
        everything: count all links of the robot; else only those that the joints move.
    """
    with CollisionChecker(robot, positions, ignored, everything=everything) as rehearsal:
        rehearsal.take(positions, base)
        return rehearsal.touched()
