"""Queries change nothing: the tests of a module share one full scene, put back after each of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pycram.bullet_world import BulletWorld


@pytest.fixture
def scene(shared_scene: BulletWorld) -> BulletWorld:
    return shared_scene
