"""Pages of the reference that are made while the site is built: the names, records, tables and commands."""

from __future__ import annotations

import contextlib
import io
import json
import re
from pathlib import Path
from typing import Final

from docs.cells import notebook

_DOCS: Final = Path(__file__).parent
_DEFINITION: Final = re.compile(r"^((?://[^\n]*\n)*)((?:message|enum) (\w+) \{.*?^\})", re.DOTALL | re.MULTILINE)
#: Fields that all records have; the page names them once.
_ENVELOPE: Final = re.compile(
    r"^  (?:int64 seq|int64 wall_time_ns|int64 sim_step|string world|int64 task|string thread|int64 cause"
    r"|int64 monotonic_ns|repeated Strike strikes) = (?:[1-8]|64);[^\n]*\n",
    re.MULTILINE,
)
_RECORDS: Final = _DOCS.parent / "recorder" / "records" / "log.proto"
#: Pages of the public names: the title, and what is on the page.
_NAMES: Final = {
    "plans": ("Plans and parameters", ["pycram"]),
    "worlds": (
        "BulletWorld, Object, Event and RobotDescription",
        [
            "pycram.bullet_world.BulletWorld",
            "pycram.bullet_world.Object",
            "pycram.event",
            "pycram.models.robots.description.RobotDescription",
        ],
    ),
    "designators": (
        "Designators, actions and process modules",
        ["pycram.designator", "pycram.actions", "pycram.process_module"],
    ),
    "language": (
        "The plan language and fluents",
        ["pycram.language", "pycram.fluent", "pycram.fluents.world", "pycram.tasks"],
    ),
    "reasoning": (
        "Queries, beliefs and projection",
        ["pycram.bullet_world_reasoning", "pycram.knowledge", "pycram.projection"],
    ),
    "failures": ("Failures", ["pycram.failures"]),
    "recordings": (
        "Recording and reading",
        ["recorder", "replay.recording.Recording", "replay.state.state", "replay.runs.folder.Runs", "replay.testing"],
    ),
}
#: Subjects of the recipes, by the beginnings of their names.
_SUBJECTS: Final = {
    "plan": "Write plans",
    "robot": "Robots",
    "model": "Models",
    "look": "Look at a run",
    "fail": "Failures",
    "test": "Tests",
    "many": "Many runs",
    "file": "Files",
    "edit": "Editors",
}


def pages() -> dict[str, str]:
    """Return the pages, and the notebooks of the tutorial, by their paths in the site."""
    made = {f"reference/names/{name}.md": _names(*entry) for name, entry in _NAMES.items()}
    made |= {
        "reference/records.md": _records(),
        "reference/commands.md": _commands(),
        "reference/tables.md": _tables(),
        "howto/index.md": _recipes(),
        "guides/index.md": "# Guides\n\nThe rules of each part.\n\n" + _titles("guides", "*"),
    }
    for chapter in sorted((_DOCS / "tutorial").glob("[1-9]*.md")):
        text = json.dumps(notebook(chapter.read_text(encoding="utf-8")), indent=1)
        made[f"tutorial/{chapter.stem}.ipynb"] = text
    return made


def order(page: str) -> tuple[str, int, str]:
    """Return the key that sorts a page in the menu: recipes are sorted by subjects, other pages by names."""
    folder, _, name = page.rpartition("/")
    subjects = list(_SUBJECTS) if folder == "howto" else []
    prefix = name.partition("_")[0]
    return folder, subjects.index(prefix) if prefix in subjects else -1, name


def _titles(folder: str, names: str) -> str:
    """Return a list of links to pages of a folder."""
    found = sorted((_DOCS / folder).glob(f"{names}.md"))
    titles = [page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ") for page in found]
    return "\n".join(f"- [{title}]({page.name})" for title, page in zip(titles, found, strict=True))


def _recipes() -> str:
    """Return the list of all recipes, by their subjects."""
    parts = [f"## {subject}\n\n{_titles('howto', f'{prefix}_*')}\n" for prefix, subject in _SUBJECTS.items()]
    return "\n".join(["# Recipes\n\nEach page solves one task.\n", *parts])


def _names(title: str, names: list[str]) -> str:
    return "\n".join([f"# {title}\n", *(f"::: {name}\n" for name in names)])


def _records() -> str:
    """Return the page of the records, from their definitions."""
    text = _RECORDS.read_text(encoding="utf-8")
    head = text.partition("syntax =")[0]
    about = "\n".join(line[3:] for line in head.splitlines() if line.startswith("//"))
    parts = [
        "# Records\n",
        "A recording is an MCAP file. Each topic has one type of record, as a message of protobuf. This page is made",
        "from `recorder/records/log.proto`; [recordings](recordings.md) has the guarantees.\n",
        f"```text\n{about}\n```\n",
    ]
    for comment, body, name in _DEFINITION.findall(text):
        told = " ".join(line[3:] for line in comment.splitlines())
        shown = body.rstrip() if name == "Envelope" else _ENVELOPE.sub("", body.rstrip())
        parts += [f"## {name}\n", f"{told}\n" if told else "", f"```proto\n{shown}\n```\n"]
    return "\n".join(parts)


def _tables() -> str:
    """Return the page of the tables of a folder of recordings."""
    from replay.runs.schema import RUN, TABLES  # noqa: PLC0415  only this page needs it

    parts = [
        "# Tables of a folder of recordings\n",
        "`pycram-replay sql` selects from these tables ([many runs](../guides/runs.md#sql)).",
        f"Each table has the column `{RUN.name}` first: {RUN.meaning}.",
    ]
    for table in TABLES:
        parts += [
            f"\n## `{table.name}`\n",
            f"One row: {table.meaning}.\n",
            "| column | kind | meaning |",
            "|---|---|---|",
        ]
        parts += [f"| `{column.name}` | {column.kind} | {column.meaning} |" for column in table.columns]
    return "\n".join(parts)


def _commands() -> str:
    """Return the help of all commands and verbs."""
    from pycram.cli import EXAMPLES, main as pycram  # noqa: PLC0415  only this page needs it
    from replay.cli.main import VERBS, main as replay  # noqa: PLC0415  as above

    parts = [
        "# Commands\n",
        "The help of each command. [The command line](command_line.md) says which command answers which question.\n",
    ]
    for name, run, verbs in (("pycram", pycram, EXAMPLES), ("pycram-replay", replay, VERBS)):
        for verb in verbs:
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
                run([verb, "--help"])
            parts += [f"## {name} {verb}\n", f"```text\n{printed.getvalue().rstrip()}\n```\n"]
    return "\n".join(parts)
