"""Balls inside of bodies: what they say of an overlap is so, by the engine's word."""

from __future__ import annotations

import random

import numpy as np
import pytest

from pycram.bullet_world import BulletWorld, Object
from pycram.engine import Engine
from pycram.reasoning import cores
from pycram.reasoning.boxes import Boxes
from pycram.solids import solids_of
from recorder import geometry

FILES = ["milk", "bowl", "breakfast_cereal", "spoon", "apple", "pot"]


@pytest.fixture
def robot(world: BulletWorld) -> Object:
    return Object("pr2", "robot", "pr2.urdf")


def test_balls_are_inside_of_the_pieces(robot: Object) -> None:
    for body in (robot, *(Object(file, file, f"{file}.stl") for file in FILES)):
        solids = solids_of(body.model.path)
        boxes = Boxes.around(body.world.engine, body.handle, body)
        balls = cores.balls_in(body.model.path)
        assert len(balls) == len(boxes.links)
        positions, orientations = body.world.engine.link_frames(body.handle, boxes.links)
        turns = geometry.to_matrices(orientations)
        for link, mine, center, at, turn in zip(boxes.links, balls, boxes.centers, positions, turns, strict=True):
            there = mine[np.isfinite(mine[:, 3])]
            places = there[:, :3] + (center - at) @ turn
            below = []
            for piece in np.flatnonzero(np.array(solids.links) == link):
                planes = solids.pieces == piece
                below.append((solids.offsets[planes] - places @ solids.normals[planes].T).min(axis=1))
            assert (there[:, 3] > 0.0).all()
            assert (np.max(below, axis=0) >= there[:, 3] - 1e-9).all()


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
            count = len(others.links)
            overlap = cores.overlaps(
                np.repeat(cores.balls_in(robot.model.path)[[number], : cores.FEW], count, axis=0),
                np.repeat(mine.centers[[number]], count, axis=0),
                np.repeat(mine.axes[[number]], count, axis=0),
                cores.balls_in(thing.model.path),
                others.centers,
                others.axes,
            ).max()
            depth = max((-touch.distance for touch in engine.link_touches(hand, link, copy)), default=0.0)
            sure += overlap > 0.003
            assert overlap <= depth + 1e-4
        assert sure > 20, "else nothing was asked"
    finally:
        engine.close()
