"""A plan in the browser: live, on this machine alone."""

from __future__ import annotations

import re
import threading
from functools import partial
from http.client import HTTPConnection
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import numpy as np
import pytest

from recorder.viewer.web_page import Page

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable, Iterator
    from http.client import HTTPResponse

    from conftest import Browser
    from PIL import Image

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


@pytest.mark.slow
@pytest.mark.usefixtures("usual_ports")
def test_a_plan_is_seen_in_the_browser_while_it_runs(
    pycram: Callable[..., subprocess.Popen[str]], browser: Browser, tmp_path: Path, until
) -> None:
    (tmp_path / "plan.py").write_text(PLAN)
    demos = Path(__file__).parent.parent.parent / "demos"
    process = pycram("run", "plan.py", "--rerun=serve", "--", str(demos))
    assert process.stderr is not None
    line = process.stderr.readline()
    page = re.fullmatch(r"recorder: live at (http://127\.0\.0\.1:\d+/\?\S*url=\S+)\n", line)
    assert page, line
    browser.call("Page.navigate", url=page[1] + "&renderer=webgl")
    file = tmp_path / "page.png"
    until(lambda: shades(scene(browser.picture(file))) > 12, "robot and kitchen are seen", 300)
    pictures = [scene(browser.picture(file))]

    def rests() -> bool:
        pictures.append(scene(browser.picture(file)))
        return differing(*pictures[-2:]) < 0.001

    until(rests, "all has come", 300)
    (tmp_path / "seen").touch()
    until(lambda: differing(pictures[-1], scene(browser.picture(file))) > 0.01, "the robot has gone elsewhere", 300)
    (tmp_path / "seen again").touch()
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 0, rest
    asked = browser.asked()
    assert any(url.endswith(".wasm") for url in asked), "the viewer comes from this machine"
    assert any("ReadMessages" in url for url in asked), "and so do the records"
    assert {urlsplit(url).hostname for url in asked} == {"127.0.0.1"}, "nobody else is asked, not even for a font"
    assert not browser.errors()


def differing(a: Image.Image, b: Image.Image) -> float:
    """Which part of two pictures differs clearly."""
    grey = [np.asarray(picture.convert("L"), dtype=int) for picture in (a, b)]
    return float((abs(grey[0] - grey[1]) > 40).mean())


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The port of a server like the one that the viewer's library has."""
    folder = tmp_path_factory.mktemp("library")
    (folder / "index.html").write_text('<link\n rel="preconnect" href="https://x.org" /><link href="icon.ico" />here')
    (folder / "viewer.wasm").write_bytes(bytes(range(256)) * 1000)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder))
    threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
    yield server.server_port
    server.shutdown()
    server.server_close()


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None: ...  # noqa: A002  the library's name


@pytest.fixture(scope="module")
def page(library: int) -> Iterator[Callable[[str], tuple[HTTPResponse, bytes]]]:
    """Gets files from the page's server."""
    served = Page(0, library, 1234)

    def get(path: str) -> tuple[HTTPResponse, bytes]:
        connection = HTTPConnection("127.0.0.1", served.server_port)
        connection.request("GET", path)
        with connection.getresponse() as answer:
            content = answer.read()
        connection.close()
        return answer, content

    yield get
    served.shutdown()
    served.server_close()


def test_the_page_may_contact_this_machine_only(page: Callable[[str], tuple[HTTPResponse, bytes]]) -> None:
    answer, content = page("/?url=x")
    assert content == b'<link href="icon.ico" />here'
    rules = dict(rule.split(maxsplit=1) for rule in str(answer.getheader("Content-Security-Policy")).split("; "))
    assert rules["connect-src"] == "'self' data: blob: http://127.0.0.1:1234"
    assert rules["default-src"] == "'self' data: blob:"


def test_other_files_are_passed_on_unchanged(page: Callable[[str], tuple[HTTPResponse, bytes]]) -> None:
    answer, content = page("/viewer.wasm")
    assert content == bytes(range(256)) * 1000
    assert answer.getheader("Content-Length") == "256000"
    assert page("/none.js")[0].status == 404


def test_a_port_that_somebody_has_is_refused(library: int) -> None:
    with pytest.raises(OSError, match="in use"):
        Page(library, library, 1)
