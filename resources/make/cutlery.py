"""Cutlery: thin objects along x with the handle at -x, which rest on the head and on the end of the handle."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from make.solids import Points, Solid, join, loft, revolve, sectors
from make.thing import MARGIN, Colour, Part, Thing

STEEL: Colour = (0.78, 0.79, 0.82)
WOOD: Colour = (0.45, 0.27, 0.14)

Curve = Callable[[float], float]


def spoon() -> Thing:
    """A table spoon, 0.217 x 0.046 x 0.019 m, with a hollow head whose underside is flat in the middle."""
    middle, half_length, half_width = 0.0765, 0.0320, 0.0230
    thick = 0.0020

    def dish(rho: float) -> float:
        """Height of the head's underside; ``rho`` is 0 in the middle of the head and 1 at the rim."""
        return float(0.0085 * max(0.0, (rho - 0.45) / 0.55) ** 1.5)

    spine = _curve(
        (-0.1085, -0.092, -0.065, -0.03, 0.0, 0.025, 0.046),
        (0.0, 0.0, 0.0062, 0.0145, 0.0164, 0.0140, 0.0085),
    )
    breadth = _curve(
        (-0.1085, -0.105, -0.09, -0.04, 0.02, 0.046),
        (0.0060, 0.0082, 0.0085, 0.0058, 0.0042, 0.0056),
    )
    across = np.linspace(-1.0, 1.0, 13)
    rings: list[Points] = []
    for x in _stations(-0.1085, 0.1085, 49):
        inside = max(0.0, 1.0 - ((x - middle) / half_length) ** 2)
        head = half_width * np.sqrt(inside)
        width = max(head, breadth(min(x, 0.046)) if x < middle else 0.0012)
        rows = []
        for s in across:
            rho = min(1.0, float(np.hypot((x - middle) / half_length, s * width / half_width)))
            z = dish(rho) if x > 0.052 else spine(min(x, 0.046))
            if 0.044 < x <= 0.052:
                blend = (x - 0.044) / 0.008
                z = (1.0 - blend) * z + blend * dish(rho)
            rows.append((x, s * width, z))
        rings.append(_sheet(np.array(rows), thick + 0.0006 * float(x < 0.044)))
    solid = _fitted(loft(rings), (0.217, 0.046, 0.019))
    stations = [-0.1085, -0.092, -0.065, -0.03, 0.0, 0.025, 0.0465]
    pieces = _handle(stations, spine, breadth, thick)
    rhos = [0.45, 0.75, 1.0]
    low = [(rho, dish(rho) + MARGIN * 0.9) for rho in rhos]
    high = [(rho, dish(rho) + max(thick - MARGIN * 0.9, MARGIN)) for rho in rhos]
    rim = [piece.scaled(half_length - MARGIN, half_width - MARGIN) for piece in sectors(high, low, 12)]
    floor = revolve([(0.0, MARGIN), (0.45, MARGIN), (0.45, MARGIN + 0.0002), (0.0, MARGIN + 0.0002)], 16)
    pieces += [piece.moved(middle) for piece in (*rim, floor.scaled(half_length, half_width))]
    return Thing("spoon", 0.04, 0.8, solid, tuple(pieces), (Part("steel", STEEL, solid),)).centred()


def fork() -> Thing:
    """A table fork, 0.200 m long, with four tines."""
    thick = 0.0022
    spine = _curve(
        (-0.1, -0.085, -0.03, 0.0, 0.03, 0.055, 0.07, 0.1),
        (0.0, 0.0, 0.0115, 0.0135, 0.0090, 0.0, 0.0010, 0.0080),
    )
    breadth = _curve(
        (-0.1, -0.096, -0.08, 0.0, 0.025, 0.042, 0.058),
        (0.0060, 0.0082, 0.0082, 0.0036, 0.0044, 0.0120, 0.0122),
    )
    stem = loft([_strip(x, spine(x), breadth(x), thick) for x in _stations(-0.1, 0.058, 33)])
    tines = []
    for y in (-0.0102, -0.0034, 0.0034, 0.0102):
        rings = [
            _strip(x, spine(x), 0.0018 if x < 0.09 else 0.0018 - 0.11 * (x - 0.09), thick)
            for x in _stations(0.055, 0.1, 10)
        ]
        tines.append(loft(rings).moved(y=y))
    solid = join([stem, *tines])
    pieces = _handle([-0.1, -0.085, -0.03, 0.0, 0.03, 0.045, 0.0575], spine, breadth, thick)
    for y in (-0.0102, -0.0034, 0.0034, 0.0102):
        pieces += [piece.moved(y=y) for piece in _handle([0.057, 0.070, 0.099], spine, lambda _: 0.0020, thick)]
    return Thing("fork", 0.045, 0.8, solid, tuple(pieces), (Part("steel", STEEL, solid),)).centred()


