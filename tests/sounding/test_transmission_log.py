# SPDX-License-Identifier: GPL-3.0-or-later
import json

import pytest
from gr_cast.core.errors import CastError
from gr_cast.sounding import transmission_log

EVENTS = [
    {"kind": "underrun", "device_time_s": [1_800_000_000, 0.25]},
    {"kind": "late_packet", "device_time_s": None},
    {"kind": "lost_packet", "device_time_s": [1_800_000_001, 0.5]},
]


def log(folder, axis="utc", events=EVENTS, **changes):
    about = {"waveform": "glfsr:8", "sample_rate_hz": 1e6, "center_frequency_hz": 1e9, "time_axis": axis}
    path = folder / "log.json"
    transmission_log.write(path, about, start_s=1_800_000_000.0, samples=10, restarts=0, events=events)
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    return path


def test_every_event_is_read_back(tmp_path):
    assert transmission_log.events(log(tmp_path)) == EVENTS


@pytest.mark.parametrize(
    ("since_s", "left"), [(0.25, EVENTS), (0.26, EVENTS[1:]), (1.5, EVENTS[1:]), (1.51, EVENTS[1:2]), (9.0, EVENTS[1:2])]
)
def test_events_from_a_second_on_are_those_at_it_and_later_and_those_without_a_time(tmp_path, since_s, left):
    assert transmission_log.events(log(tmp_path), 1_800_000_000 + since_s) == left


def test_times_of_a_device_alone_leave_no_event_out(tmp_path):
    assert transmission_log.events(log(tmp_path, "device"), 2e9) == EVENTS


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"cast_transmission": 2}, "cast_transmission"),
        ({"time_axis": "gps"}, "time_axis"),
        ({"other": 1}, "other"),
        ({"events": [EVENTS[0], {"kind": "sleep", "device_time_s": None}]}, r"events\[1\].kind"),
        ({"events": [{"kind": "underrun"}]}, r"events\[0\]"),
        ({"events": [{"kind": "underrun", "device_time_s": [1, "x"]}]}, r"events\[0\].device_time_s"),
    ],
)
def test_a_log_of_another_form_is_refused_with_its_place(tmp_path, changes, says):
    with pytest.raises(CastError, match=says):
        transmission_log.events(log(tmp_path, **changes))
