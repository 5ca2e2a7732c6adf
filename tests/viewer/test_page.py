"""A plan in the browser: live, on this machine alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable

    from conftest import Browser
    from PIL import Image

pytestmark = pytest.mark.slow

PLAN = """
import sys
from pathlib import Path
from threading import Event
sys.path.insert(0, sys.argv[1])
import set_the_table

set_the_table.build_scene()
set_the_table.go(set_the_table.COUNTER)
while not Path("seen").exists():
    Event().wait(0.05)
set_the_table.go(set_the_table.ISLAND)
while not Path("seen again").exists():
    Event().wait(0.05)
"""


def scene(picture: Image.Image) -> Image.Image:
    """Where the page shows the world: its upper left, without the bars."""
    width, height = picture.size
    return picture.crop((0, height // 8, width * 58 // 100, height * 2 // 3))


def shades(picture: Image.Image) -> int:
    """How many shades cover a thousandth of a picture or more: 1 or 2 where nothing is, 20 in a kitchen."""
    _, counts = np.unique(np.asarray(picture).reshape(-1, 3) >> 5, axis=0, return_counts=True)
    return int((counts * 1000 > counts.sum()).sum())


@pytest.mark.usefixtures("usual_ports")
def test_a_plan_is_seen_in_the_browser_while_it_runs(
    pycram: Callable[..., subprocess.Popen[str]], browser: Browser, tmp_path: Path, until
) -> None:
    (tmp_path / "plan.py").write_text(PLAN)
    demos = Path(__file__).parent.parent.parent / "demos"
    process = pycram("run", "plan.py", "--rerun=serve", "--", str(demos))
    assert process.stderr is not None
    said = process.stderr.readline()
    page = re.fullmatch(r"recorder: live at (http://127\.0\.0\.1:\d+/\?url=\S+)\n", said)
    assert page, said
    browser.call("Page.navigate", url=page[1] + "&renderer=webgl")
    file = tmp_path / "page.png"
    until(lambda: shades(scene(browser.picture(file))) > 12, "robot and kitchen are seen", 300)
    (tmp_path / "seen").touch()
    before = scene(browser.picture(file))
    until(lambda: differing(before, scene(browser.picture(file))) > 0.01, "the robot has gone elsewhere", 300)
    (tmp_path / "seen again").touch()
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 0, rest
    local = {url for url in browser.asked() if url.startswith("http://127.0.0.1:")}
    assert any(url.endswith(".wasm") for url in local), "the viewer comes from this machine"
    assert any("ReadMessages" in url for url in local), "and so do the records"
    assert not browser.errors()


def differing(one: Image.Image, other: Image.Image) -> float:
    """Which part of two pictures differs clearly."""
    grey = [np.asarray(picture.convert("L"), dtype=int) for picture in (one, other)]
    return float((abs(grey[0] - grey[1]) > 40).mean())
