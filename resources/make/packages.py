"""Packages and food: closed bodies."""

from __future__ import annotations

import numpy as np

from make.solids import Profile, bevelled, block, disc, extrude, join, revolve, rounded
from make.thing import MARGIN, Part, Thing, lettering


def milk() -> Thing:
    """A carton of milk with a gable top, 0.064 x 0.065 x 0.194 m, flat underneath, a red cap on its slope."""
    x, y, eaves, ridge, top = 0.0320, 0.0325, 0.1480, 0.1780, 0.1940
    fin = 0.0022

    def outline(inset: float) -> Profile:
        side = [(x - inset, inset), (x - inset, eaves), (fin, ridge), (fin, top - inset)]
        return [*((-px, pz) for px, pz in side), *reversed(side)]

    solid = extrude(outline(0.0), (-y, y))
    cap = disc(0.0110, (-0.004, 0.0070), 20).turned("y", np.arctan2(ridge - eaves, x - fin)).moved(0.0172, 0.0, 0.1630)
    band = [
        block((-x - 0.0003, x + 0.0003), (-y - 0.0003, y + 0.0003), span) for span in ((0.0, 0.034), (0.118, 0.128))
    ]
    roof = extrude(
        [(-x - 0.0003, eaves - 0.006), (-x - 0.0003, eaves), (x + 0.0003, eaves), (x + 0.0003, eaves - 0.006)],
        (-y - 0.0003, y + 0.0003),
    )
    letters = lettering("MILK", 0.052, y).moved(z=0.078)
    sides = join([letters, letters.turned("z", np.pi / 2).scaled(x=x / y)])
    i = MARGIN
    pieces = (
        block((i - x, x - i), (i - y, y - i), (i, eaves - i)),
        extrude([(i - x, eaves - i), (-fin, ridge - i), (fin, ridge - i), (x - i, eaves - i)], (i - y, y - i)),
        block((i - fin, fin - i), (i - y, y - i), (ridge - i, top - i)),
    )
    parts = (
        Part("carton", (0.94, 0.95, 0.96), solid),
        Part("print", (0.10, 0.34, 0.72), join([*band, roof, sides])),
        Part("cap", (0.82, 0.12, 0.12), cap),
    )
    return Thing("milk", 1.05, 0.8, solid, pieces, parts).centred()


def breakfast_cereal() -> Thing:
    """A box of breakfast cereal, 0.148 x 0.058 x 0.224 m, with bevelled edges."""
    size = (0.148, 0.058, 0.224)
    solid = bevelled(size, 0.0020)
    core = bevelled((size[0] - 2 * MARGIN, size[1] - 2 * MARGIN, size[2] - 2 * MARGIN), 0.0015)
    face = size[1] / 2
    sign = block((-0.0660, 0.0660), (-face - 0.0003, face + 0.0003), (0.045, 0.091))
    dish = [(-0.046, 0.0), (-0.036, -0.024), (-0.018, -0.034), (0.018, -0.034), (0.036, -0.024), (0.046, 0.0)]
    bowl = extrude([(px, pz - 0.048) for px, pz in dish], (-face - 0.0003, face + 0.0003))
    heap = [(px * 0.93, 0.017 * np.cos(px / 0.046 * np.pi / 2) - 0.048) for px in np.linspace(-0.046, 0.046, 12)]
    flakes = extrude(heap, (-face - 0.0004, face + 0.0004))
    parts = (
        Part("box", (0.95, 0.66, 0.12), solid),
        Part("sign", (0.72, 0.10, 0.10), sign),
        Part("letters", (0.98, 0.97, 0.92), lettering("CEREAL", 0.118, face + 0.0003).moved(z=0.068)),
        Part("bowl", (0.15, 0.36, 0.60), bowl),
        Part("flakes", (0.60, 0.33, 0.10), flakes),
    )
    return Thing("breakfast_cereal", 0.40, 0.8, solid, (core,), parts).centred()


def bottle() -> Thing:
    """A bottle of water, 70 mm wide, 250 mm high, with a label and a cap."""
    body = [
        (0.0, 0.0),
        (0.0315, 0.0),
        (0.0350, 0.0040),
        (0.0350, 0.1550),
        (0.0330, 0.1720),
        (0.0260, 0.1920),
        (0.0170, 0.2070),
    ]
    neck = [(0.0130, 0.2160), (0.0130, 0.2300), (0.0, 0.2300)]
    cap = [(0.0, 0.2280), (0.0150, 0.2280), (0.0150, 0.2490), (0.0140, 0.2500), (0.0, 0.2500)]
    label = [(0.0, 0.0550), (0.0354, 0.0550), (0.0354, 0.1350), (0.0, 0.1350)]
    i = MARGIN
    profiles: list[Profile] = [
        [(0.0, i), (0.0315, i), (0.0350 - i, 0.0040), (0.0350 - i, 0.1550), (0.0330 - i, 0.1720), (0.0, 0.1720)],
        [(0.0, 0.1720), (0.0330 - i, 0.1720), (0.0260 - i, 0.1920), (0.0170 - i, 0.2070), (0.0, 0.2070)],
        [(0.0, 0.2070), (0.0150 - i, 0.2070), (0.0150 - i, 0.2500 - i), (0.0, 0.2500 - i)],
    ]
    pieces = tuple(revolve(profile, 16) for profile in profiles)
    solid = revolve([*body, (0.0130, 0.2160), (0.0130, 0.2280), *cap[1:]], 40)
    parts = (
        Part("body", (0.20, 0.55, 0.38), revolve([*body, *neck], 40)),
        Part("label", (0.95, 0.94, 0.88), revolve(label, 40)),
        Part("cap", (0.14, 0.22, 0.55), revolve(cap, 40)),
    )
    return Thing("bottle", 0.85, 0.7, solid, pieces, parts).centred()


def apple() -> Thing:
    """A red apple, 75 mm wide, with a stalk in its dimple."""
    radii = 0.0, 0.0060, 0.0130, 0.0200, 0.0300, 0.0362, 0.0380, 0.0345, 0.0255, 0.0150, 0.0065, 0.0
    heights = 0.0060, 0.0030, 0.0, 0.0015, 0.0120, 0.0260, 0.0400, 0.0560, 0.0670, 0.0690, 0.0640, 0.0570
    skin = rounded(list(zip(radii, heights, strict=True)))
    body = revolve(skin, 32)
    low, high = min(z for _, z in skin) + MARGIN, max(z for _, z in skin) - MARGIN
    stalk = revolve([(0.0, 0.0560), (0.0016, 0.0560), (0.0022, 0.0800), (0.0, 0.0800)], 8).moved(x=0.001)
    i = 2 * MARGIN
    core = [
        (0.0, low),
        (0.0150, low),
        (0.0300 - i, 0.0120),
        (0.0380 - i, 0.0400),
        (0.0345 - i, 0.0560),
        (0.0230, high),
        (0.0, high),
    ]
    parts = (Part("skin", (0.75, 0.13, 0.12), body), Part("stalk", (0.32, 0.21, 0.10), stalk))
    return Thing("apple", 0.18, 0.7, join([body, stalk]), (revolve(core, 12),), parts).centred()
