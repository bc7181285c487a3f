# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled kernels of the tracer do what its NumPy does, in rooms and yards drawn at random."""

import os
import pickle
import shutil
import subprocess
import sys
from dataclasses import fields as numbers_of
from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.places import bending, passages, tracks
from gr_cast.scenario.create import fields, images
from gr_cast.scenario.create.geometry import Solid
from gr_cast.twin.places import passer, predict

pytest.importorskip("gr_cast.scenario.create.tracing", reason="the compiled kernels were not built")
CARRIER_HZ, BOX = 3.5e9, [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6], [0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 6], [2, 6, 3],
                          [3, 6, 7], [3, 7, 0], [0, 7, 4]]  # fmt: skip
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], float)


def solids(random, count=7):
    """Boxes and sheets, some inside a room of one closed box, some turned."""
    found = [Solid(name="room", vertices_m=CORNERS * [12, 9, 4], faces=BOX)]
    for number in range(count):
        turn = random.uniform(0, 2 * np.pi) * (number % 2)
        rotation = [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        at, size = random.uniform([1, 1, 0], [9, 6, 1.5]), random.uniform(0.5, 2.5, 3)
        corners, faces = (CORNERS, BOX) if number % 3 else (CORNERS[[0, 1, 5, 4]], [[0, 1, 2], [0, 2, 3]])
        found.append(Solid(name=f"thing_{number}", vertices_m=corners * size @ rotation + at, faces=faces))
    return found


def surface(random, count):
    return fields.Surface(
        permittivity=random.uniform(1.5, 8, count),
        conductivity=random.uniform(0, 0.2, count),
        thickness_m=np.where(random.random(count) < 0.2, np.inf, random.uniform(0.01, 0.3, count)),
        height_rms_m=random.uniform(0, 0.005, count),
        scattering=random.uniform(0, 0.5, count),
        present=random.random(count) < 0.8,
        clear=random.random(count) < 0.7,
    )


@pytest.fixture(params=range(6))
def drawn(request):
    random = np.random.default_rng(request.param)
    things = solids(random)
    ends_m = random.uniform([0.5, 0.5, 0.3], [11.5, 8.5, 3.5], (2, 9, 3))
    faces = images.faces_of(things, ends_m.reshape(-1, 3), thick=bool(request.param % 2))
    return random, faces, ends_m[0], ends_m[1], surface(random, len(things))


def both(monkeypatch, make):
    """What the compiled kernels make, and what NumPy makes."""
    compiled = make()
    for module in (images, fields, passer, tracks, passages, bending):
        monkeypatch.setattr(module, "tracing", None)
    return compiled, make()


def same_paths(one, other):
    for part in numbers_of(images.Paths):
        np.testing.assert_array_equal(getattr(one, part.name), getattr(other, part.name))


@pytest.mark.parametrize("depth", [0, 1, 2, 3])
@pytest.mark.parametrize("some", [False, True])
def test_the_same_paths_are_found_in_the_same_order(drawn, monkeypatch, depth, some):
    random, faces, tx_m, rx_m, _ = drawn
    among = random.random(len(faces.level_m)) < 0.1 if some else None
    one, other = both(monkeypatch, lambda: images.search(faces, tx_m, rx_m, depth, among))
    assert some or len(one.pair) >= len(tx_m) and len(one.crossing_path)
    same_paths(one, other)


def test_the_same_paths_are_found_again_after_an_object_moved(drawn, monkeypatch):
    _, faces, tx_m, rx_m, _ = drawn
    moved = images.shifted(faces, 3, np.array([0.2, -0.4, 0.1]))
    known = images.search(faces, tx_m, rx_m, 2)
    one, other = both(monkeypatch, lambda: images.search_again(moved, known, tx_m, rx_m, 2, moved.owner == 3))
    same_paths(one, other)
    same_paths(one, images.search(moved, tx_m, rx_m, 2))


def test_a_long_list_of_pairs_is_searched_piece_by_piece(drawn, monkeypatch):
    _, faces, tx_m, rx_m, _ = drawn
    whole = images.search(faces, tx_m, rx_m, 2)
    monkeypatch.setattr(images, "_AT_ONCE", 2 * len(faces.level_m) ** 2)
    same_paths(images.search(faces, tx_m, rx_m, 2), whole)
    assert not len(images.search(faces, tx_m[:0], rx_m[:0], 2).pair)


def test_crossings_are_the_same(drawn, monkeypatch):
    random, faces, tx_m, rx_m, _ = drawn
    points, met = np.stack([tx_m, rx_m, rx_m[::-1]], axis=1), np.where(random.random((len(tx_m), 1)) < 0.5, 0, -1)
    one, other = both(monkeypatch, lambda: images.crossings(faces, points, met))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


def test_gains_and_their_geometry_are_the_same(drawn, monkeypatch):
    random, faces, tx_m, rx_m, made_of = drawn
    paths = fields.unblocked(faces, images.search(faces, tx_m, rx_m, 2), made_of)
    antennas = [fields.Antenna(pattern=name, orientation_rad=tuple(random.uniform(-2, 2, 3))) for name in fields.PATTERNS]
    which = random.integers(len(antennas), size=len(paths.pair))

    def make():
        way = fields.optics(faces, paths.faces, tx_m[paths.pair], rx_m[paths.pair])
        sent, taken = (fields.far_fields(antennas, which, d) for d in (way.direction[:, 0], -way.direction[:, -1]))
        return way, sent, taken, fields.gains(faces, paths, way, made_of, sent, taken, CARRIER_HZ)

    (way, *one), (their_way, *other) = both(monkeypatch, make)
    assert len(paths.crossing_path) and (paths.faces[:, 1] >= 0).any()
    for a, b in zip([*vars(way).values(), *one], [*vars(their_way).values(), *other], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
    assert np.abs(one[-1]).max() > 0


@pytest.mark.parametrize("steps", [1, 2, 7, 64])
def test_sums_over_paths_are_the_same(drawn, monkeypatch, steps):
    random = drawn[0]
    instant, length_m = random.integers(5, size=40), random.uniform(1, 900, 40)
    gain = (random.normal(size=(40, 2)) @ [1, 1j]) * (random.random(40) < 0.8)
    band_hz = np.linspace(-2e8, 2e8, steps)
    one, other = both(monkeypatch, lambda: predict.summed(instant, gain, length_m, 6, CARRIER_HZ, band_hz))
    np.testing.assert_allclose(one, other, atol=1e-9)
    written_out = np.exp(-2j * np.pi * (CARRIER_HZ + band_hz) * length_m[:, None] / 299_792_458.0)
    expected = [(gain[:, None] * written_out)[instant == number].sum(axis=0) for number in range(6)]
    np.testing.assert_allclose(one, expected, atol=1e-7)


def test_a_body_shades_what_goes_through_it(drawn, monkeypatch):
    random = drawn[0]
    points_m = random.uniform([-2, -2, -1], [2, 2, 3], (40, 5, 4, 3))
    points_m[:8, :, 1, :2] = points_m[:8, :, 0, :2]  # legs that go straight up, which nothing upright shades
    foot_m = np.append(random.uniform(-1, 1, (6, 40, 2)), np.zeros((6, 40, 1)), axis=2)
    one, other = both(monkeypatch, lambda: passer.shaded(0.4, 1.8, foot_m, points_m))
    np.testing.assert_array_equal(one, other)
    way_m = points_m[:, :, :-1, None] + np.linspace(0, 1, 2001)[:, None] * np.diff(points_m, axis=2)[:, :, :, None]
    slopes = (np.diff(points_m, axis=2)[..., :2] != 0).any(axis=3)[..., None]
    for place in range(len(foot_m)):
        apart_m = way_m - foot_m[place][:, None, None, None]
        within = (np.hypot(apart_m[..., 0], apart_m[..., 1]) < 0.4) & (apart_m[..., 2] > 0) & (apart_m[..., 2] < 1.8) & slopes
        found = within.any(axis=(2, 3))
        assert (one[place] >= found).all() and (one[place] > found).mean() < 0.02  # what touches it between two of the points
    assert 0.1 < one.mean() < 0.9


def test_the_same_maps_are_summed_along_ways(monkeypatch):
    random = np.random.default_rng(5)
    maps, moved = random.normal(size=(6, 9, 11)), random.integers(-14, 15, (70, 6, 2))
    one, other = both(monkeypatch, lambda: tracks.summed(maps, moved))
    assert (one == other).all() and one.any()


@pytest.mark.parametrize("instants", [range(5), [4, 0, 2]])
def test_the_same_cells_are_met_along_lines(monkeypatch, instants):
    random = np.random.default_rng(6)
    maps = random.normal(size=(4, 5, 21, 21)).astype(np.float32)
    strip = passages.Strip(nats=maps, axis_m=0.02 * np.arange(-10, 11), after_s=np.linspace(-1, 1.5, 5))
    at_m, turn = random.uniform(-0.25, 0.25, (40, 1, 2)), random.uniform(-0.2, 0.2, (40, 3, 2))
    one, other = both(monkeypatch, lambda: strip.sums(maps, instants, at_m, turn))
    assert one.shape == (4, 40, 3) and (one == other).all() and one.any()


@pytest.mark.parametrize("is_free", [False, True])
def test_a_response_is_as_much_likelier_with_somebody(monkeypatch, is_free):
    random = np.random.default_rng(7)
    said, common, loud = random.normal(size=(3, 2, 9, 9)).astype(np.float32)
    said, loud, kind = said[0] + 1j * said[1], loud[0] ** 2, random.integers(0, 2, (9, 9))
    heard = passages.Response(
        power=9.0, count=5, is_free=is_free, own=np.array([3.0, 1.0]), shared=np.array([2.0 + 1j, 0.5]), before=(3.0, 2.0 + 1j)
    )
    one, other = both(monkeypatch, lambda: heard.likelier(said, common, loud, kind))
    assert one.shape == (6, 9, 9) and one.std() > 1
    np.testing.assert_allclose(one, other, atol=1e-4)
    without = heard.likelier(0 * said, 0 * common, 0 * loud, 0 * kind)
    np.testing.assert_allclose(without, 0, atol=1e-6)  # somebody who hides and echoes nothing


def test_the_same_fields_are_turned_between_knots(monkeypatch):
    random = np.random.default_rng(8)
    knots = passages.Knots(axis_m=0.004 * np.arange(-50, 51))
    field, phase = random.normal(size=(2, len(knots.at_m), len(knots.at_m)))
    field, phase = field + 1j * random.normal(size=field.shape), 9 * phase
    one, other = both(monkeypatch, lambda: knots.turned(field, phase))
    assert len(knots.at_m) > 5 and one.shape == (101, 101)
    np.testing.assert_allclose(one, other, atol=1e-4)
    np.testing.assert_allclose(one[::100, ::100], (field * np.exp(1j * phase)).real[[[0], [-1]], [0, -1]], atol=1e-5)


@pytest.mark.parametrize(("edges", "instants", "steps"), [(1, 1, 1), (3, 7, 16), (10, 5, 9)])
def test_edges_are_as_strong_as_is_likeliest(monkeypatch, edges, instants, steps):
    random = np.random.default_rng(9)
    drawn = random.normal(size=(edges + 2, instants, steps, 2)) @ [3, 3j]
    weight = random.random((instants, steps)) * (random.random((instants, steps)) < 0.8) + 1e-3 * np.eye(instants, steps)

    def loosened():
        model, left = drawn[-2:].copy()
        return bending._loosen(drawn[:edges], weight, model, left), model, left

    one, other = both(monkeypatch, loosened)
    for mine, numpys in zip(one, other, strict=True):
        np.testing.assert_allclose(mine, numpys, atol=1e-12)
    # The least there is of what is left and of what strengths cost: no other strength of any edge leaves less.
    assert one[0] > 0 and (np.abs(one[2] - drawn[-1]) > 0)[weight > 0].all()
    slope = (drawn[:edges].conj() * weight * one[2]).sum(axis=(1, 2))
    strength, *_ = np.linalg.lstsq(drawn[:edges].reshape(edges, -1).T, (one[1] - drawn[-2]).ravel(), rcond=None)
    np.testing.assert_allclose(slope, strength, atol=1e-9)


@pytest.mark.parametrize("many", [1e3, 1e8])
def test_edges_that_give_the_same_are_strong_together_however_loud(many):
    fields_, weight, left = np.full((5, 1, 2), many, complex), np.ones((1, 2)), np.array([[2.0, 2.0]], complex)
    model = np.zeros((1, 2), complex)
    price = bending._loosen(fields_, weight, model, left)
    assert np.isfinite(price) and np.isfinite(left).all() and (price > 0)
    np.testing.assert_allclose(model + left, 2.0, rtol=1e-6)
    assert np.abs(left).max() < 1e-3


def test_maps_and_ways_that_do_not_belong_together_are_refused():
    kernels = pytest.importorskip("gr_cast.scenario.create.tracing")
    with pytest.raises(ValueError, match="needs maps"):
        kernels.summed_along(np.zeros((3, 4, 4)), np.zeros((2, 4, 2), int))
    maps, after_s, lines = np.zeros((3, 4, 4), np.float32), np.zeros(3), np.zeros((5, 2))
    maps = maps[None]
    for wrong in (dict(maps=maps[:, :, :3]), dict(maps=maps[:, :2]), dict(maps=maps[0]), dict(turn=lines[:4])):
        told = dict(maps=maps, begin_m=0.0, step_m=1.0, after_s=after_s, instant=[0], at_m=lines, turn=lines) | wrong
        with pytest.raises(ValueError, match="needs"):
            kernels.along(*told.values())
    for field, at, fault in ((np.zeros((2, 3)), [0.5], ValueError), (np.zeros((2, 2)), [2.5], IndexError)):
        with pytest.raises(fault, match="needs fields|beyond all knots"):
            kernels.turned_between(field, np.zeros(4), at)
    fields_, weight = np.ones((2, 3), complex), np.ones(3)
    for wrong in (dict(field=fields_[:, :2]), dict(residual=fields_[0, :2].copy()), dict(model=fields_[0].real.copy())):
        told = dict(field=fields_, weight=weight, model=fields_[0].copy(), residual=fields_[0].copy()) | wrong
        with pytest.raises((ValueError, TypeError), match="field: got|as many numbers|incompatible"):
            kernels.loosen(**told)
    with pytest.raises(IndexError, match="kind: got"):
        kernels.likelier(1.0, 1, 0.0, True, [1.0], [1.0], np.zeros(2), np.zeros(2), np.zeros(2), [0, 1], [1.0])
    with pytest.raises(IndexError, match="instant: got"):
        kernels.along(maps, 0.0, 1.0, after_s, [3], lines, lines)


def test_a_convex_body_shows_its_outside_however_its_triangles_are_wound(drawn):
    random, *_ = drawn
    flipped = [face[:: 1 if random.random() < 0.5 else -1] for face in BOX]
    faces = images.faces_of([Solid(name="box", vertices_m=CORNERS * [3, 2, 1] + 5, faces=flipped)])
    inside_m = np.array([6.5, 6.0, 5.5])
    assert len(faces.level_m) == 6 and faces.sided.all()
    assert (faces.normal @ inside_m < faces.level_m).all()


def test_faces_go_to_other_processes_without_what_was_compiled(drawn):
    _, faces, tx_m, rx_m, _ = drawn
    found = images.search(faces, tx_m, rx_m, 1)
    same_paths(images.search(pickle.loads(pickle.dumps(faces)), tx_m, rx_m, 1), found)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda f: replace(f, level_m=f.level_m[:-1]),
        lambda f: replace(f, start=f.start[:-1]),
        lambda f: replace(f, start=f.start + 1),
        lambda f: replace(f, normal=f.normal.ravel()[:-1]),
    ],
)
def test_faces_whose_arrays_do_not_belong_together_are_refused(drawn, wrong):
    _, faces, tx_m, rx_m, _ = drawn
    with pytest.raises((ValueError, IndexError), match=r"got .*needs|got .*rows have"):
        images.search(wrong(faces), tx_m, rx_m, 1)


