# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.report import labels, plot


def boxes(figure, axes):
    renderer = figure.canvas.get_renderer()
    shown = [text for text in axes.texts if text.get_text()]
    return [(text.get_text(), text.get_window_extent(renderer)) for text in shown]


@pytest.mark.parametrize("count, crowd", [(3, 1.0), (12, 1.0), (32, 1.0), (32, 0.05)])
def test_labels_never_overlap_and_none_is_lost(count, crowd, tmp_path):
    rng = np.random.default_rng(count)
    x, y = crowd * rng.random(count), -60 * rng.random(count)
    texts = [f"{1000 + index}.000 µs, -{index}.00 dB" for index in range(count)]
    figure = plot.new_figure(9, 6.5)
    top, bottom = figure.subplots(2, 1, height_ratios=[3, 2])
    top.plot([0, 1], [-60, 0])
    rest = labels.label(figure, top, x, y, texts)
    plot.save(figure, tmp_path / "labels.png")
    found = boxes(figure, top)
    listed = [line for text, _ in found for line in text.split("\n") if "µs" in line]
    more = [int(line.split()[2]) for text, _ in found for line in text.split("\n") if line.startswith("…")]
    assert len(set(listed)) == len(listed) == count - sum(more) and set(listed) <= set(texts) and (count > 3 or not rest)
    for index, (text, box) in enumerate(found):
        for other, other_box in found[index + 1 :]:
            assert not box.overlaps(other_box), (text, other)
        assert "not labelled" in text or not box.overlaps(bottom.get_window_extent(figure.canvas.get_renderer()))
    frame = figure.bbox
    stems = [pixel for pixel in top.transData.transform(np.column_stack([x, y]))]
    bottom_px = top.get_window_extent(figure.canvas.get_renderer()).y0
    for text, box in found:
        assert "not labelled" in text or not any(box.x0 < px < box.x1 and bottom_px < box.y0 < py for px, py in stems), text
    assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 + 1 for _, box in found)


@pytest.mark.parametrize("error_db", [0.0, 0.4, 3.0])
def test_a_colour_scale_spans_the_figures_and_never_less_than_their_error(error_db):
    for spread in (0.0, 1e-6, 0.5, 40.0):
        values = np.array([[np.nan, 60.0], [60.0 + spread, -np.inf]])
        ends = plot.colour_scale(values, error_db)
        assert ends["vmin"] <= 60.0 and 60.0 + spread <= ends["vmax"]
        assert ends["vmax"] - ends["vmin"] >= max(2 * error_db, spread)
    assert plot.colour_scale(np.full((2, 2), np.nan)) == {}


def test_no_cell_of_a_heat_map_is_minus_zero():
    figure = plot.heatmap_figure(np.array([[-0.01, 0.0], [np.nan, -0.04]]), ["1", "2"], "test")
    assert sorted(text.get_text() for text in figure.axes[0].texts) == ["0.0", "0.0", "0.0", "–"]


def test_the_strongest_are_labelled_first():
    figure = plot.new_figure(9, 6.5)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1])
    texts = [f"tap number {index}" for index in range(40)]
    rest = labels.label(figure, axes, np.full(40, 0.5), np.full(40, 0.5), texts)
    assert texts[0] not in rest and rest
