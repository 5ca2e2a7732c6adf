"""What docs/guides/damaged_recordings.md shows is what a reader gets."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from replay.cli.main import VERBS, main
from tests.replay.copies import CHUNK, container_records, zeroed
from tests.replay.file.test_hostile_recordings import named, urdf
from tests.replay.file.test_newer import forge
from tests.replay.hostile import rewritten

if TYPE_CHECKING:
    import pytest

GUIDE = (Path(__file__).parents[3] / "docs" / "guides" / "damaged_recordings.md").read_text(encoding="utf-8")
GOLDEN = Path(__file__).parents[1] / "golden" / "0.1.0.mcap"


def test_commands_print_what_the_guide_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    content = GOLDEN.read_bytes()
    chunks = [(start, end) for opcode, start, end in container_records(content) if opcode == CHUNK]
    Path("plan.mcap").write_bytes(zeroed(content, *chunks[8]))
    forge(Path("future.mcap"))
    rewritten(GOLDEN, Path("hostile.mcap"), urdf(lambda text, _: named(text, "/etc/passwd")))
    blocks = re.findall(r"```console\n\$ (.*?)\n(.*?)```", GUIDE, re.DOTALL)
    assert len(blocks) == 6
    for command, shown in blocks:
        program, *arguments = shlex.split(command)
        assert program == "pycram-replay"
        code = main(arguments)
        output = capfd.readouterr()
        assert output.out + output.err == shown
        assert code == (3 if "incomplete" in shown or "is damaged" in shown else 0)


def test_the_guide_has_the_exit_codes_of_verify() -> None:
    assert re.findall(r"^\| (\d) \|", GUIDE, re.MULTILINE) == ["0", "1", "2", "3"]
    assert {"verify", "repair"} <= set(VERBS)
