"""Colours of marks, log lines and tasks, which can be read on the viewer's dark ground, and on its light one."""

from __future__ import annotations

from typing import Final, TypeAlias

Color: TypeAlias = tuple[int, int, int]
"""RGB 0..255."""

BLUE: Final[Color] = (75, 145, 245)
GREEN: Final[Color] = (45, 165, 95)
RED: Final[Color] = (242, 82, 72)
YELLOW: Final[Color] = (205, 150, 0)
GREY: Final[Color] = (140, 140, 140)
