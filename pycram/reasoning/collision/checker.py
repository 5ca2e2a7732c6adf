"""The collision checker: finds the objects that a robot would touch in other postures or poses (thesis 4.4.6).

The broad phase finds pairs of links whose boxes overlap (:mod:`pycram.reasoning.collision.boxes`). The narrow phase
checks these pairs with the engine one by one in a simulation clone, when a caller asks for them.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Self, TypedDict

import numpy as np

from pycram.foundation.failures import CollisionPair
from pycram.physics.body import ClosestPoint, LoadedBody
from pycram.reasoning.collision.boxes import Boxes, MovingLinks, joint_counts, overlaps
from pycram.reasoning.collision.simulation_clone import clone_of
from recorder import geometry
from recorder.geometry import Array, Indices, Pose

if TYPE_CHECKING:
    from pycram.world.object import Object

    Pair = tuple[Object, str, Object, str]  # a moving object and its link, then another object and its link

DEPTH: Final = 2e-3  # minimum overlap in m of shapes that collide; the engine pads shapes
_SELF_DEPTH: Final = 0.02  # minimum overlap in m of the robot's own links that collide; hulls are wider than links
_STANDING: Final = 0.9  # minimum vertical component of the normal of a contact between a robot's wheels and the floor
_FEET: Final = 0.02  # maximum height in m of a contact between a robot's wheels and the floor


class Collision(TypedDict):
    """A collision of a robot with an object, in the form of records."""

    links: list[str]  # links of the robot or of held objects that touch the object
    by: list[str]  # links of the object that the robot touches
    depth: float  # greatest overlap, m
    pair: CollisionPair  # the pair of links with the greatest overlap


@dataclass(frozen=True, slots=True)
class PostureCandidate:
    """A posture, with the pairs of links that may touch in it."""

    positions: Mapping[str, float]  # joint positions in rad or m by name; other joints don't move
    base: Pose | None  # pose of the robot's base; None for its present pose
    overlaps: tuple[Indices, Indices]  # (n,) indices of moving boxes, and of the boxes in overlap
    transforms: Array  # (joints + 1, 4, 4) transforms of the links by each joint
    # pairs of links whose boxes overlap, in the order of checks; empty until pairs() is called
    pairs: list[Pair] = field(default_factory=list)
    touches: dict[Pair, list[ClosestPoint]] = field(default_factory=dict)  # contact points of the checked pairs


@dataclass(slots=True)
class _Single:
    copy: LoadedBody  # the body in the clone
    driver: int  # index of the joint that moves it; -1 for none
    frame: Array  # (4, 4) present pose of the link, or of the held object's link
    candidate: PostureCandidate | None = None  # the candidate whose pose it has


class CollisionChecker:
    """Checks postures of a robot for collisions, in a ``with`` block; the caller holds the world's lock.

    Only links that the ``joints`` move are checked, unless ``all_links`` is true. The robot may touch ``ignored``
    objects and links. Links that don't touch are checked, too, up to a distance of ``margin`` in m. With
    ``single_links``, links are placed one by one: faster for many postures, and as exact up to rounding.
    """

    def __init__(
        self,
        robot: Object,
        joints: Iterable[str],
        ignored: Iterable[Object] = (),
        *,
        all_links: bool = False,
        ignored_links: Collection[tuple[Object, str]] = (),
        margin: float = 0.0,
        single_links: bool = False,
    ) -> None:
        self.robot = robot
        self._single_links = single_links
        self._margin = margin
        self._clone = clone = clone_of(robot.world, "reach")
        clone.sync()
        names = tuple(joints)
        self._held = _held(robot)
        states = tuple((body.name, body.model.path, link, clone.state(body)) for body, link, _ in self._held)

        def moving_links() -> MovingLinks:
            held = [(body, link, clone.boxes(body)) for body, link, _ in self._held]
            return MovingLinks(robot, clone.boxes(robot), held, names, all_links=all_links)

        self._links = links = clone.cached(robot, (MovingLinks, names, all_links, states), moving_links)
        self.moving = links.moving  # checked links of the robot
        self._link_of = {body: link for body, link, _ in self._held}
        # held objects, each with an object that overlapped it at the grasp; these pairs may pass through each other
        self._passed = {
            (body, left) for body in self._link_of for each in body.attachments.values() for left in each.left
        }
        self._own = {body.name: body for body in (robot, *self._link_of)}
        self._owners = [(self._own[name], link) for name, link in links.owners]
        skipped = {robot, *(body for body in self._link_of if body.name in links.held), *ignored}
        every, bodies = clone.all_boxes(body for body in robot.world.objects if body not in skipped)
        owners = list(zip(bodies, every.links, strict=True))
        counted = [owner not in ignored_links for owner in owners]
        every = every.subset(np.array(counted, dtype=bool)) if ignored_links else every
        self._other_boxes = every.widened(margin) if margin else every
        self._other_owners = list(itertools.compress(owners, counted))
        self._base = links.base_pose  # present pose of the robot in the clone
        self._placed: PostureCandidate | None = None
        self._singles: dict[tuple[Object, str], _Single] = {}  # checked links and held objects of the robot

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._placed is not None or self._singles:
            self._clone.invalidate(self.robot.name, *(body.name for body in self._link_of))

    def predict(self, postures: Sequence[Mapping[str, float]], base: Pose | None = None) -> list[PostureCandidate]:
        """Return candidates for postures, computed together; joints without a position (rad or m) don't move."""
        transforms = self._links.articulation.transforms(postures)
        moved = transforms if base is None else self._carried([base]) @ transforms
        return self._overlapping(postures, [base] * len(postures), transforms, moved)

    def predict_at(self, bases: Sequence[Pose]) -> list[PostureCandidate]:
        """Return candidates for the present posture with the robot's base at other poses, computed together."""
        if not bases:
            return []
        transforms = self._links.articulation.transforms([{}] * len(bases))
        return self._overlapping([{}] * len(bases), bases, transforms, self._carried(bases)[:, None] @ transforms)

    def _carried(self, bases: Sequence[Pose]) -> Array:
        """Return the transforms (n, 4, 4) of the robot from its present pose to other poses of its base."""
        placed = np.zeros((len(bases), 4, 4))
        placed[:, :3, :3] = geometry.to_matrices(np.array([orientation for _, orientation in bases]))
        placed[:, :3, 3] = [position for position, _ in bases]
        placed[:, 3, 3] = 1.0
        return placed @ geometry.pose_matrix(geometry.invert(self._links.base_pose))

    def boxes(self, candidate: PostureCandidate) -> Boxes:
        """Return the boxes around the robot's checked links in a candidate, with the base at its present pose."""
        boxes, links = self._links.boxes, self._links
        centers, axes = boxes.moved(candidate.transforms[None, links.drivers])
        own = np.array([name == self.robot.name for name, _ in links.owners], dtype=bool)
        return Boxes(boxes.links, centers[0], axes[0], boxes.half_extents).subset(own)

    def _overlapping(
        self, postures: Sequence[Mapping[str, float]], bases: Sequence[Pose | None], transforms: Array, moved: Array
    ) -> list[PostureCandidate]:
        """Return candidates for postures; ``moved`` has the links' transforms, including the motion of the base."""
        centers, axes = self._links.boxes.moved(moved[:, self._links.drivers])
        posture, box, other = overlaps(centers, axes, self._links.boxes.half_extents, self._other_boxes)
        ends = itertools.pairwise(np.searchsorted(posture, np.arange(len(postures) + 1)).tolist())
        return [
            PostureCandidate(positions, base, (box[start:end], other[start:end]), each)
            for positions, base, (start, end), each in zip(postures, bases, ends, transforms, strict=True)
        ]

    def pairs(self, candidate: PostureCandidate) -> Sequence[Pair]:
        """Return the pairs of links with overlapping boxes, each pair once, without pairs of the robot's own links.

        The first pairs of all objects come before second pairs, because callers first need to know which objects are
        touched. Furniture comes after other objects, because boxes of furniture are wide.
        """
        if not candidate.pairs:
            boxes, others = candidate.overlaps
            pairs = dict.fromkeys(
                (*self._owners[box], *self._other_owners[other])
                for box, other in zip(boxes.tolist(), others.tolist(), strict=True)
            )
            order: dict[Pair, tuple[int, bool]] = {}
            counts: Counter[Object] = Counter()
            for pair in pairs:
                if (pair[0], pair[2]) not in self._passed:
                    counts[pair[2]] += 1
                    order[pair] = counts[pair[2]], pair[2].fixed
            candidate.pairs.extend(sorted(order, key=order.__getitem__))
        return candidate.pairs

    def collisions(
        self, candidate: PostureCandidate, links: Collection[str] | None = None
    ) -> Iterator[tuple[Pair, list[ClosestPoint]]]:
        """Yield the pairs of a candidate that touch, with their contact points; results are cached.

        Wheels of the robot don't collide with the floor. Held objects don't collide with the robot, nor with objects
        that they overlapped at the grasp. Only ``links`` of the robot are checked, with the objects that they hold;
        None for all links.
        """
        for pair in self.pairs(candidate):
            mover, link, body, _ = pair
            if links is not None and self._link_of.get(mover, link) not in links:
                continue
            touches = [touch for touch in self._touches(candidate, pair) if touch.distance <= -DEPTH]
            if touches and mover.is_robot and body.is_environment:
                touches = [touch for touch in touches if not _carries_wheels(touch)]
            if touches:
                yield pair, touches

    def touched(self, candidate: PostureCandidate) -> dict[Object, Collision]:
        """Return the collisions of the robot in a candidate; the deepest collision is first."""
        found: dict[Object, list[tuple[Pair, float]]] = {}
        for pair, touches in self.collisions(candidate):
            found.setdefault(pair[2], []).append((pair, max(-touch.distance for touch in touches)))
        collisions = {}
        for body, pairs in found.items():
            deepest, depth = max(pairs, key=lambda item: item[1])
            collisions[body] = Collision(
                links=sorted({link for (_, link, *_), _ in pairs}),
                by=sorted({link for (*_, link), _ in pairs}),
                depth=depth,
                pair=self.named(deepest, depth),
            )
        return dict(sorted(collisions.items(), key=lambda item: (-item[1]["depth"], item[0].name)))

    def in_the_way(self, candidate: PostureCandidate) -> list[CollisionPair]:
        """Return the deepest pair for each collision in a candidate, then colliding pairs of the robot's own links."""
        return [collision["pair"] for collision in self.touched(candidate).values()] + self.self_collisions(candidate)

    def known(self, candidate: PostureCandidate) -> list[CollisionPair]:
        """Return the checked pairs that collide; the deepest pair is first."""
        depths = {
            pair: max((-touch.distance for touch in touches), default=0.0)
            for pair, touches in candidate.touches.items()
        }
        found = [self.named(pair, depth) for pair, depth in depths.items() if depth >= self.least(pair)]
        return sorted(found, key=lambda pair: -pair.depth)

    def self_collisions(self, candidate: PostureCandidate) -> list[CollisionPair]:
        """Return the colliding pairs of the robot's own links and held objects, except neighbours."""
        (pairs,) = self.self_pairs([candidate])
        depths = {pair: self.depth(candidate, pair) for pair in pairs}
        return [self.named(pair, depth) for pair, depth in depths.items() if depth >= self.least(pair)]

    def self_pairs(self, candidates: Sequence[PostureCandidate]) -> list[list[Pair]]:
        """Return, for each candidate, the pairs of the robot's links and held objects with overlapping boxes."""
        if not candidates:
            return []
        found = self._links.self_overlaps(np.array([candidate.transforms for candidate in candidates]))
        return [[(self._own[a], link, self._own[b], other) for (a, link), (b, other) in each] for each in found]

    def depth(self, candidate: PostureCandidate, pair: Pair) -> float:
        """Return the overlap in m of two links in a candidate, without wheels on the floor; at least ``-margin``."""
        touches = self._touches(candidate, pair)
        if touches and pair[0].is_robot and pair[2].is_environment:
            touches = [touch for touch in touches if not _carries_wheels(touch)]
        return max((-touch.distance for touch in touches), default=-self._margin)

    def least(self, pair: Pair) -> float:
        """Return the least overlap in m at which two links collide; the limit is larger for the robot's own links.

        Held objects may come near the arm that holds them, because hulls are wide.
        """
        mover, _, body, other = pair
        if body is not self.robot:
            return DEPTH
        carries = mover is not self.robot and self._links.hangs_on(self._link_of[mover], other)
        return _SELF_DEPTH if mover is body or carries else DEPTH

    def named(self, pair: Pair, depth: float) -> CollisionPair:
        """Return a pair of links by name, with its overlap in m."""
        mover, link, body, other = pair
        gripper = ""
        if mover is not self.robot:
            arm = self.robot.description.arm_of(self._link_of[mover]) if self.robot.description else None
            gripper = arm.name if arm else self._link_of[mover]
        return CollisionPair(mover.name, link_name(mover, link), body.name, link_name(body, other), depth, gripper)

    def _touches(self, candidate: PostureCandidate, pair: Pair) -> list[ClosestPoint]:
        """Return the contact points of two links; this moves the clone's robot."""
        touches = candidate.touches.get(pair)
        if touches is None:
            mover, link, body, other = pair
            if self._single_links:
                a = self._single(candidate, mover, link)
                b = self._single(candidate, body, other) if body.name in self._own else self._copy(body, other)
            else:
                self._place(candidate)
                a, b = self._copy(mover, link), self._copy(body, other)
            apart = 0.0 if body.name in self._own else self._margin
            touches = candidate.touches[pair] = self._clone.engine.link_closest_points(a, link, b, apart, link_b=other)
        return touches

    def _single(self, candidate: PostureCandidate, body: Object, link: str) -> LoadedBody:
        """Return the clone's body of one of the robot's links, or of a held object, at its pose in a candidate."""
        single = self._singles.get((body, link))
        if single is None:
            copy = self._clone.link(body, link) if len(body.links) > 1 else self._clone.body(body.name)
            frame = geometry.pose_matrix(body.world.engine.link_pose(body.handle, link))
            driver = self._links.articulation.of_links[self._link_of.get(body, link)]
            single = self._singles[body, link] = _Single(copy, driver, frame)
        if single.candidate is not candidate:
            moved = candidate.transforms[single.driver] @ single.frame
            if candidate.base is not None:
                moved = self._carried([candidate.base])[0] @ moved
            self._clone.engine.set_pose(single.copy, (moved[:3, 3].tolist(), geometry.from_matrix(moved[:3, :3])))
            single.candidate = candidate
        return single.copy

    def _copy(self, body: Object, link: str) -> LoadedBody:
        """Return the clone's body with a link of an object; furniture has a body for each link."""
        return self._clone.link(body, link) if body.is_environment else self._clone.body(body.name)

    def closest_points(self, candidate: PostureCandidate, other: LoadedBody) -> list[ClosestPoint]:
        """Return the contact points of a body with the robot, which is in a candidate's posture."""
        self._place(candidate)
        return self._clone.engine.closest_points(self._clone.body(self.robot.name), other)

    def _place(self, candidate: PostureCandidate) -> None:
        if candidate is self._placed:
            return
        self._placed = candidate
        engine, robot = self._clone.engine, self._clone.body(self.robot.name)
        base = candidate.base or self._links.base_pose
        if base != self._base:
            self._base = base
            engine.set_pose(robot, base)
        engine.pose_joints(robot, {**self._links.positions, **candidate.positions})
        for body, link, pose in self._held:
            engine.set_pose(self._clone.body(body.name), geometry.multiply(engine.link_pose(robot, link), pose))

    def links_beyond(self, joints: Collection[str]) -> set[str]:
        """Return the robot's links below the last joint of a chain of joints, such as the links of an arm's hand."""
        names = tuple(joints)
        counts = joint_counts(self.robot.model.path, names)
        return {link for link, count in counts.items() if count == len(names)}

    def constant_links(self, link: str | None) -> set[str]:
        """Return the links that don't move if ``link`` has a constant pose, such as a hand in postures for a grasp."""
        counts = self._links.joint_counts
        constant = {0} if link is None else {0, counts[link]}
        return {other for other, count in counts.items() if count in constant}


