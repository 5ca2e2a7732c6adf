"""The wall clock may be set while a plan runs: durations are those of a clock that nobody sets."""

from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING

import pytest

import replay
from recorder.mcap_sink import McapSink
from recorder.records import Run
from recorder.tracing import journal
from recorder.tracing.journal import Journal
from recorder.tracing.span import span
from replay.cli.main import main
from replay.history.tasks import summary

if TYPE_CHECKING:
    from pathlib import Path

HOUR = 3_600_000_000_000
SECOND = 1_000_000_000


@pytest.mark.parametrize("jump", [HOUR, -HOUR])
def test_a_clock_that_is_set_does_not_change_durations(
    tmp_path: Path, jump: int, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "x.mcap"
    seconds = itertools.count()
    wall = itertools.chain([1_700_000_000 * SECOND] * 3, itertools.repeat(1_700_000_000 * SECOND + jump))
    log = Journal([McapSink(file, {"plan": "x"})], lambda: next(wall), lambda: next(seconds) * SECOND)
    log.append(Run(phase=Run.STARTED, name="x"))
    journal.open_journal(log)
    try:
        with span("motion", "first"):
            pass
        with span("motion", "second"):
            pass
        log.append(Run(phase=Run.FINISHED, name="x", succeeded=True))
    finally:
        journal.close_journal(log)
    with replay.open(file) as recording:
        assert [record.monotonic_ns // SECOND for record in recording] == [1, 2, 3, 4, 5, 6]
        assert summary(recording).seconds == 5
        assert recording[-1].wall_time_ns == 1_700_000_000 * SECOND + max(jump, 0)
    assert main(["tree", str(file), "--svg"]) == 0
    bars = re.findall(r'<rect x="([\d.]+)" y="[\d.]+" width="([\d.]+)" height="12"', capsys.readouterr().out)
    (first, wide), (second, as_wide) = [(float(left), float(width)) for left, width in bars]
    assert wide > 100
    assert wide == pytest.approx(as_wide, abs=0.2)
    assert second == pytest.approx(first + 2 * wide, abs=0.3)
