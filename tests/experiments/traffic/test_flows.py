# SPDX-License-Identifier: GPL-3.0-or-later
"""Flows to scripts, and MGEN's logs to figures, without running MGEN."""

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.experiments.traffic import flows, log

HEAD = "cast_traffic: 1\nduration_s: 4\nflows:\n"


def read(tmp_path, text):
    path = tmp_path / "flows.yaml"
    path.write_text(text)
    return flows.read(path)


def test_every_pattern_becomes_its_line_of_a_script(tmp_path):
    traffic = read(tmp_path, HEAD + (
        "  - {from: a, to: b, pattern: poisson, rate_pps: 50, size_bytes: 128}\n"
        "  - {from: a, to: c, pattern: periodic, rate_pps: 2.5, size_bytes: 64, start_s: 1, stop_s: 3}\n"
        "  - {from: b, to: a, pattern: burst, rate_pps: 10, size_bytes: 28, every_s: 2, length_s: 0.5}\n"
    ))  # fmt: skip
    assert traffic.nodes == ("a", "b", "c")
    assert flows.script(traffic, "a").splitlines()[1:] == [
        "0.0 LISTEN UDP 5000",
        "1 ON 1 UDP SRC 5001 DST 10.45.0.2/5000 POISSON [50 128]",
        "5 OFF 1",
        "2 ON 2 UDP SRC 5002 DST 10.45.0.3/5000 PERIODIC [2.5 64]",
        "4 OFF 2",
    ]
    assert "1 ON 3 UDP SRC 5003 DST 10.45.0.1/5000 BURST [REGULAR 2 PERIODIC [10 28] FIXED 0.5]" in flows.script(traffic, "b")
    assert flows.script(traffic, "c").splitlines()[1:] == ["0.0 LISTEN UDP 5000"]
    assert flows.stretched(traffic, 8).flows[1].stop_s == 6


@pytest.mark.parametrize("path", sorted(flows.examples_folder().glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_flows_are_read(path):
    assert flows.read(path.stem).flows


def test_all_faults_are_told_at_once_with_their_places(tmp_path):
    with pytest.raises(CastError) as error:
        read(tmp_path, HEAD + (
            "  - {from: a, to: a, pattern: often, rate_pps: 0, size_bytes: 27}\n"
            "  - {from: a, to: 'b c', pattern: poisson, rate_pps: .nan, size_bytes: 30.5, every_s: 1, colour: red}\n"
            "  - {from: a, to: b, pattern: burst, rate_pps: 1, size_bytes: 99, start_s: 3, stop_s: 2, every_s: 1, length_s: 2}\n"
        ))  # fmt: skip
    text = str(error.value)
    for part in ("goes from 'a' to itself", "'often'", "flows[0].rate_pps", "flows[0].size_bytes", "'b c'", "flows[1].rate_pps",
                 "30.5", "belongs to bursts", "colour", "stops at 2.0 s", "overlap"):  # fmt: skip
        assert part in text, part
    for text in ("duration_s: 4\nflows: []\n", "cast_traffic: 2\nduration_s: 0\n", "[]", "cast_traffic: 1\nflows: 3\n"):
        with pytest.raises(CastError):
            read(tmp_path, text)


SENDER = """\
{0}.000000 START Mgen Version 5.02b
{1}.100000 ON flow>1 srcPort>5001 dst>10.45.0.2/5000
{1}.100000 SEND proto>UDP flow>1 seq>0 srcPort>5001 dst>10.45.0.2/5000 size>100
{1}.600000 SEND proto>UDP flow>1 seq>1 srcPort>5001 dst>10.45.0.2/5000 size>100
{2}.100000 SEND proto>UDP flow>1 seq>2 srcPort>5001 dst>10.45.0.2/5000 size>100
{2}.600000 SEND proto>UDP flow>1 seq>3 srcPort>5001 dst>10.45.0.2/5000 si"""
RECEIVER = """\
{0}.050000 START Mgen Version 5.02b
{0}.060000 LISTEN proto>UDP port>5000
{1}.110000 RECV proto>UDP flow>1 seq>0 src>10.45.0.1/5001 dst>10.45.0.2/5000 sent>{1}.100000 size>100 gps>INVALID,999.0,999.0,1
{2}.130000 RECV proto>UDP flow>1 seq>2 src>10.45.0.1/5001 dst>10.45.0.2/5000 sent>{2}.100000 size>100 gps>INVALID,999.0,999.0,1
{2}.140000 RECV proto>UDP flow>1 seq>2 src>10.45.0.1/5001 dst>10.45.0.2/5000 sent>{2}.100000 size>100 gps>INVALID,999.0,999.0,1
"""


@pytest.mark.parametrize("seconds", [("12:00:00", "12:00:01", "12:00:02"), ("23:59:59", "00:00:00", "00:00:01")])
def test_logs_say_what_was_lost_and_how_late_the_rest_came(tmp_path, seconds):
    """Also over midnight, and with a last line that a dying sender cut short."""
    traffic = read(tmp_path, HEAD + "  - {from: a, to: b, pattern: periodic, rate_pps: 2, size_bytes: 100, stop_s: 2}\n")
    logs = {"a": tmp_path / "a.log", "b": tmp_path / "b.log"}
    logs["a"].write_text(SENDER.format(*seconds))
    logs["b"].write_text(RECEIVER.format(*seconds))
    (result,) = log.evaluate(traffic, logs)
    np.testing.assert_allclose(result.sent_s, [0.1, 0.6, 1.1], atol=1e-6)
    np.testing.assert_allclose(result.latency_s, [0.01, np.nan, 0.03], atol=1e-6)
    assert (result.sent, result.received, result.duplicates) == (3, 2, 1)
    found = log.series(result, 4.0, 1.0)
    np.testing.assert_allclose(found["throughput_bps"][1], [800, 800, 0, 0])
    np.testing.assert_allclose(found["loss"][1], [0.5, 0, np.nan, np.nan])
    np.testing.assert_allclose(found["latency_s"][1][:2], [0.01, 0.03], atol=1e-6)
    row = log.row(result)
    assert row["throughput_bps"] == 800
    assert row["loss"] == pytest.approx(1 / 3)


def test_logs_that_are_none_are_refused(tmp_path):
    traffic = read(tmp_path, HEAD + "  - {from: a, to: b, pattern: periodic, rate_pps: 2, size_bytes: 100}\n")
    (tmp_path / "a.log").write_text("no log\n")
    with pytest.raises(CastError, match="no such file"):
        log.evaluate(traffic, {"a": tmp_path / "x.log", "b": tmp_path / "x.log"})
    with pytest.raises(CastError, match="not a text log"):
        log.evaluate(traffic, {"a": tmp_path / "a.log", "b": tmp_path / "a.log"})
    with pytest.raises(CastError, match="none of node b"):
        log.evaluate(traffic, {"a": tmp_path / "a.log"} | {"a": _empty(tmp_path)})


def _empty(tmp_path):
    path = tmp_path / "empty.log"
    path.write_text("")
    return path