def test_feet_that_are_not_of_the_paths_are_refused():
    kernels = pytest.importorskip("gr_cast.scenario.create.tracing")
    for foot_m, points_m in ((np.zeros((2, 3, 3)), np.zeros((4, 1, 2, 3))), (np.zeros((3, 3)), np.zeros((3, 1, 2, 3)))):
        with pytest.raises(ValueError, match="needs feet"):
            kernels.shaded(0.3, 1.8, foot_m, points_m)


def test_paths_over_faces_that_are_not_there_are_refused(drawn):
    _, faces, tx_m, rx_m, _ = drawn
    for met in ([[len(faces.level_m)]], [[-2]]):
        with pytest.raises(IndexError, match="met: got"):
            fields.optics(faces, np.array(met), tx_m[:1], rx_m[:1])


def test_a_numpy_that_the_build_cannot_read_is_refused():
    """pybind11 before 2.12 gave pairs that were all zero under NumPy 2: then NumPy's own search is taken."""
    if shutil.which("pkg-config") is None or subprocess.run(["pkg-config", "--exists", "pybind11"], check=False).returncode:
        pytest.skip("NO PKG-CONFIG OF PYBIND11: which one the kernels were built with is not known")
    built_by = subprocess.run(["pkg-config", "--modversion", "pybind11"], capture_output=True, text=True, check=True).stdout
    knows_2 = tuple(map(int, built_by.split(".")[:2])) >= (2, 12)
    lines = 'import numpy; numpy.__version__ = "2.1.0"; from gr_cast.scenario.create import images; print(images.tracing is None)'
    where = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    said = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True, env=where).stdout
    assert said.strip() == str(not knows_2)
