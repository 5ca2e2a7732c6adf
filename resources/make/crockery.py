"""Crockery: hollow things of revolution on a flat foot, with walls of convex pieces, so that objects fit inside."""

from __future__ import annotations

import numpy as np

from make.solids import Profile, Solid, block, disc, join, revolve, sectors, tube
from make.thing import MARGIN, Part, Thing

SEGMENTS = 48
PIECES = 16


def bowl() -> Thing:
    """A cereal bowl, 0.140 x 0.139 x 0.067 m, on a foot of 72 mm."""
    inner = [(0.034, 0.0100), (0.0500, 0.0225), (0.0610, 0.0430), (0.0668, 0.0670)]
    outer = [(0.0360, 0.0045), (0.0535, 0.0200), (0.0645, 0.0420), (0.0700, 0.0670)]
    foot = [(0.0, 0.0), (0.035, 0.0), (0.036, 0.0010)]
    floor = [(0.018, 0.0080), (0.0, 0.0075)]
    solid = revolve([*foot, *outer, *inner[::-1], *floor], SEGMENTS)
    glaze = revolve([(0.0, 0.0078), (0.018, 0.0083), *_lifted(inner), *inner[::-1], *floor], SEGMENTS)
    oval = 0.139 / 0.140
    foot_and_wall = (disc(0.035, (MARGIN, 0.0075 - MARGIN)), *_wall(inner, outer))
    pieces = tuple(piece.scaled(y=oval) for piece in foot_and_wall)
    parts = (
        Part("glaze", (0.93, 0.90, 0.82), glaze.scaled(y=oval)),
        Part("ceramic", (0.16, 0.38, 0.62), solid.scaled(0.9985, 0.9985 * oval, 0.9985)),
    )
    return Thing("bowl", 0.30, 0.9, solid.scaled(y=oval), pieces, parts).centred()


def cup() -> Thing:
    """A mug for coffee, 80 mm wide without its handle, 92 mm high."""
    outer = [(0.0375, 0.0025), (0.0400, 0.0120), (0.0400, 0.0920)]
    inner = [(0.0340, 0.0060), (0.0365, 0.0130), (0.0365, 0.0920)]
    shell = revolve([(0.0, 0.0), (0.0355, 0.0), *outer, *inner[::-1], (0.0, 0.0055)], 40)
    bend = np.linspace(-1.25, 1.25, 13)
    path = [(0.0375 + 0.0310 * np.cos(turn) - 0.0085, 0.047 + 0.0285 * np.sin(turn)) for turn in bend]
    handle = tube([(0.0375, path[0][1]), *path, (0.0375, path[-1][1])], 0.0052, 10)
    lining = revolve([(0.0, 0.0058), *_lifted(inner), *inner[::-1], (0.0, 0.0055)], 40)
    grip = [
        block((0.041, 0.053), (-0.0042, 0.0042), (0.0165, 0.0245)),
        block((0.0525, 0.0590), (-0.0042, 0.0042), (0.0205, 0.0735)),
        block((0.041, 0.053), (-0.0042, 0.0042), (0.0695, 0.0775)),
    ]
    pieces = (disc(0.0355, (MARGIN, 0.0055 - MARGIN)), *_wall(inner, outer), *grip)
    parts = (
        Part("lining", (0.95, 0.94, 0.90), lining),
        Part("ceramic", (0.80, 0.22, 0.16), join([shell.scaled(0.9985, 0.9985, 0.9985), handle])),
    )
    return Thing("cup", 0.32, 0.8, join([shell, handle]), pieces, parts).centred()


