"""The site of the documentation: built strictly, searched in a real browser, shown on a phone, without the network."""

from __future__ import annotations

import functools
import http.server
import json
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest

pytestmark = pytest.mark.costly  # building the site takes 10 s

REPO = Path(__file__).parents[3]

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.recorder.viewer.conftest import Browser

#: What a roboticist types, and a page that answers it.
WORDS: Final = {
    "gripper": "howto/robot_add_gripper",
    "urdf": "guides/models",
    "inverse kinematics": "guides/robots",
    "collision": "reference/",
    "grasp": "reference/",
    "trajectory": "guides/motion",
    "quaternion": "reference/designators",
    "pick and place": "tutorial/",
    "camera": "guides/robots",
    "reachability": "glossary",
    "joint limits": "guides/robots",
    "drawer": "guides/",
    "tiago": "guides/robots",
    "panda": "tutorial/5",
    "mcap": "reference/",
    "foxglove": "guides/viewer",
    "ros": "index",
    "debugger": "guides/debug",
    "deadlock": "guides/fluents",
    "pytest": "guides/testing",
    "jupyter": "guides/notebooks",
    "teleport": "glossary",
}
SEARCH = """(() => {
  const field = document.querySelector(".md-search__input");
  field.focus();
  field.value = %s;
  field.dispatchEvent(new Event("input", { bubbles: true }));
  field.dispatchEvent(new KeyboardEvent("keyup", { bubbles: true }));
})()"""
FOUND = 'JSON.stringify([...document.querySelectorAll(".md-search-result__item a")].map(a => a.getAttribute("href")))'


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site, as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "docs.make_site", str(folder)]
    ended = subprocess.run(command, cwd=REPO, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return folder


@pytest.fixture
def address(site: Path) -> Iterator[str]:
    """Where a plain web server shows the site."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.slow
def test_the_site_needs_no_network_and_lists_its_version(site: Path) -> None:
    (version,) = json.loads((site / "versions.json").read_text())
    assert (site / version["version"] / "index.html").is_file()
    for page in site.rglob("*.html"):
        loaded = re.findall(r"<(?:script|img|link|iframe)[^>]*?(?:src|href)=\"?(https?:[^\" >]*)", page.read_text())
        assert not [each for each in loaded if "canonical" not in each], page
    names = (site / version["version"] / "reference" / "names" / "worlds.html").read_text()
    assert 'id="pycram.bullet_world.BulletWorld"' in names
    assert not re.search(r'id="[\w.]+\._[a-z]', names), "private names"
    notebooks = list(site.rglob("tutorial/*.ipynb"))
    assert len(notebooks) == 7
    assert all(json.loads(each.read_text())["nbformat"] == 4 for each in notebooks)


@pytest.mark.slow
def test_search_finds_what_a_roboticist_types_and_a_phone_shows_the_pages(
    address: str, browser: Browser, until: Callable[..., None]
) -> None:
    def asked(script: str) -> Any:
        answer = browser.call("Runtime.evaluate", expression=script)
        return answer["result"].get("value", "")

    browser.call("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
    browser.order("Page.navigate", url=f"{address}/index.html")
    until(lambda: asked("document.readyState + !!document.querySelector('.md-search__input')") == "completetrue", "it")
    assert asked("document.documentElement.scrollWidth") <= 390
    for word, page in WORDS.items():  # results appear one after another, so each is waited for
        asked(SEARCH % json.dumps(word))
        first = word.split()[0]
        until(
            lambda page=page, first=first: (
                first in asked(FOUND).lower()
                and any(page in each.partition("?")[0] for each in json.loads(asked(FOUND)))
            ),
            f"{page} among the results for {word}",
        )
    assert {each for each in browser.asked() if not each.startswith((address, "about:", "data:", "blob:"))} == set()
    assert not browser.errors()
