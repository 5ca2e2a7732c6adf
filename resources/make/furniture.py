"""Furniture: the pieces that kitchens repeat, as shapes in the frame of their link, front towards +x.

Between moving and fixed parts there are gaps of at least 2 mm. Boards are at least 6 mm thick, so that objects don't
fall through.
"""

from __future__ import annotations

from make.urdf import Material, Shape, span

MATERIALS = {
    "front": Material((0.94, 0.92, 0.86), 650.0),
    "island_front": Material((0.33, 0.47, 0.50), 650.0),
    "carcass": Material((0.80, 0.79, 0.75), 650.0),
    "plinth": Material((0.20, 0.20, 0.21), 650.0),
    "worktop": Material((0.66, 0.46, 0.28), 700.0),
    "table_wood": Material((0.76, 0.58, 0.38), 700.0),
    "drawer_wood": Material((0.86, 0.77, 0.61), 600.0),
    "steel": Material((0.70, 0.71, 0.74), 2500.0),
    "dark_steel": Material((0.45, 0.46, 0.49), 2500.0),
    "enamel": Material((0.16, 0.17, 0.20), 2000.0),
    "glass": Material((0.07, 0.08, 0.10), 2500.0),
    "ring": Material((0.52, 0.16, 0.13), 1000.0),
    "display": Material((0.20, 0.65, 0.45), 1000.0),
    "fridge_white": Material((0.90, 0.94, 0.97), 300.0),
    "fridge_glass": Material((0.70, 0.82, 0.88), 2000.0),
    "wall": Material((0.80, 0.83, 0.85), 1200.0),
}

FRONT = 0.281  # outer face of a drawer's front panel in the drawer's frame, metres


def drawer(width: float, height: float, back: float, wall: float, front: str = "front") -> list[Shape]:
    """A drawer that is open at the top: bottom, three walls, and a front panel that covers the gaps around the drawer.

    Args:
        width: Width of the drawer's module, metres; the front is 3 mm narrower, and the box 60 mm narrower.
        height: Height of the front panel.
        back: Rear end of the box, x in the drawer's frame.
        wall: Height of the walls above the underside of the box.
        front: Material of the front panel.
    """
    half, side = width / 2 - 0.0015, width / 2 - 0.030
    inner, low = FRONT - 0.020, 0.008 - height / 2
    rise = (low, low + wall)
    return [
        span((inner, FRONT), (-half, half), (-height / 2, height / 2), front),
        span((back, inner), (-side, side), (low, low + 0.010), "drawer_wood"),
        span((back, inner), (-side, 0.012 - side), rise, "drawer_wood"),
        span((back, inner), (side - 0.012, side), rise, "drawer_wood"),
        span((back, back + 0.012), (0.012 - side, side - 0.012), rise, "drawer_wood"),
    ]


def handle(length: float, depth: float = 0.0515, upright: bool = False) -> list[Shape]:
    """A bar on two posts, along y, or along z if ``upright``. The frame is in the bar.

    ``length`` is the length of the bar, and ``depth`` is the distance from the frame back to the front panel, metres.
    """
    half, thick, post = length / 2, 0.0077, 0.006
    shapes = []
    for at in (0.03 - half, half - 0.03):
        along, across = (at - post, at + post), (-post, post)
        y, z = (across, along) if upright else (along, across)
        shapes.append(span((-depth, -thick), y, z, "steel"))
    y, z = ((-thick, thick), (-half, half)) if upright else ((-half, half), (-thick, thick))
    bar = span((-thick, thick), y, z, "steel", round_about="z" if upright else "y")
    return [bar, *shapes]


def knob() -> list[Shape]:
    """A turning knob that sticks out towards -z, with a pointer."""
    return [
        span((-0.0192, 0.0192), (-0.0192, 0.0192), (-0.0229, -0.0128), "steel", round_about="z"),
        span((0.0, 0.0185), (-0.002, 0.002), (-0.0232, -0.0228), "plinth", solid=False),
    ]


def board(x: tuple[float, float], half: float, z: float) -> list[Shape]:
    """A board of a tall pull-out, 25 mm thick, with a low rail on either side."""
    top = z + 0.0125
    rails = [span(x, y, (top, top + 0.05), "steel") for y in ((-half, 0.012 - half), (half - 0.012, half))]
    return [span(x, (-half, half), (z - 0.0125, top), "drawer_wood"), *rails]


def tall_drawer() -> list[Shape]:
    """A pull-out as tall as a person's shoulder: front, spine and four boards, open at the sides."""
    front = span((0.264, 0.289), (-0.1495, 0.147), (-0.665, 0.665), "front")
    spine = span((-0.255, -0.245), (-0.13, 0.13), (-0.66, 0.45), "drawer_wood")
    boards = [shape for z in (-0.645, -0.33, 0.0, 0.33) for shape in board((-0.245, 0.264), 0.13, z)]
    return [front, spine, *boards]


def panel(width: float, low: float, high: float, front: str = "front") -> list[Shape]:
    """A fixed front panel, 22 mm thick about its frame."""
    return [span((-0.011, 0.011), (0.0015 - width / 2, width / 2 - 0.0015), (low, high), front)]


def rack(x: tuple[float, float], half: float, z: float, rim: float) -> list[Shape]:
    """A wire rack: a thin floor that collides, visible wires, and a rim if it has a height."""
    floor = span(x, (-half, half), (z, z + 0.006), "dark_steel")
    step = half / 4
    wires = [
        span(x, (k * step - half - 0.002, k * step - half + 0.002), (z + 0.006, z + 0.009), "steel", solid=False)
        for k in range(9)
    ]
    if not rim:
        return [floor, *wires]
    rail = (z + rim - 0.005, z + rim)
    edges = [span(x, y, rail, "steel") for y in ((-half, 0.005 - half), (half - 0.005, half))]
    ends = [span((at, at + 0.005), (-half, half), rail, "steel", solid=False) for at in (x[0], x[1] - 0.005)]
    return [floor, *wires, *edges, *ends]
