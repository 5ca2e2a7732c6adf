"""Hooks of the site: pages of a folder in the navigation, and pages that other files hold."""

from __future__ import annotations

import posixpath
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mkdocs.structure.files import File, Files

_REPO = Path(__file__).parent.parent
sys.path.insert(0, str(_REPO))  # mkdocs loads this file by its path
from docs.generated import order, pages  # noqa: E402

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

#: Pages of the repository's first folder that the site shows, too.
_ROOT_PAGES = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
#: Code in a cell of a table, without tags in it.
_CODE = re.compile(r"(?<=<code>)[^<]+(?=</code>)")
_LONG = 12  # number of characters of a name that may break


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages, and replace folders in the navigation by their pages."""
    for name in _ROOT_PAGES:
        text = (_REPO / name).read_text(encoding="utf-8")
        files.append(File.generated(config, name.lower(), content=_linked(text, ".")))
    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    shown = sorted((file.src_uri for file in files.documentation_pages()), key=order)
    config.nav = _expanded(config.nav, shown)
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Let links to pages of the repository's first folder lead to those of the site."""
    folder = posixpath.dirname(page.file.src_uri) or "."
    if folder == "tutorial":
        name = posixpath.basename(page.file.src_uri).replace(".md", ".ipynb")
        title, _, rest = markdown.partition("\n")
        markdown = f"{title}\n\n[This chapter as a notebook]({name})\n{rest}"
    return _linked(markdown, folder)


def on_page_content(html: str, **_: object) -> str:
    """Leave out the roles of reStructuredText, which docstrings have; let long names break in tables of a phone."""
    html = re.sub(r":(?:class|func|mod|meth|attr|exc|data):(?=<code>|`)", "", html)
    return re.sub(r"<td[ >].*?</td>", lambda cell: _CODE.sub(_breakable, cell[0]), html, flags=re.DOTALL)


def _breakable(code: re.Match[str]) -> str:
    return re.sub(r"(?<=[_(/])(?=\w)", "<wbr>", code[0]) if len(code[0]) > _LONG else code[0]


def _linked(text: str, folder: str) -> str:
    """Return a page's text with links as they are in the site.

    Args:
        text: Markdown.
        folder: the page's folder in the site.
    """
    for name in _ROOT_PAGES:
        text = re.sub(rf"\]\((\.\./)*{re.escape(name)}", f"]({posixpath.relpath(name.lower(), folder)}", text)
    return re.sub(r"\]\(docs/", "](", text)


def _expanded(entry: Any, pages: list[str]) -> Any:
    """Return an entry of the navigation with pages in place of folders."""
    if isinstance(entry, dict):
        return {
            name: _expanded([value] if isinstance(value, str) and value.endswith("/") else value, pages)
            for name, value in entry.items()
        }
    if isinstance(entry, list):
        return [
            each
            for part in entry
            for each in (
                [page for page in pages if page.startswith(part)]
                if isinstance(part, str) and part.endswith("/")
                else [_expanded(part, pages)]
            )
        ]
    return entry
