"""Make pages from the templates in this folder: single HTML files with embedded pictures and escaped texts."""

from __future__ import annotations

import base64
import io
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from recorder.packages import needed
from replay.errors import ReplayError

if TYPE_CHECKING:
    from jinja2 import Environment
    from PIL import Image

_QUALITY = 78  # quality of JPEG pictures, 0 to 100


def page(template: str, **values: object) -> str:
    """Return a page made from a template."""
    return _templates().get_template(template).render(values)


@cache
def _templates() -> Environment:
    with needed("render"):
        from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415  an extra

    folder = FileSystemLoader(Path(__file__).parent / "templates")
    return Environment(loader=folder, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)


def embedded(picture: Image.Image) -> str:
    """Return a picture as a data URL (JPEG)."""
    file = io.BytesIO()
    picture.convert("RGB").save(file, "JPEG", quality=_QUALITY, optimize=True)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


def write(file: str, content: bytes) -> None:
    """Write a file; raise ReplayError if the page can't be written."""
    try:
        Path(file).write_bytes(content)
    except OSError as error:
        raise ReplayError(f"{file}: can't be written: {error}") from error
