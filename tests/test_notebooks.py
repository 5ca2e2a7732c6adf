"""Notebooks, run in a real kernel: recording across cells, names of cells, tracebacks, HTML; and docs/guides/notebooks.md."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import replay
from recorder.records import Task
from replay.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Mapping

pytestmark = [pytest.mark.slow, pytest.mark.needs("Jupyter"), pytest.mark.filterwarnings("ignore")]

GUIDE = (Path(__file__).parent.parent / "docs" / "guides" / "notebooks.md").read_text(encoding="utf-8")
PLAN = """
import recorder, replay
from pycram.bullet_world import BulletWorld, Object
from pycram.designator import MotionDesignator
from pycram.language import par
from pycram.process_module import ProcessModule
recorder.start("run.mcap")
# %%
world = BulletWorld()
world.robot = Object("pr2", "robot", "pr2.urdf")
milk = Object("<i>milk</i>", "milk", "milk.stl", [2, 1, 0.95])
1 + 1
# %%
def fetch(arm):
    reach = 0.9
    ProcessModule.perform(MotionDesignator([("type", "pick-up"), ("object", milk), ("arm", arm)]))
# %%
fetch("left")
# %%
with par as p:
    p(fetch, "left")
    p(fetch, "right")
# %%
world
# %%
world.exit(); recorder.stop(); log = replay.open("run.mcap"); log
# %%
log.why()
# %%
log.state_at("last")
# %%
log.tree()
# %%
log.blame("<i>milk</i>", 5)
# %%
log.ask(5, "stable('<i>milk</i>')")
# %%
runs = replay.open_runs("."); runs
# %%
runs.sql("SELECT name, source FROM tasks ORDER BY step")
# %%
from pycram.projection import Outcome
Outcome("<i>fetch", False, failure=ValueError("no <i>"))
# %%
log.state_at(5).world().bodies["<i>milk</i>"]
"""


def run_cells(cells: list[str], folder: Path, name: str = "") -> list[list[Mapping[str, Any]]]:
    """Run cells in a kernel, also after errors; return their outputs."""
    from nbclient import NotebookClient  # noqa: PLC0415  tests of notebooks alone need it
    from nbformat import v4  # noqa: PLC0415  as above

    notebook = v4.new_notebook(cells=[v4.new_code_cell(cell) for cell in cells])
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, allow_errors=True, timeout=120, resources=resources).execute(
        env=os.environ | {"JPY_SESSION_NAME": name}  # as Jupyter tells its kernels
    )
    return [cell.outputs for cell in notebook.cells]


def plain(outputs: list[Mapping[str, Any]]) -> str:
    """The text of a cell's outputs: its value, or its error without colours."""
    texts = []
    for output in outputs:
        if output["output_type"] == "error":
            texts.append(re.sub(r"\x1b\[[\d;]*m", "", "\n".join(output["traceback"])))
        elif output["output_type"] != "stream":
            texts.append(output["data"]["text/plain"])
    return "\n".join(texts)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("notebook")


@pytest.fixture(scope="module")
def cells(folder: Path) -> dict[str, list[Mapping[str, Any]]]:
    """Outputs by the source of their cells."""
    sources = [cell.strip() for cell in PLAN.split("# %%\n")]
    return dict(zip(sources, run_cells(sources, folder, "work/table.ipynb"), strict=True))


def test_a_traceback_has_the_lines_of_the_notebook_alone_and_ends_with_the_failure(
    cells: dict[str, list[Mapping[str, Any]]],
) -> None:
    lines = plain(cells['fetch("left")']).splitlines()
    assert [line for line in lines if line.startswith(("Cell", "File"))] == [
        "Cell In[4], line 1",
        "Cell In[3], line 3, in fetch(arm)",
    ]
    assert lines[-1].startswith("Unreachable: left arm can't reach [2.000, 1.000, 0.950]")


