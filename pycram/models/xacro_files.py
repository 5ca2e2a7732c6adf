"""Xacro: macros of URDF, which the package xacro (extra ``xacro``) expands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from threading import Lock
from typing import Final

from pycram.foundation.failures import AssetError
from pycram.models.files import find_package
from recorder.packages import hint

_LOCK: Final = Lock()  # xacro keeps the state of an expansion in its modules
SUFFIX: Final = ".xacro"  # suffix of files with macros


def expanded(source: Path, content: bytes, packages: Sequence[Path] = ()) -> bytes:
    """Return the text of a URDF, with its macros expanded.

    Raises:
        AssetError: The package xacro isn't installed, or can't expand the file.
    """
    if source.suffix.lower() != SUFFIX and b"<xacro:" not in content:
        return content
    target = source.name.removesuffix(SUFFIX).removesuffix(".urdf") + ".urdf"
    command = f"xacro {source.name} > {target if target != source.name else f'expanded_{target}'}"
    try:
        import xacro  # noqa: PLC0415  only few models need xacro
        from xacro import substitution_args  # noqa: PLC0415
    except ModuleNotFoundError as error:
        cause = f"the file is xacro; make a URDF first: {command}, or install xacro, {hint('xacro')}"
        raise AssetError(source, cause) from error

    def find(package: str) -> str:
        return str(find_package(source, package, packages))

    with _LOCK:
        try:
            substitution_args._eval_find = substitution_args._eval_dict["find"] = find  # noqa: SLF001  no public way
            text: bytes = xacro.process_file(str(source)).toxml(encoding="utf-8")
        except AssetError:
            raise
        except Exception as error:  # macros can run Python expressions
            cause = f"xacro can't expand the file ({error}); give its arguments to the command: {command}"
            raise AssetError(source, cause) from error
    return text
