"""Models have the colours and textures of their meshes, in pictures and in viewers."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from pycram.bullet_world import BulletWorld, Object
from pycram.models import load
from pycram.models.shapes import pieces_of, shapes_of
from pycram.models.texture import MissingTexture
from recorder.urdf import read_shapes

RED, BLUE, YELLOW = (0.8, 0.1, 0.1), (0.1, 0.2, 0.9), (0.9, 0.9, 0.1)

EFFECT = """<effect id="{0}-fx"><profile_COMMON>{2}<technique sid="common"><lambert><diffuse>{1}</diffuse></lambert>
</technique></profile_COMMON></effect>"""
SAMPLER = """<newparam sid="s"><surface type="2D"><init_from>picture</init_from></surface></newparam>
<newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>"""
TEXTURE = '<texture texture="t" texcoord="UV"/>'
#: A square of 1 m (or units) in the plane z = 0, in four triangles around its middle: two of each material.
DAE = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="u" meter="{unit}"/><up_axis>Y_UP</up_axis></asset>
<library_images><image id="picture"><init_from>{image}</init_from></image></library_images>
<library_effects>{effects}</library_effects>
<library_materials><material id="one"><instance_effect url="#one-fx"/></material>
<material id="two"><instance_effect url="#two-fx"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="15">0 0 0 1 0 0 1 1 0 0 1 0 0.5 0.5 0</float_array><technique_common>
<accessor source="#pa" count="5" stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<source id="u"><float_array id="ua" count="10">0 0 1 0 1 1 0 1 0.5 0.5</float_array><technique_common>
<accessor source="#ua" count="5" stride="2"><param name="S" type="float"/><param name="T" type="float"/></accessor>
</technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="2" material="one"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#u" offset="1" set="0"/><p>0 0 1 1 4 4 1 1 2 2 4 4</p></triangles>
<triangles count="2" material="two"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#u" offset="1" set="0"/><p>2 2 3 3 4 4 3 3 0 0 4 4</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="vs"><node id="n"><translate>0 0 2</translate><instance_geometry url="#g">
<bind_material><technique_common><instance_material symbol="one" target="#one"/><instance_material symbol="two" target="#two"/>
</technique_common></bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#vs"/></scene></COLLADA>"""


def plain(color: tuple[float, ...]) -> str:
    return f"<color>{' '.join(map(str, color))} 1</color>"


def dae(folder: Path, one: str, two: str, unit: float = 1.0) -> Path:
    effects = "".join(
        EFFECT.format(name, diffuse, SAMPLER if diffuse == TEXTURE else "")
        for name, diffuse in (("one", one), ("two", two))
    )
    file = folder / "square.dae"
    file.write_text(DAE.format(unit=unit, image="picture.png", effects=effects))
    return file


def seen(folder: Path, mesh: str, material: str = "") -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, 3) and colours (n, 3) of the triangles of a URDF's link that shows a mesh."""
    file = folder / "thing.urdf"
    visual = f'<visual><geometry><mesh filename="{mesh}"/></geometry>{material}</visual>'
    file.write_text(f'<robot name="thing"><link name="a">{visual}</link></robot>')
    model = load.load(file)
    shapes = shapes_of(model.path)
    drawn = read_shapes(model.files[0].content, "visual")["a"]  # what viewers show
    assert {shape.color[:3] for shape in drawn} == {tuple(color) for color in shapes.colors(0).tolist()}
    return shapes.triangles(0).mean(axis=1), shapes.colors(0)


def color_at(found: tuple[np.ndarray, np.ndarray], x: float, y: float) -> np.ndarray:
    middles, colors = found
    return colors[np.argmin(np.hypot(middles[:, 0] - x, middles[:, 1] - y))]


OVERRIDDEN = f'<material name="m">{plain(YELLOW).replace("<color>", "<color rgba=" + chr(34)).replace("</color>", chr(34) + "/>")}</material>'


@pytest.mark.parametrize("material", ["", OVERRIDDEN])
def test_collada_materials_are_shown_and_override_the_urdf_s(tmp_path: Path, material: str) -> None:
    dae(tmp_path, plain(RED), plain(BLUE))
    found = seen(tmp_path, "square.dae", material)
    assert color_at(found, 0.5, 0.1) == pytest.approx(RED, abs=1e-5)
    assert color_at(found, 0.5, 0.9) == pytest.approx(BLUE, abs=1e-5)
    assert found[0][:, 2] == pytest.approx(2)  # of its node; z is up, whatever the file says, as in RViz


