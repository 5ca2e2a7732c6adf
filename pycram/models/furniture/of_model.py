"""The furniture that a loaded model is: found when it is first asked for, and kept with the model."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final

from pycram.models.corrections import SUFFIX, correct, read
from pycram.models.files import stored_tree
from pycram.models.furniture.finding import find

if TYPE_CHECKING:
    from pathlib import Path

    from pycram.models.load import Model
    from pycram.models.surfaces import Furniture

_CACHED_MODELS: Final = 128


def furniture_of(model: Model) -> Furniture:
    """Return the surfaces and containers of a model, with the corrections that lie beside it.

    Raises:
        AssetError: These correct what isn't there.
    """
    beside = next((file for file in model.files if file.name.endswith(SUFFIX)), None)
    return _furniture(model.path, beside.content if beside else b"", beside.name if beside else "")


@lru_cache(maxsize=_CACHED_MODELS)
def _furniture(path: Path, corrections: bytes, source: str) -> Furniture:
    urdf = stored_tree(path)
    found = find(path, urdf)
    return correct(found, read(corrections.decode(), source), urdf) if corrections else found
