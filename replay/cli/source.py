"""``source``: the plan's source at the time of the run."""

from __future__ import annotations

import argparse
from pathlib import Path

from replay.cli.console import print_json, print_result, print_text
from replay.errors import NoSuchName, ReplayError
from replay.history.source import name_of
from replay.recording import Recording

_SHORT = 8  # number of digits of a hash that are printed


def add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        help="print this file; if several files have this name, HASH/FILE (default: list all files)",
    )
    parser.add_argument("-o", dest="target", metavar="PATH", help="write the file to PATH, or all files to a folder")


def run(log: Recording, options: argparse.Namespace) -> None:
    keys = sorted((key for key in log.assets if key.endswith(".py")), key=lambda key: (name_of(key), key))
    chosen = keys if options.file is None else [_find(keys, options.file)]
    if options.target is not None:
        written = _write(log, chosen, Path(options.target), whole=options.file is None)
        print_result(lambda: {"files": written}, written, as_json=options.json)
    elif options.file is None:
        listed = [
            {"file": name_of(key), "sha256": key.partition("/")[0], "bytes": len(log.assets[key])} for key in keys
        ]
        lines = [f"{each['sha256']:.{_SHORT}}  {each['bytes']:8}  {each['file']}" for each in listed]
        print_result(lambda: listed, lines or ["no source is attached"], as_json=options.json)
    else:
        text = log.assets[chosen[0]].decode("utf-8", "replace")
        if options.json:
            print_json({"file": name_of(chosen[0]), "sha256": chosen[0].partition("/")[0], "text": text})
        else:
            print_text(text, end="")


def _find(keys: list[str], name: str) -> str:
    """Return the key of an attached file by name. ``HASH/FILE`` selects one of several files with the same name."""
    digits, _, file = name.rpartition("/")
    if digits.strip("0123456789abcdef"):  # the text before "/" may be a folder, and not a hash
        digits = ""
    fitting = [key for key in keys if name_of(key) == file and key.startswith(digits)]
    if not fitting:
        raise NoSuchName("attached source", name, map(name_of, keys))
    if len(fitting) > 1:
        choices = " or ".join(f"{key[:_SHORT]}/{file}" for key in fitting)
        raise ReplayError(f"{len(fitting)} files are called {file}: {choices}")
    return fitting[0]


def _write(log: Recording, keys: list[str], target: Path, *, whole: bool) -> list[str]:
    """Write attached files, and return their paths. Files with the same name get their hashes as prefixes."""
    # names in a recording of a stranger could control the terminal that lists the folder
    names = ["".join(each if each.isprintable() else "_" for each in name_of(key)) for key in keys]
    written = []
    for key, name in zip(keys, names, strict=True):
        shared = names.count(name) > 1
        file = target / (f"{key[:_SHORT]}_{name}" if shared else name) if whole or target.is_dir() else target
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            with file.open("xb") as output:  # no file of the user may be replaced
                output.write(log.assets[key])
        except OSError as error:
            raise ReplayError(f"{file}: {error.strerror or error}") from error
        written.append(str(file))
    return written
