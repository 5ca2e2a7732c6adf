"""Build the site, a folder for each version: ``python -m docs.make_site FOLDER``.

Folders of other versions stay. The start page leads to the newest version, and ``versions.json`` lists all of them for
the menu of the pages.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

_REPO = Path(__file__).parent.parent


def main() -> None:
    """Build this version's pages. A dead link or a page that no menu names fails the build."""
    site, this = Path(sys.argv[1]).absolute(), version("pycram")
    # with --quiet, mkdocs doesn't count warnings, so --strict has no effect
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site / this)]
    subprocess.run(command, cwd=_REPO, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, check=True)
    found = [page.parent.name for page in site.glob("*/index.html")]
    versions = sorted(found, key=lambda name: [int(part) for part in name.split(".")], reverse=True)
    listed = [{"version": name, "title": name, "aliases": []} for name in versions]
    (site / "versions.json").write_text(json.dumps(listed), encoding="utf-8")
    (site / "index.html").write_text(
        f'<!doctype html><meta http-equiv="refresh" content="0; url={versions[0]}/index.html"><title>PyCRAM</title>',
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
