# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
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
