"""Every page whose blocks run: a reader who follows it gets what it shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import pytest

from docs.cells import cells
from tests.pages import REPO, assert_shown, notebook_outputs, outputs

if TYPE_CHECKING:
    from pathlib import Path

DOCS: Final = REPO / "docs"
#: Pages that are run from their first block to their last: of these folders, and these guides. Other guides have tests
#: of their own, as their recordings or files are made elsewhere.
FOLDERS: Final = ("start", "howto", "concepts")
GUIDES: Final = ("fluents", "furniture", "motions", "process_modules", "projection", "sweep")
PAGES: Final = sorted(
    str(page.relative_to(DOCS))
    for page in (
        *DOCS.glob("*.md"),
        *(DOCS / "guides" / f"{name}.md" for name in GUIDES),
        *(page for folder in FOLDERS for page in (DOCS / folder).rglob("*.md")),
    )
    if any(cell.kind in ("python", "console") for cell in cells(page.read_text(encoding="utf-8")))
)
CHAPTERS: Final = sorted(page.name for page in (DOCS / "tutorial").glob("[1-9]*.md"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(page, marks=pytest.mark.costly) if page.startswith("howto/") else page for page in PAGES]
)
def test_a_page_shows_what_a_reader_gets(name: str, tmp_path: Path) -> None:
    page = cells((DOCS / name).read_text(encoding="utf-8"))
    assert_shown(page, outputs(page, tmp_path))


@pytest.mark.costly
@pytest.mark.needs("Jupyter")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", CHAPTERS)
def test_the_notebook_of_a_chapter_shows_what_the_chapter_shows(name: str, tmp_path: Path) -> None:
    text = (DOCS / "tutorial" / name).read_text(encoding="utf-8")
    assert_shown(cells(text), notebook_outputs(text, tmp_path))


@pytest.mark.parametrize(
    ("shown", "printed", "alike"),
    [
        ("at 0.25 m after 3.1 s", "at 0.252 m after 12.0 s", True),
        ("at 0.25 m", "at 0.35 m", False),
        ("step 12", "step 13", False),
        ("a\n...\nd", "a\nb\nc\nd", True),
        ("a\n...\nd", "a\nb\nc", False),
        ("a", "a\nb", False),
        ("", "a", False),
    ],
)
def test_outputs_are_compared(shown: str, printed: str, alike: bool) -> None:
    (cell,) = cells(f"```console\n$ run\n{shown}\n```\n" if shown else "```console\n$ run\n```\n")
    if alike:
        assert_shown([cell], [printed])
    else:
        with pytest.raises(AssertionError, match="the page shows"):
            assert_shown([cell], [printed])


def test_a_block_of_text_that_nothing_prints_is_refused() -> None:
    with pytest.raises(ValueError, match="no block of Python prints this"):
        cells("```text\nhello\n```\n")
