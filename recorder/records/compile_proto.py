"""Compiles the record definitions: ``python -m recorder.records.compile_proto [OUTPUT_DIR]``.

Needs the development tools. A test runs this into a temporary folder and compares, so that the checked-in modules
can't drift from ``log.proto``.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
DEFINITION = Path("recorder/records/log.proto")


def compile_proto(output: Path) -> None:
    """Writes ``recorder/records/log_pb2.py`` and ``log_pb2.pyi`` below an existing folder.

    Raises:
        RuntimeError: the compiler refused the definition.
    """
    from grpc_tools import protoc  # noqa: PLC0415  development tool

    # The path is part of the descriptor's name, which has to be unique in a process: hence from the root.
    arguments = [f"--proto_path={ROOT}", f"--python_out={output}", f"--pyi_out={output}"]
    code = protoc.main(["protoc", *arguments, str(ROOT / DEFINITION)])
    if code:
        raise RuntimeError(f"protoc ended with {code}")


if __name__ == "__main__":
    compile_proto(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
