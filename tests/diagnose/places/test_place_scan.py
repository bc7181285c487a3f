# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarse searches over grids: what is worked out once for many rows, or for many columns, is what each gives alone."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.places import likelihood, scan
from gr_cast.diagnose.places.eclipses import _Rows
from gr_cast.diagnose.places.likelihood import Heard


def drawn(random, *shape) -> np.ndarray:
    return random.normal(size=shape) + 1j * random.normal(size=shape)


def drawn_rows(random, paths: int, is_free: bool, axes: int = 3) -> list[scan.Row]:
    return [
        scan.Row(
            base=drawn(random, paths, 4), rates=20 * random.normal(size=(axes, paths, 4)), rest=drawn(random, 4),
            y=drawn(random, 4), weight=random.uniform(0, 9, 4), is_free=is_free,
        )
        for _ in range(5)
    ]  # fmt: skip


@pytest.mark.parametrize("at_once", [1, 150, 4000, None])
@pytest.mark.parametrize("is_free", [False, True])
def test_a_grid_in_space_is_its_levels_however_many_tones_are_looked_at_together(is_free, at_once, monkeypatch):
    if at_once:
        monkeypatch.setattr(scan, "_AT_ONCE", at_once)
        monkeypatch.setattr(scan, "tracing", None)
    rows = drawn_rows(np.random.default_rng(1), 3, is_free)
    first, second, third = np.linspace(-1, 1, 9), np.linspace(-1, 1, 7), np.array([-0.2, 0.0, 0.3])
    space = scan.energy_in_space(rows, first, second, third)
    for number, by in enumerate(third):
        level = [replace(row, base=row.base * np.exp(-1j * by * row.rates[2]), rates=row.rates[:2]) for row in rows]
        np.testing.assert_allclose(space[..., number], scan.energy(level, first, second), rtol=1e-5)
    places = np.array([first[2], second[3], third[0]])
    left = [row.y - (row.base * np.exp(-1j * np.tensordot(places, row.rates, 1))).sum(axis=0) - row.rest for row in rows]
    if not is_free:
        told = sum((np.abs(one) ** 2 * row.weight).sum() for one, row in zip(left, rows, strict=True))
        assert space[1, 2, 3, 0] == pytest.approx(told, rel=1e-4)


