"""Pages of the documentation as a reader follows them: blocks in their order, in one folder, with the shown outputs."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from docs.cells import Cell, notebook

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

REPO = Path(__file__).parent.parent
#: How long a thing takes, and the size of a file, aren't the page's.
VARIES = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?= ?(?:ms|s|kB|MB|a second)\b)")
#: Nor is the folder in which a reader works, or how often a long command tells its progress.
FOLDER = re.compile(r"(?<![\w.])/(?:[^\s/\"']+/)+")
PROGRESS = re.compile(r"pycram: \d+ of \d+ (?:runs|orders)\b.*|\d+/\d+ ━.*")
NUMBER = re.compile(r"-?(?<!\d)\d+\.\d+(?:e[-+]?\d+)?")
ESCAPE = re.compile(r"\x1b\[[\d;?]*[a-zA-Z]")
#: What a terminal shows for a moment only.
OVERWRITTEN = re.compile(r"[^\n]*\r")
#: Runs cells of Python in one process; each answer is what the cell printed, or how it failed.
WORKER = """
import contextlib, io, json, linecache, sys
names = {"__name__": "__main__", "__file__": "page.py"}
answers, before = sys.stdout, ""
for line in sys.stdin:
    code = json.loads(line)
    with open("page.py", "a") as page:
        page.write(code)
    linecache.clearcache()
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        try:
            exec(compile("\\n" * before.count("\\n") + code, "page.py", "exec"), names)
        except Exception as error:
            print(f"{type(error).__name__}: {error}")
    before += code
    print(json.dumps(printed.getvalue()), file=answers, flush=True)
"""


def environment() -> dict[str, str]:
    """The environment of a reader whose shell finds the commands."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    given = {"PATH": path, "PYTHONPATH": str(REPO), "PYTHONUNBUFFERED": "1", "NO_COLOR": "1", "PAGER": "cat"}
    return {name: value for name, value in os.environ.items() if name != "PYTEST_ADDOPTS"} | given


def outputs(page: Iterable[Cell], folder: Path) -> Iterator[str]:
    """The output of each cell, in a folder that has the demos."""
    if not (folder / "demos").exists():
        (folder / "demos").symlink_to(REPO / "demos")
    with subprocess.Popen(
        [sys.executable, "-c", WORKER],
        cwd=folder,
        env=environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as worker:
        assert worker.stdin is not None
        assert worker.stdout is not None
        for cell in page:
            printed = ""
            if cell.kind == "file":
                (folder / cell.name).parent.mkdir(parents=True, exist_ok=True)
                (folder / cell.name).write_text(cell.source, encoding="utf-8")
            elif cell.kind == "console":
                ended = subprocess.run(
                    ["sh", "-c", f"exec 2>&1\n{cell.source}"],
                    cwd=folder,
                    env=environment(),
                    stdin=subprocess.DEVNULL,
                    capture_output=True,
                    text=True,
                    check=False,
                )
                assert ended.returncode in (0, 1), ended.stdout  # 1: what was looked for was found
                printed = ended.stdout
            elif cell.kind == "python":
                worker.stdin.write(json.dumps(cell.source) + "\n")
                worker.stdin.flush()
                printed = json.loads(worker.stdout.readline())
            yield printed
        worker.stdin.close()


def notebook_outputs(page: str, folder: Path) -> list[str]:
    """The output of each cell of a page's notebook, run in a real kernel."""
    import nbformat  # noqa: PLC0415  tests of notebooks alone need it
    from nbclient import NotebookClient  # noqa: PLC0415  as above

    made = nbformat.from_dict(notebook(page))
    nbformat.validate(made)
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(made, allow_errors=True, timeout=300, resources=resources).execute(env=environment())
    return [_text(cell) for cell in made.cells]


def _text(cell: Any) -> str:
    if cell.cell_type != "code" or cell.source.startswith("%%writefile"):
        return ""
    texts = []
    for output in cell.outputs:
        if output["output_type"] == "error":
            texts.append(f"{output['ename']}: {output['evalue']}\n")
        else:
            texts.append(output["text"] if output["output_type"] == "stream" else output["data"]["text/plain"] + "\n")
    return "".join(texts)


def assert_shown(page: Iterable[Cell], printed: Iterable[str]) -> None:
    """Each cell prints what the page shows, apart from times and sizes; decimals to 2 %."""
    for cell, output in zip(page, printed, strict=True):
        if cell.kind not in ("python", "console"):
            continue
        text = OVERWRITTEN.sub("", ESCAPE.sub("", output.replace("\r\n", "\n")))
        assert _matches(_lines(cell.shown), _lines(text)), (
            f"--- the page shows, for\n{cell.source}---\n{cell.shown}--- a reader gets\n{text}"
        )


def _lines(text: str) -> list[str]:
    lines = (FOLDER.sub("", VARIES.sub("#", line.rstrip())) for line in text.splitlines())
    return [line for line in lines if not PROGRESS.fullmatch(line)]


def _matches(shown: list[str], printed: list[str]) -> bool:
    if "..." not in shown:
        return len(shown) == len(printed) and all(map(_alike, shown, printed))
    cut = shown.index("...")
    if len(printed) < cut or not all(map(_alike, shown[:cut], printed)):
        return False
    rest = shown[cut + 1 :]
    return any(_matches(rest, printed[begin:]) for begin in range(cut, len(printed) + 1))


def _alike(shown: str, printed: str) -> bool:
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(abs(float(a) - float(b)) <= 0.011 + 0.02 * abs(float(a)) for a, b in pairs)