def test_a_mesh_without_colours_has_the_urdf_s_colour(tmp_path: Path) -> None:
    trimesh.creation.box().export(tmp_path / "box.stl")
    assert seen(tmp_path, "box.stl", OVERRIDDEN)[1] == pytest.approx(np.tile(YELLOW, (12, 1)))


def test_textures_are_shown(tmp_path: Path) -> None:
    picture = np.zeros((64, 64, 3), dtype=np.uint8)
    picture[:32], picture[32:] = np.array(RED) * 255, np.array(BLUE) * 255  # red above
    picture[:, 48:] = np.array(YELLOW) * 255
    Image.fromarray(picture).save(tmp_path / "picture.png")
    dae(tmp_path, TEXTURE, TEXTURE)
    found = seen(tmp_path, "square.dae")
    for x, y, color in ((0.3, 0.8, RED), (0.3, 0.2, BLUE), (0.9, 0.5, YELLOW), (0.9, 0.9, YELLOW)):
        assert color_at(found, x, y) == pytest.approx(color, abs=0.05)
    assert len({tuple(color) for color in found[1].tolist()}) <= 8  # each is a shape in viewers


def test_a_missing_texture_is_grey_and_warned_of_once(tmp_path: Path) -> None:
    dae(tmp_path, TEXTURE, plain(BLUE))
    with pytest.warns(MissingTexture, match=r"square\.dae: the texture picture\.png doesn't exist") as warned:
        found = seen(tmp_path, "square.dae")
    assert [Path(each.filename).name for each in warned] == [Path(__file__).name]
    seen(tmp_path, "square.dae")  # again: a second warning would be an error here
    assert color_at(found, 0.5, 0.1) == pytest.approx([0.8, 0.8, 0.8])
    assert color_at(found, 0.5, 0.9) == pytest.approx(BLUE, abs=1e-5)


def test_a_missing_texture_of_a_urdf_is_warned_of(tmp_path: Path) -> None:
    (tmp_path / "thing.urdf").write_text(
        '<robot name="thing"><link name="a"><visual><geometry><box size="1 1 1"/></geometry><material name="m">'
        '<color rgba="0 0 1 1"/><texture filename="package://things/label.png"/></material></visual>'
        '<visual><geometry><box size="1 1 1"/></geometry><material name="n"><texture filename=""/></material></visual>'
        "</link></robot>"
    )
    with pytest.warns(MissingTexture, match=r"thing\.urdf: the texture package://things/label\.png doesn't exist"):
        model = load.load(tmp_path / "thing.urdf")
    assert {0.0, 1.0} <= set(shapes_of(model.path).colors(0)[0].tolist())


def halves(folder: Path, upper: tuple[float, ...] = RED) -> str:
    """A picture with a blue lower half, and a URDF's material with it."""
    picture = np.zeros((64, 64, 3), dtype=np.uint8)
    picture[:32], picture[32:] = np.array(upper) * 255, np.array(BLUE) * 255
    Image.fromarray(picture).save(folder / "label.png")
    return '<material name="label"><color rgba="0 1 0 1"/><texture filename="label.png"/></material>'


@pytest.mark.parametrize(
    "shape", ['<box size="0.2 0.4 0.6"/>', '<cylinder radius="0.2" length="0.6"/>', '<sphere radius="0.3"/>']
)
def test_a_urdf_s_texture_covers_shapes(tmp_path: Path, shape: str) -> None:
    material = halves(tmp_path)
    file = tmp_path / "thing.urdf"
    visual = f"<visual><geometry>{shape}</geometry>{{}}</visual>"
    plainly = f'<robot name="thing"><link name="a">{visual.format("")}</link></robot>'
    inline = f'<robot name="thing"><link name="a">{visual.format(material)}</link></robot>'
    by_name = visual.format('<material name="label"/>')
    named = f'<robot name="thing">{material}<link name="a">{by_name}</link></robot>'
    file.write_text(plainly)
    bare = shapes_of(load.load(file).path)
    for text in (inline, named):
        file.write_text(text)
        model = load.load(file)
        shapes = shapes_of(model.path)
        assert shapes.low == pytest.approx(bare.low, abs=2e-3)
        assert shapes.high == pytest.approx(bare.high, abs=2e-3)
        drawn = read_shapes(model.files[0].content, "visual")["a"]  # what viewers show
        assert len({part.color[:3] for part in drawn}) == 2
        middles, colors = shapes.triangles(0).mean(axis=1), shapes.colors(0)
        outside = np.abs(middles[:, 2]) < 0.29  # not the ends
        assert np.abs(colors[outside & (middles[:, 2] > 0.02)] - RED).max() < 0.05
        assert np.abs(colors[outside & (middles[:, 2] < -0.02)] - BLUE).max() < 0.05
        edges = shapes.triangles(0)
        normals = np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])
        assert (np.einsum("ij,ij->i", normals, middles) > 0).all(), "they are seen from outside"


