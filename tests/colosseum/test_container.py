# SPDX-License-Identifier: GPL-3.0-or-later
"""A container is gone when it was stopped, whatever LXC does about it."""

import time

import pytest
from gr_cast.colosseum import container


@pytest.mark.parametrize("ends", [True, False], ids=["lxc-stop returns and the container stays", "lxc-stop never returns"])
def test_a_container_that_lxc_does_not_end_is_killed_and_nothing_is_raised(tmp_path, monkeypatch, ends):
    def inside(tool, *_):
        return ["true"] if tool == "lxc-stop" and ends else ["sleep", "60"]

    (tmp_path / "srn").mkdir()
    monkeypatch.setattr(container, "_STOP_S", 0.2)
    one = container.Container("srn", tmp_path, inside)
    one.start()
    begun_s = time.monotonic()
    one.stop()
    assert not one.is_running and time.monotonic() - begun_s < 10
