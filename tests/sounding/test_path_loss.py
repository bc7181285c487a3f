# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.signals.recording import Recording
from gr_cast.sounding import path_loss


@pytest.mark.parametrize(
    ("loss_db", "error_db", "told"),
    [
        ([57.0, 59.0], 0.1, "mean 58.00 dB, SD 1.00 dB over 2 links"),
        ([57.98, 58.02], 0.1, "mean 58.00 dB over 2 links"),
        ([0.001, -0.001], 0.0, "mean 0.00 dB over 2 links"),
        ([58.0], 0.0, "mean 58.00 dB over 1 link"),
    ],
)
def test_an_average_has_a_spread_only_where_links_differ_by_more_than_each_is_uncertain(loss_db, error_db, told):
    assert path_loss.average_text(np.array(loss_db), error_db) == told


def test_losses_of_one_link_are_averaged_in_power_and_nodes_stand_in_natural_order():
    losses_db = {("n10", "n9"): [60.0, None, 63.0], ("n9", "n10"): [None], ("n1", "n10"): [40.0]}
    nodes, matrix = path_loss.loss_matrix(losses_db)
    assert nodes == ["n1", "n9", "n10"]
    mean_db = -10 * np.log10((10**-6.0 + 10**-6.3) / 2)
    expected = [[np.nan, np.nan, 40.0], [np.nan] * 3, [np.nan, mean_db, np.nan]]
    assert matrix == pytest.approx(np.array(expected), nan_ok=True)


def test_a_matrix_as_a_file_and_on_the_screen_says_what_was_not_heard():
    matrix = np.array([[np.nan, 40.04], [-0.04, np.nan]])
    assert path_loss.matrix_csv(["a", "b"], matrix) == "transmitter\\receiver,a,b\na,,40.0400\nb,-0.0400,\n"
    assert [line.split() for line in path_loss.matrix_text(["a", "b"], matrix).split("\n")] == [
        ["tx\\rx", "a", "b"],
        ["a", "–", "40.0"],
        ["b", "0.0", "–"],
    ]
    for other, width in (("a_long_name", 12), ("b", 7)):  # a column is as wide as its longest name, or as -100.0 and a space
        assert {len(line) for line in path_loss.matrix_text(["a", other], matrix).split("\n")} == {3 * width}


@pytest.mark.parametrize(
    ("metadata", "name", "link"),
    [
        ({"cast:transmitter": "a", "cast:receiver": "b"}, "tx3_rx7", ("a", "b")),
        ({"cast:transmitter": "a"}, "x_tx3_rx7", ("3", "7")),
        ({}, "txA-rx7b.sigmf-meta", ("A", "7b")),
    ],
)
def test_a_link_is_that_of_the_metadata_or_else_of_the_name(metadata, name, link):
    file = Recording(samples=np.zeros(1, np.complex64), sample_rate_hz=1e6, metadata=metadata)
    assert path_loss.link_of(file, name) == link
    with pytest.raises(CastError, match="plain: link"):
        path_loss.link_of(Recording(samples=file.samples, sample_rate_hz=1e6), "plain")