def test_a_failed_block_shows_where_each_branch_failed(cells: dict[str, list[Mapping[str, Any]]]) -> None:
    text = plain(next(outputs for source, outputs in cells.items() if source.startswith("with par")))
    assert text.count('File "In [3]", line 3, in fetch') == 2
    assert "/pycram/" not in text
    assert text.splitlines()[-1].startswith("BranchesFailed: par failed: Unreachable: left arm")


def test_records_and_explanations_name_the_cells(
    cells: dict[str, list[Mapping[str, Any]]], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cells
    with replay.open(folder / "run.mcap") as log:
        assert log.complete
        assert log[0].name == "table"
        assert list(log[0].arguments) == []  # the kernel's own are none of the plan
        motion = next(record for record in log.records(Task) if record.kind == "motion")
        assert (motion.source_file, motion.source_line) == ("In [3]", 3)
        assert [(caller.file, caller.line) for caller in motion.callers] == [("In [4]", 1)]
        assert log.tree().roots[0].source == "In [3], line 3"
        text = log.assets[next(name for name in log.assets if name.endswith("/In [3]"))].decode()
        assert text.startswith("def fetch(arm):\n")
        failed = next(record for record in log.records(Task) if record.failure.frames)
        assert 'File "In [3]", line 3, in fetch' in next(
            record.failure.traceback for record in log.records(Task) if record.kind == "branch" and record.failure.type
        )
        top, inner = failed.failure.frames
        assert (top.file, top.line, inner.file, inner.line) == ("In [4]", 1, "In [3]", 3)
        assert [each.name for each in top.variables] == ["world", "milk"]
        assert [each.name for each in inner.variables] == ["arm", "reach"]
    assert main(["why", str(folder / "run.mcap")]) == 0
    shown = capsys.readouterr().out
    assert "In [3], line 3 in fetch\n      ProcessModule.perform(" in shown
    assert 'In [5], line 3 in <module>\n      p(fetch, "right")' in shown


def test_values_are_displayed_as_html_with_recorded_text_escaped(cells: dict[str, list[Mapping[str, Any]]]) -> None:
    shown = {
        source: output["data"]["text/html"]
        for source, outputs in cells.items()
        for output in outputs
        if "text/html" in output.get("data", {})
    }
    parts = {
        "world": "[2, 1, 0.95]",
        "log.why()": "In [3], line 3 in fetch",
        'log.state_at("last")': '<img src="data:image/png;base64,',
        "log.tree()": "<svg",
        'log.blame("<i>milk</i>", 5)': "In [2], line 3",
        "log.ask(5, \"stable('<i>milk</i>')\")": ": yes",
        'runs = replay.open_runs("."); runs': "succeeded",
        'runs.sql("SELECT name, source FROM tasks ORDER BY step")': "pick-up",
        'world.exit(); recorder.stop(); log = replay.open("run.mcap"); log': "run.mcap",
    }
    for source, part in parts.items():
        assert part in shown[source], source
    outcome = next(html for source, html in shown.items() if "Outcome" in source)
    assert "&lt;i&gt;fetch failed: ValueError: no &lt;i&gt;" in outcome
    assert "&lt;i&gt;milk&lt;/i&gt;" in shown["log.why()"] + shown['log.state_at("last")'] + shown["log.tree()"]
    assert not [source for source, html in shown.items() if "<i>" in html]


def test_values_are_written_in_one_line(cells: dict[str, list[Mapping[str, Any]]]) -> None:
    texts = [plain(outputs) for source, outputs in cells.items() if not source.startswith(("fetch(", "with par"))]
    assert len([text for text in texts if text]) == 13
    assert not [text for text in texts if "\n" in text or len(text) > 150]
    assert texts[-1] == "<Body <i>milk</i> (milk) at [2, 1, 0.95]>"


def test_the_guide_shows_what_its_cells_show(tmp_path: Path) -> None:
    blocks = re.findall(r"```(python|text)\n(.*?)```", GUIDE, re.DOTALL)
    sources = [text for kind, text in blocks if kind == "python"]
    outputs = [plain(each) for each in run_cells(sources, tmp_path)]
    shown = "\n".join(outputs)
    for kind, text in blocks:
        assert kind == "python" or text.strip() in shown, shown