def link_name(body: Object, link: str) -> str:
    """Return the name of a link for a collision pair; "" if the object has only one link."""
    return link if len(body.links) > 1 else ""


def touched(
    robot: Object, positions: Mapping[str, float], base: Pose | None = None, *, all_links: bool = False
) -> dict[Object, Collision]:
    """Return the collisions of a robot with other joint positions (rad or m) or another base, the deepest first."""
    with CollisionChecker(robot, positions, all_links=all_links) as checker:
        (candidate,) = checker.predict([positions], base)
        return checker.touched(candidate)


def in_the_way(robot: Object, positions: Mapping[str, float]) -> list[CollisionPair]:
    """Return the deepest pair for each collision in a posture, then colliding pairs of the robot's own links."""
    with CollisionChecker(robot, positions) as checker:
        (candidate,) = checker.predict([positions])
        return checker.in_the_way(candidate)


def newly_touched(robot: Object, positions: Mapping[str, float], base: Pose | None = None) -> list[CollisionPair]:
    """Return the pairs of :func:`in_the_way`, ordered by object, without collisions of the present posture."""
    now = robot.get_joint_positions()
    with CollisionChecker(robot, positions) as checker:
        (there,) = checker.predict([positions], base)
        found, own = checker.touched(there), checker.self_collisions(there)
        if not (found or own):
            return []
        (here,) = checker.predict([{name: now[name] for name in positions}])
        known = checker.touched(here) if found else {}
        known_own = {_ends(pair) for pair in (checker.self_collisions(here) if own else ())}
        new = [collision["pair"] for body, collision in found.items() if body not in known]
        new_own = [pair for pair in own if _ends(pair) not in known_own]
        return sorted(new, key=lambda pair: pair.body) + new_own


def _ends(pair: CollisionPair) -> tuple[str, ...]:
    return pair.mover, pair.link, pair.body, pair.body_link


def _held(robot: Object) -> list[tuple[Object, str, Pose]]:
    """Return the objects that a robot carries, also indirectly, with the robot's link and the pose in that link."""
    held: list[tuple[Object, str, Pose]] = []
    queue = [(attachment.body, attachment.carrier_link) for attachment in robot.carried]
    while queue:
        body, link = queue.pop()
        link_T_world = geometry.invert(robot.get_link_position_and_orientation(link))
        held.append((body, link, geometry.multiply(link_T_world, body.get_position_and_orientation())))
        queue.extend((attachment.body, link) for attachment in body.carried)
    return held


def _carries_wheels(touch: ClosestPoint) -> bool:
    """Return whether a contact is below the robot's wheels."""
    return touch.normal[2] > _STANDING and touch.position[2] < _FEET
