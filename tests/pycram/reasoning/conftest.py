"""Queries change nothing: the tests of a module share one full scene, put back after each of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from pycram.bullet_world import BulletWorld
from pycram.world.snapshot import restore_snapshot, take_snapshot
from tests.conftest import furnish

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(scope="module")
def built() -> Iterator[BulletWorld]:
    with BulletWorld() as made:
        made.set_gravity([0, 0, -9.8])
        furnish(made)
        yield made


@pytest.fixture
def scene(built: BulletWorld) -> Iterator[BulletWorld]:
    """As everywhere; what a test has moved, attached or added is undone."""
    BulletWorld.current_bullet_world = built
    before = {body: take_snapshot(body) for body in built.objects}
    yield built
    for body in built.objects:
        body.detach_all()
    for body in list(built.objects):
        if body not in before:
            body.remove()
    for body, state in before.items():
        if take_snapshot(body) != state:
            restore_snapshot(body, state)
