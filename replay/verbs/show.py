"""``show``: one record whole."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from google.protobuf.json_format import MessageToDict

from recorder.records import TOPICS
from replay.steps import step_of

if TYPE_CHECKING:
    import argparse

    from replay.log import Log

HELP = "one record whole"


def add(parser: argparse.ArgumentParser) -> None:
    """Takes the step."""
    parser.add_argument("step", metavar="STEP", help="number, -1, last, failure, or 12.5s")


def run(log: Log, options: argparse.Namespace) -> tuple[object, str]:
    """Shows it.

    Returns:
        The record as it stands in the log.
    """
    record = log[step_of(log, options.step)]
    facts = {"kind": TOPICS[type(record)][1:], **MessageToDict(record, preserving_proto_field_name=True)}
    return facts, json.dumps(facts, indent=2, ensure_ascii=False)
