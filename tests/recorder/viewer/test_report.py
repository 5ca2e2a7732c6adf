"""The report of many runs, in a real browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING
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
CLICK = "document.querySelectorAll('table')[0].tHead.rows[0].children[1].click()"


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
