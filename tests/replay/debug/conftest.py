"""A plan to debug, and a prompt that commands are typed at."""

from __future__ import annotations

import sys
from io import StringIO
from typing import TYPE_CHECKING

import pytest

from replay.cli.main import main
from tests.replay.debug.plans import recorded

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PROMPT = "(debug) "


@pytest.fixture(scope="session")
def plan_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("debugged"))


@pytest.fixture
def debug(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., list[str]]:
    """Carries out commands; gives what the prompt printed for each, first what it printed before them."""

    def run(log: Path, *commands: str, step: str = "0", options: tuple[str, ...] = ()) -> list[str]:
        monkeypatch.setattr(sys, "stdin", StringIO("".join(f"{each}\n" for each in commands)))
        assert main(["debug", str(log), step, *options]) == 0
        before, *answers = capsys.readouterr().out.split(PROMPT)
        assert [answer.partition("\n")[0] for answer in answers] == [*commands, ""]
        return [before, *(answer.partition("\n")[2] for answer in answers[:-1])]

    return run
