"""A work table for arms, which are bolted to the top at the origin; x points away from the rear edge."""

from __future__ import annotations

import itertools

from make.urdf import Link, Material, document, span

MATERIALS = {
    "top": Material((0.80, 0.72, 0.60), 700.0),
    "leg": Material((0.35, 0.36, 0.39), 2500.0),
}

HEIGHT = 0.72  # height of the table top above the floor, metres


def table() -> str:
    """The URDF of the table, whose one link ``table`` has its origin on the floor."""
    x, y, leg = (-0.30, 1.00), (-0.90, 0.90), 0.06
    shapes = [span(x, y, (HEIGHT - 0.03, HEIGHT), "top")]
    lefts, fronts = ((low + 0.02, high - 0.02 - leg) for low, high in (x, y))
    shapes += [
        span((left, left + leg), (front, front + leg), (0.0, HEIGHT - 0.03), "leg")
        for left, front in itertools.product(lefts, fronts)
    ]
    return document(
        "table", [Link("table", tuple(shapes))], MATERIALS, "Written by make_resources.py. Metres, kilograms."
    )
