"""Paths of robots' URDFs in other packages."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

from pycram.foundation.failures import AssetError
from recorder.packages import hint

_DISTRIBUTION = "example-robot-data"


def pr2_urdf() -> Path:
    """Return the path of the PR2's URDF, with its meshes beside it.

    Raises:
        AssetError: example-robot-data isn't installed.
    """
    try:
        files = metadata.files(_DISTRIBUTION) or []
    except metadata.PackageNotFoundError as error:
        cause = f"comes with the package {_DISTRIBUTION}, which isn't installed; {hint('executor')}"
        raise AssetError("pr2.urdf", cause) from error
    for file in files:
        if file.name == "pr2.urdf":
            return Path(str(file.locate())).resolve()
    raise AssetError("pr2.urdf", f"is not in the installed {_DISTRIBUTION}")