@pytest.mark.parametrize("paths", [0, 1, 9])
@pytest.mark.parametrize("is_free", [False, True])
@pytest.mark.parametrize("counts", [(1, 1, 1), (5, 8, 2), (4, 17, 3)])
def test_a_kernel_has_the_energies_of_a_grid_that_numpy_has(paths, is_free, counts, monkeypatch):
    pytest.importorskip("gr_cast.scenario.create.tracing")
    random = np.random.default_rng(7)
    even, ragged = [np.linspace(-30, 9, count) for count in counts], [random.normal(size=count) for count in counts]
    for axes in (even, ragged, ragged[:2]):
        rows = drawn_rows(random, paths, is_free, len(axes))
        for scale in (1.0, None):
            mine = [scan._energy(row, axes, scale) for row in rows]
            with monkeypatch.context() as without:
                without.setattr(scan, "tracing", None)
                theirs = [scan._energy(row, axes, scale) for row in rows]
            np.testing.assert_allclose(mine, theirs, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("paths", [0, 1, 9])
@pytest.mark.parametrize("is_free", [False, True])
@pytest.mark.parametrize("axes", [1, 3])
def test_a_kernel_has_the_steps_to_the_bottoms_of_wells_that_numpy_has(paths, is_free, axes, monkeypatch):
    pytest.importorskip("gr_cast.scenario.create.tracing")
    random = np.random.default_rng(8)
    for row in drawn_rows(random, paths, is_free, axes):
        places = random.normal(size=(6, axes))
        mine = scan._steps(row, places)
        with monkeypatch.context() as without:
            without.setattr(scan, "tracing", None)
            theirs = scan._steps(row, places)
        for one, other in zip(mine, theirs, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("is_free", [False, True])
def test_a_response_that_may_do_without_what_turns_leaves_no_more_than_without_it(is_free):
    random = np.random.default_rng(6)
    base, rates, rest = drawn(random, 3, 12), 20 * random.normal(size=(2, 3, 12)), drawn(random, 12)
    weight, grid = np.full(12, 9.0), np.linspace(-1, 1, 30)
    there = (base * np.exp(-1j * (grid[7] * rates[0] + grid[3] * rates[1]))).sum(axis=0) + rest
    y = there * np.exp(0.4j * is_free) + 0.1 * drawn(random, 12)
    most = scan._left_by(rest, y, weight, is_free)
    row = scan.Row(base=base, rates=rates, rest=rest, y=y, weight=weight, is_free=is_free)
    assert most == pytest.approx(scan.energy([replace(row, base=0 * base)], grid[:1], grid[:1])[1, 0, 0], rel=1e-3)
    free, bound = (scan.energy([one], grid, grid)[1] for one in (row, replace(row, most=most)))
    assert bound == pytest.approx(np.minimum(free, most)) and free.min() < most < free.max()


@pytest.mark.parametrize("phase", ["none", "link", "snapshot"])
@pytest.mark.parametrize("gain", ["none", "common", "node"])
@pytest.mark.parametrize("delay", ["none", "node", "link"])
def test_phases_are_taken_out_of_columns_together_as_alone(phase, gain, delay):
    random, links = np.random.default_rng(2), (("a", "b"), ("a", "c"), ("c", "b"))
    heard = Heard(
        links=links, y=drawn(random, 3, 4, 6), weight=random.uniform(0, 2, (3, 4, 6)), frequency_hz=1e6 * np.arange(6.0),
        phase=phase, gain=gain, delay=delay,
    )  # fmt: skip
    model = drawn(random, 3, 4, 6)
    columns = likelihood.tangents(heard, model)
    assert len(columns) == {"none": 0, "common": 1, "node": 3}[gain] + {"none": 0, "node": 3, "link": 3}[delay]
    for one, whole in zip(columns, likelihood.without_phases(heard, model, columns), strict=True):
        np.testing.assert_allclose(whole, likelihood.without_phases(heard, model, one), atol=1e-12 * np.abs(one).max())


@pytest.mark.parametrize("phase", ["none", "link", "snapshot"])
@pytest.mark.parametrize("gain", ["none", "common", "node", "link"])
@pytest.mark.parametrize("delay", ["none", "node", "link"])
def test_a_kernel_fits_what_is_unknown_as_numpy_does(phase, gain, delay, monkeypatch):
    pytest.importorskip("gr_cast.scenario.create.tracing")
    random, links = np.random.default_rng(5), (("a", "b"), ("a", "c"), ("c", "b"), ("d", "e"), ("f", "g"))
    late, loud = random.uniform(-9e-9, 9e-9, 5), random.uniform(0.5, 2, 5)
    h, frequency_hz = drawn(random, 5, 4, 16), 3e6 * np.arange(-8.0, 8.0)
    h[4] = 0  # of which nothing is predicted
    y = loud[:, None, None] * h * np.exp(-2j * np.pi * frequency_hz * late[:, None, None]) + 0.1 * drawn(random, 5, 4, 16)
    weight = np.where(random.random(y.shape) < 0.1, 0.0, random.uniform(20, 90, y.shape) * 10.0 ** -np.arange(5)[:, None, None])
    told = Heard(
        links=links, y=np.where(weight > 0, y, 0), weight=weight, frequency_hz=frequency_hz, phase=phase, gain=gain, delay=delay
    )
    mine = likelihood.profiled(told, h)
    monkeypatch.setattr(likelihood, "tracing", None)
    theirs = likelihood.profiled(told, h)
    assert mine.energy == pytest.approx(theirs.energy, rel=1e-7) and mine.offset == pytest.approx(theirs.offset, rel=1e-7)
    for name in ("model", "residual", "factor"):
        np.testing.assert_allclose(getattr(mine, name), getattr(theirs, name), atol=1e-6)


def test_gains_of_links_are_each_links_own():
    random = np.random.default_rng(6)
    h, loud = drawn(random, 3, 2, 8), np.array([0.5, 3.0, 1.7])
    told = Heard(
        links=(("a", "b"), ("b", "c"), ("a", "c")), y=loud[:, None, None] * h, weight=np.full(h.shape, 1e6),
        frequency_hz=1e6 * np.arange(8.0), phase="none", gain="link", delay="none",
    )  # fmt: skip
    np.testing.assert_allclose(likelihood.profiled(told, h).factor[:, 0, 0], loud, rtol=1e-9)


def test_what_is_left_of_hidden_paths_is_what_they_leave_one_by_one():
    random, count = np.random.default_rng(3), np.array([4.0, 5.0])
    paths, heard = drawn(random, 2, 3, 8), drawn(random, 2, 8)
    model = paths.sum(axis=1)
    rows = _Rows(
        time_s=np.zeros(2), count=count, free=np.array([True, False]), heard=(np.abs(heard) ** 2).sum(axis=1),
        power=(np.abs(model) ** 2).sum(axis=1), told=(model.conj() * heard).sum(axis=1),
        shared=np.einsum("rpk,rk->rp", paths.conj(), model).real, cross=np.einsum("rpk,rk->rp", paths.conj(), heard),
        gram=np.einsum("rpk,rqk->rpq", paths.conj(), paths).real, points_m=np.zeros((2, 3, 2, 3)),
    )  # fmt: skip
    dark = random.integers(0, 2, (5, 2, 3)).astype(float)
    for one, energies in zip(dark, rows.energy(dark), strict=True):
        kept = (paths * (1 - one)[..., None]).sum(axis=1)
        cross = (kept.conj() * heard).sum(axis=1)
        told = np.where(rows.free, np.abs(cross), cross.real)
        least = rows.heard + (np.abs(kept) ** 2).sum(axis=1) - 2 * told
        np.testing.assert_allclose(energies, np.maximum(least, count), rtol=1e-12)
