"""Balls inside of bodies: what they say of an overlap is so, by the engine's word."""

from __future__ import annotations

import random

import numpy as np
import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.models.convex import solids_of
from pycram.physics.engine import Engine
from pycram.reasoning.collision import inscribed_spheres
from pycram.reasoning.collision.boxes import Boxes
from recorder import geometry

FILES = ["milk", "bowl", "breakfast_cereal", "spoon", "apple", "pot"]


@pytest.fixture
def robot(world: BulletWorld) -> Object:
    return Object("pr2", "robot", "pr2.urdf")


def test_balls_are_inside_of_the_pieces(robot: Object) -> None:
    for body in (robot, *(Object(file, file, f"{file}.stl") for file in FILES)):
        solids = solids_of(body.model.path)
        boxes = Boxes.around(body.world.engine, body.handle, body)
        balls = inscribed_spheres.inscribed_spheres(body.model.path)
        assert len(balls.radii) == len(boxes.links)
        positions, orientations = body.world.engine.link_frames(body.handle, boxes.links)
        turns = geometry.to_matrices(orientations)
        for number, link in enumerate(boxes.links):
            radii = balls.radii[number][np.isfinite(balls.radii[number])]
            middle = (boxes.centers[number] - positions[number]) @ turns[number]
            places = balls.places[number][: len(radii)] + middle
            below = []
            for piece in np.flatnonzero(np.array(solids.links) == link):
                planes = solids.pieces == piece
                below.append((solids.offsets[planes] - places @ solids.normals[planes].T).min(axis=1))
            assert (radii > 0.0).all()
            assert (np.max(below, axis=0) >= radii - 1e-9).all()


@pytest.mark.parametrize("file", FILES)
def test_links_overlap_at_least_as_deep_as_their_balls(robot: Object, file: str) -> None:
    thing, rng = Object(file, file, f"{file}.stl"), random.Random(file)
    engine = Engine()
    try:
        hand = engine.load(robot.model.path, robot.get_position_and_orientation(), fixed=True, robot=True)
        copy = engine.load(thing.model.path, thing.get_position_and_orientation(), fixed=False)
        mine = Boxes.around(engine, hand, robot)
        sure = 0
        for _ in range(150):
            link = rng.choice(["l_forearm_link", "l_upper_arm_link", "l_gripper_palm_link", "r_wrist_flex_link"])
            number = mine.links.index(link)
            at = mine.centers[number] + [rng.uniform(-0.12, 0.12) for _ in range(3)]
            engine.set_pose(copy, (tuple(at), geometry.from_rpy(*(rng.uniform(-3, 3) for _ in range(3)))))
            others = Boxes.around(engine, copy, thing)
            which = np.full(len(others.links), number)
            back = others.axes.transpose(0, 2, 1)
            ways = (back @ (mine.centers[which] - others.centers)[:, :, None])[:, :, 0]
            hands = inscribed_spheres.inscribed_spheres(robot.model.path).of(which, inscribed_spheres.FEW)
            overlap = hands.overlaps(
                back @ mine.axes[which], ways, inscribed_spheres.inscribed_spheres(thing.model.path)
            ).max()
            depth = max((-touch.distance for touch in engine.link_closest_points(hand, link, copy)), default=0.0)
            sure += overlap > 0.003
            assert overlap <= depth + 1e-4
        assert sure > 20, "else nothing was asked"
    finally:
        engine.close()
