"""What furniture is found to be, as TOML: with comments to read, and tables to correct."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pycram.describing.guess import guess
from pycram.describing.text import quoted
from pycram.models.corrections import SUFFIX
from pycram.models.files import parse_toml
from pycram.models.furniture.finding import find
from pycram.models.furniture.of_model import furniture_of
from pycram.models.surfaces import Container, Surface, closed_position
from recorder import geometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sized

    from pycram.models.load import Model
    from recorder.urdf import Urdf

_IN_A_ROW: Final = 2  # movable joints of furniture: a drawer behind a door


def is_furniture(model: Model) -> bool:
    """Whether a model is furniture: something can stand on or in it, and it has neither arms, legs nor wheels."""
    found, tree = guess(model), model.urdf
    in_a_row = max(sum(joint.movable for joint in tree.chain(tree.root, link)) for link in tree.links)
    has_arms = bool(found.arms) or in_a_row > _IN_A_ROW
    return not has_arms and not found.drives and bool(furniture_of(model).surfaces)


def describe(model: Model, urdf: str | Path) -> str:
    """Return the TOML of furniture: what is found, with the corrections that it has.

    Args:
        model: the furniture.
        urdf: its file.

    Raises:
        AssetError: its corrections don't fit.
    """
    tree = model.urdf
    found, now = find(model.path, tree), furniture_of(model)
    beside = next((file for file in model.files if file.name.endswith(SUFFIX)), None)
    said: Any = parse_toml(beside.content.decode(), beside.name) if beside else {}
    surfaces = {name: _of_surface(surface, tree) for name, surface in now.surfaces.items()}
    containers = {name: _of_container(container, tree) for name, container in now.containers.items()}
    opening = {container.joint for container in now.containers.values()}
    others = [f"{joint} ({tree.joints[joint].type})" for joint in tree.movable if joint not in opening]
    file = f"{Path(urdf).stem}{SUFFIX}"
    lines = [
        f"# {tree.name}: {_count(surfaces, 'surface')}, {_count(containers, 'container')}; written by pycram describe.",
        f"# To name or correct them, save this beside the URDF as {file}. Metres, radians.",
        *_tables("surfaces", [*found.surfaces], said.get("surfaces", {}), surfaces),
        *_tables("containers", [*found.containers], said.get("containers", {}), containers),
    ]
    if others:
        lines += ["", "# Joints that open nothing:", *(f"#   {joint}" for joint in others)]
    return "\n".join(lines) + "\n"


def _count(things: Sized, name: str) -> str:
    return f"{len(things) or 'no'} {name}{'' if len(things) == 1 else 's'}"


def _tables(kind: str, found: list[str], said: Mapping[str, Any], now: Mapping[str, str]) -> Iterator[str]:
    """Yield the tables of all that was found or added, each with what is known of it and what is said of it."""
    for key in dict.fromkeys([*found, *said]):
        entries = said.get(key, {})
        about = now.get(entries.get("name", key), "removed")
        yield from ("", f"[{kind}.{quoted(key)}]  # {about}")
        yield from (f"{entry} = {_value(value)}" for entry, value in entries.items())


def _of_surface(surface: Surface, tree: Urdf) -> str:
    closed = {name: closed_position(tree.joints[name]) for name in tree.movable}
    height = geometry.transform(tree.forward_kinematics(closed, surface.link), surface.position)[2]
    x, y = surface.size
    above = "open above" if surface.clearance == math.inf else f"{surface.clearance:.2f} free above"
    inside = f", in {quoted(surface.container)}" if surface.container else ""
    return f"{x:.2f} x {y:.2f} at height {height:.3f}, {above}, on {surface.link}{inside}"


def _of_container(container: Container, tree: Urdf) -> str:
    joint = f"{tree.joints[container.joint].type} {container.joint} {container.closed:g} to {container.open:.4g}"
    return f"{container.kind}, {joint}, {f'handle {container.handle}' if container.handle else 'no handle'}"


def _value(value: object) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)