def plate() -> Thing:
    """A dinner plate, 220 mm wide, 22 mm high, with a coloured rim."""
    outer = [(0.066, 0.0035), (0.0800, 0.0080), (0.1100, 0.0190), (0.1100, 0.0220)]
    inner = [(0.064, 0.0065), (0.0785, 0.0115), (0.1065, 0.0218), (0.1095, 0.0220)]
    solid = revolve([(0.0, 0.0), (0.065, 0.0), *outer, *inner[:0:-1], inner[0], (0.0, 0.0060)], SEGMENTS)
    ring = revolve([(0.0920, 0.0168), (0.1055, 0.0217), (0.1055, 0.0221), (0.0920, 0.0172)], SEGMENTS)
    pieces = (disc(0.065, (MARGIN, 0.0060 - MARGIN)), *_wall(inner[:3], [*outer[:2], (0.1100, 0.0195)]))
    parts = (Part("rim", (0.16, 0.38, 0.62), ring), Part("ceramic", (0.95, 0.94, 0.90), solid))
    return Thing("plate", 0.48, 0.8, solid, pieces, parts).centred()


def glass() -> Thing:
    """A tumbler, 70 mm wide at the rim, 120 mm high, with a thick bottom."""
    outer = [(0.0270, 0.0100), (0.0350, 0.1200)]
    inner = [(0.0240, 0.0100), (0.0326, 0.1200)]
    solid = revolve([(0.0, 0.0), (0.0262, 0.0), *outer, *inner[::-1], (0.0, 0.0100)], 40)
    pieces = (disc(0.0262, (MARGIN, 0.0100 - MARGIN)), *_wall(inner, outer))
    inside = revolve([(0.0, 0.0102), *_lifted(inner), *inner[::-1], (0.0, 0.0100)], 40)
    parts = (Part("inside", (0.62, 0.78, 0.84), inside), Part("glass", (0.80, 0.90, 0.92), solid))
    return Thing("glass", 0.24, 0.7, solid, pieces, parts).centred()


def pot() -> Thing:
    """A cooking pot, 200 mm wide without its two handles, 120 mm high."""
    outer = [(0.0980, 0.0030), (0.1000, 0.0100), (0.1000, 0.1200)]
    inner = [(0.0940, 0.0060), (0.0965, 0.0110), (0.0965, 0.1200)]
    shell = revolve([(0.0, 0.0), (0.0950, 0.0), *outer, *inner[::-1], (0.0, 0.0055)], SEGMENTS)
    rim = revolve([(0.0962, 0.1160), (0.1016, 0.1160), (0.1016, 0.1200), (0.0962, 0.1200)], SEGMENTS)
    handles, grips = [], []
    for side in (-1.0, 1.0):
        bar = [block((0.128, 0.138), (-0.034, 0.034), (0.088, 0.098))]
        bar += [block((0.097, 0.132), (y - 0.005, y + 0.005), (0.088, 0.098)) for y in (-0.029, 0.029)]
        grip = [block((0.129, 0.137), (-0.033, 0.033), (0.089, 0.097))]
        grip += [block((0.101, 0.129), (y - 0.004, y + 0.004), (0.089, 0.097)) for y in (-0.029, 0.029)]
        turn = 0.0 if side > 0 else np.pi
        handles += [piece.turned("z", turn) for piece in bar]
        grips += [piece.turned("z", turn) for piece in grip]
    pieces = (disc(0.0950, (MARGIN, 0.0055 - MARGIN)), *_wall(inner, outer), *grips)
    parts = (
        Part("steel", (0.72, 0.73, 0.76), join([shell, rim])),
        Part("handles", (0.12, 0.12, 0.13), join(handles)),
    )
    return Thing("pot", 1.25, 0.6, join([shell, rim, *handles]), pieces, parts).centred()


def _wall(inner: Profile, outer: Profile) -> list[Solid]:
    """Convex pieces of a wall, thinner by the margin on both sides and at the rim."""
    thin_in = [(r + MARGIN * 0.9, z) for r, z in inner]
    thin_out = [(r - MARGIN * 0.9, z) for r, z in outer]
    thin_in[0] = (thin_in[0][0], max(thin_in[0][1] - MARGIN, thin_out[0][1] + MARGIN / 2))
    for row in (thin_in, thin_out):
        row[-1] = (row[-1][0], row[-1][1] - MARGIN)
    return sectors(thin_in, thin_out, PIECES)


def _lifted(inner: Profile) -> list[tuple[float, float]]:
    """The profile of a hollow's lining: the inside, 0.4 mm nearer to the axis, up to the rim."""
    return [(r - 0.0004, z) for r, z in inner]
