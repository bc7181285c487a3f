# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs of others are watched: what ends too early is told, what has done its work is not."""

import time

import pytest
from gr_cast.core.errors import CastError
from gr_cast.core.processes import Processes


def _ended(folder, command):
    processes = Processes(folder)
    processes.start("other", [command])
    time.sleep(0.3)
    return processes


def test_one_that_ends_too_early_is_named_with_its_status(tmp_path):
    with _ended(tmp_path, "true") as processes, pytest.raises(CastError, match="other: ended after .* with status 0"):
        processes.check()


def test_one_that_may_end_may_only_end_well(tmp_path):
    with _ended(tmp_path / "well", "true") as processes:
        processes.may_end("other")
        processes.check()
    with _ended(tmp_path / "badly", "false") as processes:
        processes.may_end("other")
        with pytest.raises(CastError, match="status 1"):
            processes.check()
