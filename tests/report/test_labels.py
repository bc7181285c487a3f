# SPDX-License-Identifier: GPL-3.0-or-later
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.comparing import responses
from gr_cast.report import labels, plot
from matplotlib.text import Text


def boxes(figure, axes):
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    shown = [text for text in axes.texts if text.get_text()]
    listed = [text.get_text().startswith("not labelled") for text in shown]
    words = [text.get_text() if one else text.get_text().replace("\n", ", ") for text, one in zip(shown, listed, strict=True)]
    return [(word, Text.get_window_extent(text, renderer)) for word, text in zip(words, shown, strict=True)]


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


@pytest.mark.parametrize("end_us", [5.1, 10.2])
def test_the_four_taps_of_the_first_picture_are_labelled_beside_their_points(end_us):
    figure = plot.new_figure(9.9, 7.2)
    top, _ = figure.subplots(2, 1, height_ratios=[3, 2])
    top.set(xlim=(-0.05 * end_us, 1.05 * end_us), ylim=(-165, 11))
    delay_us, gain_db = np.array([0, 4, 2, 1.28]), np.array([-3.0, -8, -15, -20])
    texts = [f"{x:.3f} µs, {y:.2f} dB" for x, y in zip(delay_us, gain_db, strict=True)]
    assert labels.label(figure, top, delay_us, gain_db, texts) == []
    points = dict(zip(texts, top.transData.transform(np.column_stack([delay_us, gain_db])), strict=True))
    for text, box in boxes(figure, top):
        nearest = {other: np.hypot(*(np.clip(point, box.min, box.max) - point)) for other, point in points.items()}
        assert min(nearest, key=nearest.get) == text


@pytest.mark.parametrize("error_db", [0.0, 0.4, 3.0])
def test_a_colour_scale_spans_the_figures_and_never_less_than_their_error(error_db):
    for spread in (0.0, 1e-6, 0.5, 40.0):
        values = np.array([[np.nan, 60.0], [60.0 + spread, -np.inf]])
        ends = plot.colour_scale(values, error_db)
        assert ends["vmin"] <= 60.0 and 60.0 + spread <= ends["vmax"]
        assert ends["vmax"] - ends["vmin"] >= max(2 * error_db, spread)
    assert plot.colour_scale(np.full((2, 2), np.nan)) == {}


def test_axes_of_power_span_a_decibel_at_least_whatever_stands_still():
    still = {"time_s": np.arange(9.0), "value": 20 + 1e-3 * np.arange(9)}
    (axes,) = plot.stack_figure({"sinr_db": {"1": SimpleNamespace(**still)}}, "still").axes
    columns = {"time_s": still["time_s"], "throughput_mbit_per_s": still["value"], "sinr_db": still["value"]}
    run = SimpleNamespace(series=columns, label="a", setting=SimpleNamespace(jammer=None), offered_mbit_per_s=20)
    loud = SimpleNamespace(**run.__dict__ | {"series": columns | {"sinr_db": 5 * still["value"]}})
    _, _, quiet, beside = plot.jamming_figure([("none", [run]), ("wall", [loud])]).axes
    assert np.ptp(axes.get_ylim()) == pytest.approx(1.0)
    assert quiet.get_ylim() == beside.get_ylim() and quiet.get_ylim()[1] > 100  # cases are read beside each other


def test_no_cell_of_a_heat_map_is_minus_zero():
    figure = plot.heatmap_figure(np.array([[-0.01, 0.0], [np.nan, -0.04]]), ["1", "2"], "test")
    assert sorted(text.get_text() for text in figure.axes[0].texts) == ["0.0", "0.0", "0.0", "–"]


def test_cells_of_one_figure_have_one_colour_of_text():
    cells = plot.heatmap_figure(np.array([[20.01, 19.99], [20.02, 19.98]]), ["1", "2"], "alike").axes[0].texts
    assert {text.get_text() for text in cells} == {"20.0"} and len({text.get_color() for text in cells}) == 1
    cells = plot.heatmap_figure(np.array([[20.0, 60.0]]), ["1", "2"], "apart").axes[0].texts
    assert [text.get_color() for text in cells] == ["k", "w"]


def test_the_strongest_are_labelled_first():
    figure = plot.new_figure(9, 6.5)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1])
    texts = [f"tap number {index}" for index in range(40)]
    rest = labels.label(figure, axes, np.full(40, 0.5), np.full(40, 0.5), texts)
    assert texts[0] not in rest and rest


def test_who_stands_alone_is_labelled_within_the_picture():
    a = responses.Response(name="A", delay_s=np.array([1e-7, 7e-7]), gain_db=np.array([-70.0, -94.0]))
    b = responses.Response(name="B", delay_s=np.array([1e-7]), gain_db=np.array([-70.0]))
    figure = plot.response_comparison_figure(responses.compare_responses(a, b, 1e-8))
    (axes,) = figure.axes
    frame = axes.get_window_extent()
    (found,) = [box for text, box in boxes(figure, axes) if text == "only in A"]
    assert frame.x0 < found.x0 and found.x1 < frame.x1


def test_a_figure_that_changes_after_it_was_drawn_is_laid_out_again():
    figure, fresh = (plot.new_figure(5, 3) for _ in range(2))
    both = [one.subplots() for one in (figure, fresh)]
    plot.png(figure, 90)
    for axes in both:
        axes.set(title="late\nin two lines", xlabel="late\nlabel")
    assert figure.dpi == fresh.dpi and plot.png(figure, 90) == plot.png(fresh, 90)
