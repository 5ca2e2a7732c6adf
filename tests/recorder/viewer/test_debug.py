"""The viewer follows the debugger from step to step, both ways."""

from __future__ import annotations

import sys
from io import StringIO
from typing import TYPE_CHECKING

import pytest

from recorder.viewer.rerun_stream import STEP
from replay.cli.main import main
from tests.replay.debug.plans import recorded

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.recorder.viewer.conftest import Headless


@pytest.mark.costly
def test_the_viewer_follows_the_debugger(
    tmp_path: Path, headless: Headless, until: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = []

    class Typed(StringIO):
        """Has a look at the viewer before each line."""

        def readline(self, *_: object) -> str:
            if self.tell() > 0:
                until(headless.has_loaded, "it is loaded")
                (recording,) = headless.state().recordings
                shown.append((recording.current_timeline, recording.current_time))
            return super().readline()

    monkeypatch.setattr(sys, "stdin", Typed(f"view --connect {headless.url}\ns\ng 20\nrs\n"))
    assert main(["debug", str(recorded(tmp_path)), "7"]) == 0
    assert shown == [(STEP, step) for step in (7, 8, 20, 19)]
