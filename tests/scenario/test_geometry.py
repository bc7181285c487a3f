# SPDX-License-Identifier: GPL-3.0-or-later
import struct

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario.create import geometry, materials, mesh_files, osm
from gr_cast.scenario.create.geometry import Solid
from gr_cast.scenario.create.media import Medium
from hypothesis import given, settings
from hypothesis import strategies as st

SQUARE = np.array([[0, 0], [4, 0], [4, 3], [0, 3]], float)


def volume_m3(solid):
    """Divergence theorem over the faces of a closed surface."""
    a, b, c = (solid.vertices_m[solid.faces[:, corner]] for corner in range(3))
    return abs(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


@settings(max_examples=60, deadline=None)
@given(st.integers(3, 14), st.integers(0, 2**32 - 1), st.booleans())
def test_triangles_cover_a_polygon_exactly(corners, seed, with_hole):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners) * 0.2 + np.arange(corners) * 2 * np.pi / corners * 0.8)
    star = rng.uniform(5, 9, corners)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    along = np.roll(star, -1, axis=0) - star
    inward_m = (star[:, 0] * along[:, 1] - star[:, 1] * along[:, 0]) / np.linalg.norm(
        along, axis=1
    )  # of the middle, by each edge
    hole = [0.3 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])] if with_hole and inward_m.min() > 0.5 else []
    points, triangles = geometry.triangulate(star, hole)
    area = sum(abs(geometry.signed_area_m2(points[t])) for t in triangles)
    expected = abs(geometry.signed_area_m2(star)) - sum(abs(geometry.signed_area_m2(h)) for h in hole)
    assert area == pytest.approx(expected, rel=1e-9)


def test_a_prism_with_a_courtyard_is_closed_and_has_its_volume():
    hole = np.array([[1, 1], [3, 1], [3, 2], [1, 2]], float)
    solid = geometry.prism("house", SQUARE, [hole], 2.0, 7.0, "brick")
    assert geometry.is_closed(solid) and volume_m3(solid) == pytest.approx((12 - 2) * 5)
    assert geometry.inside(solid, [0.5, 0.5, 3.0])
    assert not geometry.inside(solid, [2.0, 1.5, 3.0])  # in the courtyard
    assert not geometry.inside(solid, [0.5, 0.5, 1.0]) and not geometry.inside(solid, [9, 9, 9])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_inside_and_outside_are_told_apart_however_the_faces_are_wound(seed):
    rng = np.random.default_rng(seed)
    hole = np.array([[1, 1], [3, 1], [3, 2], [1, 2]], float)
    house = geometry.prism("house", SQUARE, [hole], 2.0, 7.0, "")
    flipped = rng.random(len(house.faces)) < 0.5
    faces = np.where(flipped[:, None], house.faces[:, ::-1], house.faces)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turned = Solid(name="turned", vertices_m=house.vertices_m @ turn.T, faces=faces)
    for point in rng.uniform([-1, -1, 1], [5, 4, 8], (20, 3)):
        x, y, z = point
        truth = 0 < x < 4 and 0 < y < 3 and 2 < z < 7 and not (1 < x < 3 and 1 < y < 2)
        assert geometry.inside(turned, turn @ point)[0] == truth


def test_an_outline_that_crosses_itself_is_refused():
    with pytest.raises(CastError, match="crosses itself|zero area"):
        geometry.prism("bow", np.array([[0, 0], [2, 2], [2, 0], [0, 2.5]]), [], 0, 1, "")


def test_an_open_surface_is_told_from_a_closed_one():
    box = geometry.prism("box", SQUARE, [], 0, 1, "")
    assert geometry.is_closed(box)
    lid_off = geometry.open_edges_m(Solid(name="lid off", vertices_m=box.vertices_m, faces=box.faces[2:]))
    np.testing.assert_allclose(sorted(lid_off.tolist()), [[0, 1.5, 0], [2, 0, 0], [2, 3, 0], [4, 1.5, 0]])


