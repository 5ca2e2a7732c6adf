"""A copy that another program wrote is the same recording: other chunks or none, other compression, any order."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType

import replay
from replay.cli.main import main
from replay.restore.verify import verify
from tests.replay.copies import rewritten_by_mcap

GOLDEN = Path(__file__).parents[1] / "golden" / "0.1.0.mcap"
COPIES: dict[str, dict[str, Any]] = {
    "large chunks": {},
    "small chunks": {"chunk_size": 300},
    "uncompressed": {"compression": CompressionType.NONE, "chunk_size": 5000},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 2000},
    "no chunks": {"use_chunking": False},
    "other channels": {"other_ids": True, "chunk_size": 4000},
    "one topic after the other": {"by_topic": True, "other_ids": True, "chunk_size": 3000},
    "the same without chunks or numbers": {"by_topic": True, "use_chunking": False, "numbered": False},
    "channels without worlds": {"bare_channels": True, "by_topic": True, "chunk_size": 3000},
    "no summary": {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False},
    "no checksums": {"enable_crcs": False, "chunk_size": 4000},
}
VERBS = ("log", "info", "tree", "why", "state 0", "state 9", "state 100", "state last", "show 0", "diff 9 last")


def output_of(file: Path, verb: str, capsys: pytest.CaptureFixture[str]) -> list[Any]:
    """What a verb says of a recording, but for the file's own name and size."""
    name, *rest = verb.split()
    code = main([name, str(file), *rest, "--json"])
    output = capsys.readouterr()
    said = [json.loads(line) for line in output.out.splitlines()]
    for each in said:
        if isinstance(each, dict):
            each.pop("file", None)
            each.pop("size", None)
    return [code, output.err, said]


@pytest.mark.slow
@pytest.mark.parametrize("options", COPIES.values(), ids=COPIES.keys())
def test_every_reading_verb_says_the_same_of_a_copy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: dict[str, Any]
) -> None:
    copy = rewritten_by_mcap(GOLDEN, tmp_path / "x.mcap", **options)
    for verb in VERBS:
        assert output_of(copy, verb, capsys) == output_of(GOLDEN, verb, capsys), verb
    assert main(["verify", "--static", str(copy)]) == 0
    with replay.open(copy) as log, replay.open(GOLDEN) as original:
        assert log.complete
        assert [log[step] for step in range(len(log))] == list(original)
        assert list(log.backwards()) == list(original)[::-1]


@pytest.mark.parametrize("name", ["one topic after the other", "no chunks"])
def test_a_copy_verifies(tmp_path: Path, name: str) -> None:
    with replay.open(rewritten_by_mcap(GOLDEN, tmp_path / "x.mcap", **COPIES[name])) as log:
        verdict = verify(log)
    assert verdict.exact, verdict
    assert verdict.changes == 123


def test_damage_of_a_copy_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = rewritten_by_mcap(GOLDEN, tmp_path / "x.mcap", by_topic=True, chunk_size=3000)
    content = bytearray(copy.read_bytes())
    content[len(content) // 2] ^= 1
    copy.write_bytes(content)
    assert main(["log", str(copy)]) == 3
    assert "damaged" in capsys.readouterr().err
