"""``log.proto``: the checked-in modules are compiled from it, and all records have the same envelope."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from recorder.records import TOPICS

REPO = Path(__file__).parent.parent.parent.parent
BIN = Path(sys.executable).parent


def test_checked_in_modules_are_compiled_from_the_definition(tmp_path: Path) -> None:
    made_already = ("-o", ".venv/ready-dev")
    subprocess.run(["make", *made_already, "proto", f"PROTO_OUT={tmp_path}", f"BIN={BIN}"], cwd=REPO, check=True)
    for name in ("log_pb2.py", "log_pb2.pyi"):
        made = (tmp_path / "recorder" / "records" / name).read_text()
        kept = (REPO / "recorder" / "records" / name).read_text()
        # the compiler writes its own version, which may be newer on another machine
        assert _without_version(made) == _without_version(kept), f"run: make proto ({name})"


def _without_version(text: str) -> list[str]:
    lines = [line for line in text.splitlines() if "Protobuf Python Version" not in line]
    start = next((i for i, line in enumerate(lines) if "ValidateProtobufRuntimeVersion" in line), None)
    return lines if start is None else lines[:start] + lines[start + 8 :]


@pytest.mark.parametrize("record", TOPICS, ids=lambda record: record.__name__)
def test_every_record_has_the_envelope(record: type) -> None:
    fields = {field.number: field.name for field in record.DESCRIPTOR.fields}
    envelope = ("seq", "wall_time_ns", "sim_step", "world", "task", "thread", "cause", "monotonic_ns")
    assert tuple(fields[number] for number in range(1, 9)) == envelope
    assert not [number for number in fields if 9 <= number <= 15], "reserved for the envelope"
