"""The physics engine: the only room that knows PyBullet."""