def test_a_urdf_s_texture_covers_meshes_without_material(tmp_path: Path) -> None:
    material = halves(tmp_path)
    (tmp_path / "square.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    found = seen(tmp_path, "square.obj", material)
    assert color_at(found, 0.5, 0.9) == pytest.approx(RED, abs=0.05)
    assert color_at(found, 0.5, 0.1) == pytest.approx(BLUE, abs=0.05)
    trimesh.creation.box().export(tmp_path / "box.stl")  # which says nothing of textures
    assert seen(tmp_path, "box.stl", material)[1] == pytest.approx(np.tile(np.add(RED, BLUE) / 2, (12, 1)), abs=0.01)
    dae(tmp_path, plain(RED), plain(YELLOW))
    assert color_at(seen(tmp_path, "square.dae", material), 0.5, 0.9) == pytest.approx(YELLOW, abs=1e-5)
    halves(tmp_path, YELLOW)
    assert color_at(seen(tmp_path, "square.obj", material), 0.5, 0.9) == pytest.approx(YELLOW, abs=0.05), "as it is now"
    (tmp_path / "label.png").unlink()
    with pytest.warns(MissingTexture, match=r"thing\.urdf: the texture label\.png"):
        found = seen(tmp_path, "square.obj", material)
    assert color_at(found, 0.5, 0.9) == pytest.approx((0.0, 1.0, 0.0))


def test_collada_units_are_scaled_to_metres(tmp_path: Path) -> None:
    dae(tmp_path, plain(RED), plain(BLUE), unit=0.01)
    middles, _ = seen(tmp_path, "square.dae")
    assert middles.max(axis=0) == pytest.approx([0.00833, 0.00833, 0.02], abs=1e-4)


MTL = "newmtl m1\nKd 0.8 0.1 0.1\nnewmtl m2\nKd 0.1 0.2 0.9\n"
OBJ = "{}v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl m1\nf 1 2 3\nusemtl m2\nf 1 3 4\n"


def test_obj_materials_are_shown(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "square.mtl").write_text(MTL)
    (tmp_path / "square.obj").write_text(OBJ.format("mtllib square.mtl\n"))
    found = seen(tmp_path, "square.obj")
    assert color_at(found, 0.9, 0.1) == pytest.approx(RED, abs=0.01)
    assert color_at(found, 0.1, 0.9) == pytest.approx(BLUE, abs=0.01)
    (tmp_path / "square.obj").write_text(OBJ.format("mtllib gone.mtl\n") + "# changed\n")
    with caplog.at_level(logging.DEBUG):
        seen(tmp_path, "square.obj")
    assert not caplog.records  # trimesh would log a traceback
    assert capfd.readouterr() == ("", "")


def test_a_mesh_of_lines_shows_nothing(tmp_path: Path) -> None:
    file = dae(tmp_path, plain(RED), plain(BLUE))
    text = file.read_text().replace("<triangles", "<lines").replace("</triangles", "</lines")
    file.write_text(text.replace("<p>0 0 1 1 4 4 1 1 2 2 4 4</p>", "<p>0 0 1 1</p>"))
    (tmp_path / "thing.urdf").write_text(
        '<robot name="t"><link name="a"><visual><geometry><mesh filename="square.dae"/></geometry></visual></link></robot>'
    )
    assert shapes_of(load.load(tmp_path / "thing.urdf").path).links == ()


@pytest.mark.slow
def test_large_meshes_collide_as_their_hull(tmp_path: Path, world: BulletWorld) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.2)
    dented = sphere.copy()
    dented.vertices[np.argsort(dented.vertices[:, 0])[:3000]] *= 0.5
    assert len(dented.faces) > 5000
    for kind in ("stl", "obj"):
        dented.export(tmp_path / f"ball.{kind}")
        shape = f'<collision><geometry><mesh filename="ball.{kind}"/></geometry></collision>'
        file = tmp_path / f"{kind}.urdf"
        file.write_text(f'<robot name="t"><link name="a">{shape}</link></robot>')
        ball = Object(kind, "environment", file)
        ((_, corners),) = pieces_of(ball.model.path)
        hull = dented.convex_hull
        assert trimesh.Trimesh(*_hull(corners)).volume == pytest.approx(hull.volume, rel=1e-4)
        assert len(ball.model.files[1].content) < 0.8 * dented.faces.shape[0] * 50
        ball.remove()


def _hull(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = trimesh.convex.convex_hull(corners)
    return found.vertices, found.faces