@pytest.mark.parametrize(
    "vertices, faces, says",
    [
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "not finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1e7, 0]], [[0, 1, 2]], "beyond"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "not there"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "zero area"),
        ([[0, 0, 0]], [], "no faces"),
    ],
)
def test_geometry_that_no_ray_can_meet_is_refused_by_name(vertices, faces, says):
    with pytest.raises(CastError, match=f"object wall: .*{says}"):
        Solid(name="wall", vertices_m=vertices, faces=faces)


BOX_M3 = 4 * 3 * 1.0


def words(first, numbers):
    return " ".join([first, *(repr(number) for number in numbers.tolist())])


def obj_text(box):
    lines = ["o desk 1", "usemtl oak"] + [words("v", v) for v in box.vertices_m]
    return "\n".join(lines + ["f " + " ".join(f"{corner + 1}//1" for corner in face) for face in box.faces]) + "\n"


def ply_bytes(box, kind):
    head = f"ply\nformat {kind} 1.0\nelement vertex {len(box.vertices_m)}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(box.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    if kind == "ascii":
        rows = [words("", v) for v in box.vertices_m] + [words("3", f) for f in box.faces]
        return (head + "\n".join(rows) + "\n").encode()
    order = "<" if "little" in kind else ">"
    body = b"".join(struct.pack(order + "3f", *v) for v in box.vertices_m)
    return head.encode() + body + b"".join(struct.pack(order + "B3i", 3, *map(int, f)) for f in box.faces)


def stl_bytes(box, text):
    corners = box.vertices_m[box.faces]
    if text:
        facets = ["facet normal 0 0 0\nouter loop\n" + "".join(words("vertex", v) + "\n" for v in t) for t in corners]
        return ("solid desk\n" + "".join(f + "endloop\nendfacet\n" for f in facets) + "endsolid desk\n").encode()
    return bytes(80) + struct.pack("<I", len(corners)) + b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in corners)