def knife() -> Thing:
    """A table knife, 0.220 m long, lying on the flat of its blade, with a wooden handle."""
    grip = loft([_oval(x, 0.0045, width, 0.0045) for x, width in _grip()])
    edge = [(-0.012, -0.0075), (0.0, -0.0085), (0.06, -0.0095), (0.09, -0.0085), (0.104, -0.0030), (0.11, 0.0055)]
    back = [(-0.012, 0.0065), (0.0, 0.0075), (0.06, 0.0085), (0.09, 0.0085), (0.104, 0.0082), (0.11, 0.0065)]
    blade = loft(
        [
            np.array([[x, low, 0.0040], [x, high, 0.0028], [x, high, 0.0062], [x, low, 0.0050]])
            for (x, low), (_, high) in zip(edge, back, strict=True)
        ],
    )
    core = [_oval(x, 0.0045, width - MARGIN, 0.0045 - MARGIN) for x, width in _grip()]
    flat = [
        np.array(
            [
                [x, low + MARGIN, 0.0042],
                [x, high - MARGIN, 0.0042],
                [x, high - MARGIN, 0.0048],
                [x, low + MARGIN, 0.0048],
            ]
        )
        for (x, low), (_, high) in zip(edge[:-1], back[:-1], strict=True)
    ]
    pieces = [loft(core), *(loft([first, second]) for first, second in itertools.pairwise(flat))]
    parts = (Part("handle", WOOD, grip), Part("blade", STEEL, blade))
    return Thing("knife", 0.07, 0.8, join([grip, blade]), tuple(pieces), parts).centred()


def _grip() -> list[tuple[float, float]]:
    return [(-0.11, 0.0075), (-0.107, 0.0090), (-0.06, 0.0100), (-0.008, 0.0085), (-0.004, 0.0075)]


def _handle(stations: list[float], spine: Curve, breadth: Curve, thick: float) -> list[Solid]:
    """Convex pieces of a curved strip, one piece between two successive stations along x."""
    rings = [
        _strip(x, spine(x) + 0.9 * MARGIN, breadth(x) - MARGIN, max(thick - 1.8 * MARGIN, 0.0002)) for x in stations
    ]
    return [loft([first, second]) for first, second in itertools.pairwise(rings)]


def _strip(x: float, z: float, half_width: float, thick: float) -> Points:
    """A flat cross-section: a rectangle in the plane of ``x``, above the height ``z``."""
    w = half_width
    return np.array([[x, -w, z], [x, w, z], [x, w, z + thick], [x, -w, z + thick]])


def _sheet(underside: Points, thick: float) -> Points:
    """A cross-section of constant thickness over a row of points of its underside."""
    return np.concatenate([underside, (underside + np.array([0.0, 0.0, thick]))[::-1]])


def _oval(x: float, z: float, half_width: float, half_height: float) -> Points:
    turns = 2.0 * np.pi * (np.arange(12) + 0.5) / 12
    return np.column_stack(
        [np.full(12, x), half_width * np.cos(turns), z + half_height * np.sin(turns) / np.sin(turns).max()]
    )


def _stations(start: float, end: float, count: int) -> list[float]:
    """Places along x, denser towards both ends, where outlines are round."""
    return [float(start + (end - start) * (0.5 - 0.5 * np.cos(np.pi * k / (count - 1)))) for k in range(count)]


def _curve(xs: tuple[float, ...], values: tuple[float, ...]) -> Curve:
    return lambda x: float(np.interp(x, xs, values))


def _fitted(solid: Solid, size: tuple[float, float, float]) -> Solid:
    """The solid stretched to an exact size, by less than one per cent."""
    low, high = solid.bounds
    x, y, z = (float(wanted / extent) for wanted, extent in zip(size, high - low, strict=True))
    return solid.scaled(x, y, z)
