"""The furniture that a loaded model is: found when it is first asked for, and kept with the model."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final

from pycram.models.files import parse_urdf
from pycram.models.furniture import finding

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.models.furniture.furniture import Furniture
    from pycram.models.load import Model

_CACHED_MODELS: Final = 128


def furniture_of(model: Model) -> Furniture:
    """Return the surfaces and containers of a model."""
    return _furniture(model.path)


@lru_cache(maxsize=_CACHED_MODELS)
def _furniture(path: Path) -> Furniture:
    return finding.find(path, parse_urdf(path.read_bytes(), path))