def dae_text(box, y_up):
    v = box.vertices_m[:, [0, 2, 1]] * [1, 1, -1] if y_up else box.vertices_m  # the same box, seen with y up
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.01"/><up_axis>{"Y_UP" if y_up else "Z_UP"}</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array>{" ".join(repr(float(x)) for x in 100 * v.ravel())}</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="oak"><input semantic="VERTEX" source="#v" offset="0"/>
<p>{" ".join(map(str, box.faces.ravel()))}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene><node name="desk 1"><translate>0 0 0</translate><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes></COLLADA>"""


@pytest.mark.parametrize(
    "suffix, content",
    [
        (".obj", lambda box: obj_text(box).encode()),
        (".ply", lambda box: ply_bytes(box, "ascii")),
        (".ply", lambda box: ply_bytes(box, "binary_little_endian")),
        (".ply", lambda box: ply_bytes(box, "binary_big_endian")),
        (".stl", lambda box: stl_bytes(box, text=True)),
        (".stl", lambda box: stl_bytes(box, text=False)),
        (".dae", lambda box: dae_text(box, y_up=False).encode()),
        (".dae", lambda box: dae_text(box, y_up=True).encode()),
    ],
)
def test_the_same_box_comes_out_of_every_mesh_format(tmp_path, suffix, content):
    path = tmp_path / f"desk{suffix}"
    path.write_bytes(content(geometry.prism("box", SQUARE, [], 0.5, 1.5, "")))
    (solid,) = mesh_files.read(path)
    assert geometry.is_closed(solid) and volume_m3(solid) == pytest.approx(BOX_M3, rel=1e-6)
    np.testing.assert_allclose(solid.vertices_m.min(axis=0), [0, 0, 0.5], atol=1e-6)
    np.testing.assert_allclose(solid.vertices_m.max(axis=0), [4, 3, 1.5], atol=1e-6)
    if suffix in (".obj", ".dae"):
        assert (solid.name, solid.surface) == ("desk 1", "oak")
    for cut in (20, len(path.read_bytes()) // 2):
        path.write_bytes(path.read_bytes()[:cut])
        with pytest.raises(CastError, match=path.name):
            mesh_files.read(path)


@settings(max_examples=800, deadline=None)
@given(st.sampled_from([".obj", ".ply", ".stl", ".dae"]), st.data())
def test_any_bytes_are_a_mesh_or_refused_but_never_a_crash(tmp_path_factory, suffix, data):
    box = geometry.prism("box", SQUARE, [], 0.5, 1.5, "")
    good = {".obj": obj_text(box).encode(), ".ply": ply_bytes(box, "binary_little_endian"), ".stl": stl_bytes(box, text=True),
            ".dae": dae_text(box, y_up=True).encode()}[suffix]  # fmt: skip
    content = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / f"fuzz{suffix}"
    path.write_bytes(content)
    try:
        mesh_files.read(path)
    except CastError as error:
        assert "fuzz" in str(error)


PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{more}element face 1\n" \
    "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 {last}\n"  # fmt: skip
NODE = "<library_nodes>" + "".join(
    f'<node id="{n}"><instance_node url="#{n + 1}"/><instance_node url="#{n + 1}"/></node>' for n in range(40)
) + '<node id="40"/></library_nodes>'  # fmt: skip


@pytest.mark.parametrize(
    "name, content, says",
    [
        ("a.ply", PLY.format(more="", last="-1"), "a vertex that is not there"),
        ("a.ply", PLY.format(more="", last="inf"), "damaged"),
        ("a.ply", PLY.format(more="element junk 1000000000000\n", last="2"), "truncated"),
        ("a.dae", f'<COLLADA>{NODE}<visual_scene><node><instance_node url="#0"/></node></visual_scene></COLLADA>', "more than"),
        ("a.dae", '<COLLADA><asset><unit meter="-1"/></asset></COLLADA>', "needs more than 0"),
    ],
)
def test_numbers_that_would_mislead_or_never_end_are_refused(tmp_path, name, content, says):
    (tmp_path / name).write_text(content)
    with pytest.raises(CastError, match=says):
        mesh_files.read(tmp_path / name)
    (tmp_path / "good.ply").write_text(PLY.format(more="", last="2").replace("\n", "\r\n"), newline="")
    assert len(mesh_files.read(tmp_path / "good.ply")) == 1  # lines may end as Windows ends them


def test_the_arena_mesh_closes_its_furniture_and_keeps_every_name():
    solids = mesh_files.read(sc.examples_folder() / "arena.obj")
    names = {solid.name for solid in solids}
    assert len(names) == len(solids) == 26 and {"floor", "column_1", "desk_10"} <= names
    boxes = [solid for solid in solids if solid.name.split("_")[0] in ("column", "cabinet", "rack")]
    assert all(geometry.is_closed(box) for box in boxes)
    low, high = geometry.bounds_m(solids)
    assert np.prod((high - low)[:2]) == pytest.approx(228.0)


def test_the_street_extract_gives_every_building_its_height():
    solids, count = osm.read(sc.examples_folder() / "street.osm")
    top = {solid.name: solid.vertices_m[:, 2].max() for solid in solids}
    assert top["building way 101"] == 12 and top["building way 102"] == 12  # given; four levels
    assert top["building way 103"] == pytest.approx(60 * 0.3048) and top["building way 104"] == 9  # feet; assumed
    assert count["courtyards"] == 1 and count["buildings shown by their parts"] == 1
    assert all(geometry.is_closed(solid) for solid in solids if solid.name != "ground")
    court = next(solid for solid in solids if solid.name == "building relation 900")
    assert volume_m3(court) == pytest.approx((42 * 30 - 22 * 14) * 18, rel=1e-3)


def extract(path, *tags):
    """An extract with one building, way 7, of these tags."""
    corners = [(0, 0), (0, 1e-4), (1e-4, 1e-4), (1e-4, 0)]
    nodes = "".join(f'<node id="{i}" lat="{48 + a}" lon="{11 + b}"/>' for i, (a, b) in enumerate(corners))
    refs = "".join(f'<nd ref="{i}"/>' for i in (0, 1, 2, 3, 0))
    tags = "".join(f'<tag k="{key}" v="{value}"/>' for key, value in [("building", "yes"), *tags])
    path.write_text(f'<osm>{nodes}<way id="7">{refs}{tags}</way></osm>')
    return path


@pytest.mark.parametrize(
    "tags, says",
    [
        ([("height", "12 parsec")], "height: got '12 parsec', needs metres, or a number with m, ft"),
        ([("height", "-40 ft")], "height: got '-40 ft', needs metres"),
        ([("height", "-3")], "height: got '-3'"),
        ([("height", "4000 m")], "height: got 0 to 4000 m, needs 0 <= bottom < top <= 1000 m"),
        ([("height", "40000 ft")], "height: got 0 to 12192 m, needs"),
        ([("height", "12 m"), ("min_height", "20 m")], "height: got 20 to 12 m, needs"),
        ([("height", "12 m"), ("min_height", "a few")], "min_height: got 'a few'"),
        ([("building:levels", "many")], "building:levels: got 'many', needs a number of storeys"),
        ([("building:levels", "nan")], "building:levels: got 'nan'"),
        ([("building:levels", "0")], "height: got 0 to 0 m"),
    ],
)
def test_absurd_heights_are_refused_with_their_building(tmp_path, tags, says):
    with pytest.raises(CastError) as error:
        osm.read(extract(tmp_path / "a.osm", *tags))
    assert len(error.value.faults) == 1 and f"a.osm: building way 7: {says}" in str(error.value)


@pytest.mark.parametrize(
    "tags, low_m, high_m, source",
    [
        ([("height", "12 m")], 0, 12, "heights given"),
        ([("height", "40 ft")], 0, 12.192, "heights given"),
        ([("building:levels", "4"), ("building:min_level", "1")], 3, 12, "heights from levels of 3 m"),
        ([("min_height", "20")], 20, 23, "heights assumed, 9 m"),  # the default stands on the given bottom
        ([], 0, 9, "heights assumed, 9 m"),
    ],
)
def test_heights_that_make_sense_are_taken_and_counted_by_their_source(tmp_path, tags, low_m, high_m, source):
    solids, count = osm.read(extract(tmp_path / "a.osm", *tags))
    z_m = solids[0].vertices_m[:, 2]
    assert (z_m.min(), z_m.max()) == pytest.approx((low_m, high_m)) and count[source] == 1


def test_an_area_or_an_extract_without_buildings_is_refused(tmp_path):
    path = extract(tmp_path / "a.osm")
    with pytest.raises(CastError, match="a.osm: holds no building inside the area"):
        osm.read(path, area_m=(1e4, 1e4, 2e4, 2e4))
    path.write_text('<osm><node id="1" lat="48" lon="11"/></osm>')
    with pytest.raises(CastError, match="a.osm: holds no building$"):
        osm.read(path)


@pytest.mark.parametrize(
    "text, metres",
    [("12", 12), ("12 m", 12), ("40 ft", 12.192), ("40'", 12.192), ("40'6\"", 12.3444), ("7.5m", 7.5)],
)
def test_heights_are_read_with_their_units(text, metres):
    assert osm.length_m(text) == pytest.approx(metres)


def test_every_object_gets_a_material_or_is_named():
    solids = [
        geometry.prism(name, SQUARE, [], 0, 1, surface) for name, surface in (("wall_1", "x"), ("desk", "oak"), ("odd", ""))
    ]
    brick, wood, metal, floor = (Medium(material=name) for name in ("brick", "wood", "metal", "floorboard"))
    given_ones = materials.assign(solids, {"wall_*": brick, "oak": wood, "*": metal}, 2.4e9)
    assert [solid.medium for solid in given_ones] == [brick, wood, metal]
    with pytest.raises(CastError) as error:
        materials.assign(solids, {"wall_*": brick, "oak": wood, "o": floor}, 2.4e9)
    text = str(error.value)
    assert "1 objects have none: odd" in text and "floorboard is known from 50 to 100 GHz" in text


@settings(max_examples=400, deadline=None)
@given(st.data())
def test_any_bytes_are_an_extract_or_refused_but_never_a_crash(tmp_path_factory, data):
    content = bytearray((sc.examples_folder() / "street.osm").read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.sampled_from(b'0123456789.-"<>/ ekvnm'))
    path = tmp_path_factory.getbasetemp() / "fuzz.osm"
    path.write_bytes(content)
    try:
        osm.read(path)
    except CastError as error:
        assert "fuzz.osm" in str(error)
