"""The physics engine: the only room that knows PyBullet, its window and its prints."""
