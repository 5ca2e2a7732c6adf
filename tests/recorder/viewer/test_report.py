"""The pages about one run and about many runs, in a real browser."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlparse

import pytest

import recorder
from pycram.bullet_world import BulletWorld
from pycram.failures import PlanFailure
from pycram.language import seq
from replay.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.recorder.viewer.conftest import Browser

SHOWN = """JSON.stringify({
  counts: [...document.querySelectorAll("table")].map(t => [...t.tBodies[0].rows].map(r => r.children[1].textContent)),
  links: [...document.querySelectorAll("a")].map(a => a.href),
})"""
KEY = "((at, key) => document.querySelector(at).dispatchEvent(new KeyboardEvent('keydown', { key })))"
PLAN = """from pycram.bullet_world import BulletWorld, Object
from pycram.failures import PlanFailure
from pycram.language import failure_handling, seq


def open_lid(cup):
    print(cup)
    raise PlanFailure("the <script>lid</script> is stuck")


def attempt_once(cup):
    with seq as s:
        s(open_lid, cup)


with BulletWorld():
    Object("floor", "environment", "plane.urdf")
    cup = Object("cup", "cup", "cup.stl", [0, 0, 0])
    for x in (0.1, 0.2, 0.3):
        cup.set_position([x, 0, 0])
    for attempt in failure_handling(1).on(PlanFailure, lambda failure: {}):
        with attempt:
            attempt_once(cup)
"""
CLICK = "document.querySelectorAll('table')[0].tHead.rows[0].children[1].querySelector('button').click()"


def _fail(why: str) -> None:
    raise PlanFailure(why)


@pytest.mark.slow
def test_its_tables_are_sorted_by_a_click_and_its_links_lead_to_recordings(
    tmp_path: Path, browser: Browser, until: Callable[..., None]
) -> None:
    runs = tmp_path / "runs <b>'1'"
    runs.mkdir()
    for number, why in enumerate("aabbbc"):
        with (
            pytest.raises(PlanFailure),
            recorder.record(runs / f"{number}.mcap", name="fails"),
            BulletWorld(),
            seq as s,
        ):
            s(_fail, f"<script>{why}</script>")
    page = tmp_path / "reports" / "report.html"
    page.parent.mkdir()
    assert main(["stats", str(runs), "--html", str(page)]) == 0

    def asked(script: str) -> str:
        answer = browser.call("Runtime.evaluate", expression=script)
        return str(answer["result"].get("value", ""))

    browser.order("Page.navigate", url=page.as_uri())
    until(lambda: asked("document.readyState + document.querySelectorAll('table').length") == "complete2", "the report")
    shown = json.loads(asked(SHOWN))
    assert shown["counts"][0] == ["3", "2", "1"]
    linked = {Path(unquote(urlparse(link).path)) for link in shown["links"]}
    assert linked == {runs / "0.mcap", runs / "2.mcap", runs / "5.mcap"}
    asked(CLICK)
    asked(CLICK)
    assert json.loads(asked(SHOWN))["counts"][0] == ["1", "2", "3"]
    assert not browser.errors()


LOOK = """JSON.stringify({
  bars: document.querySelectorAll("#timeline rect").length,
  axis: [...document.querySelectorAll("#timeline .axis")].map(t => t.textContent),
  moment: document.querySelector("#moment").textContent,
  now: [...document.querySelectorAll("#strip img")].findIndex(p => p.classList.contains("now")),
  lines: [...document.querySelectorAll(".failing")].map(r => r.textContent),
  wide: document.documentElement.scrollWidth,
  text: document.body.innerText,
  network: performance.getEntriesByType("resource").map(e => e.name).filter(n => !n.startsWith("data:")),
})"""


@pytest.mark.slow
def test_the_page_of_a_run_shows_the_failure_its_moments_and_the_lines_that_led_to_it(
    tmp_path: Path, browser: Browser, until: Callable[..., None]
) -> None:
    plan, log, page = tmp_path / "plan.py", tmp_path / "run.mcap", tmp_path / "run.html"
    plan.write_text(PLAN)
    subprocess.run([sys.executable, "-m", "pycram", "run", plan, "--log", log], capture_output=True, check=False)
    assert main(["report", str(log), "-o", str(page), "--good", str(log)]) == 0
    assert page.stat().st_size < 1_000_000

    def look(*, after: str = "0") -> dict[str, Any]:
        answer = browser.call("Runtime.evaluate", expression=f"{after};\n{LOOK}")
        looked: dict[str, Any] = json.loads(str(answer["result"].get("value", "")))
        return looked

    browser.order("Page.navigate", url=page.as_uri())
    until(
        lambda: (
            browser.call("Runtime.evaluate", expression="document.readyState + document.title")["result"]["value"]
            == "completeplan: failed"
        ),
        "the page",
    )
    shown = look()
    assert "the <script>lid</script> is stuck" in shown["text"]  # escaped, as it was written
    assert shown["network"] == []
    assert shown["bars"] == 7  # the retries, and for each of two attempts the attempt, its block and its branch
    assert [line for line in shown["lines"] if "open_lid" in line] == [
        "13        s(open_lid, cup)open_lid failed, steps 12, 19"
    ]
    assert shown["now"] == 2
    before = look(after="key('#film', 'ArrowLeft')".replace("key", KEY))
    assert (before["now"], before["moment"]) == (1, "step 7, 0.000 s: move body cup [0.200, 0.000, 0.000]")
    zoomed = look(after="document.querySelector('#keys button').click()")
    assert zoomed["axis"] != shown["axis"]
    assert look(after="document.querySelectorAll('#keys button')[2].click()")["axis"] == shown["axis"]
    clicked = look(after="document.querySelector('.row[data-step]').click()")
    assert clicked["now"] == 2
    browser.call("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=True)
    assert look()["wide"] == 390  # nothing is cut off on a phone
    assert not browser.errors()
