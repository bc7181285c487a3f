# SPDX-License-Identifier: GPL-3.0-or-later
"""What a radio API must not do is told from an image with file and line; what is in order is left alone."""

import io
import sys
import tarfile
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
import team as teams
from gr_cast.colosseum import check
from gr_cast.core.errors import CastError

API = "/root/radio_api"


def faults(tmp_path, *, files=None, modes=None, **scripts):
    return check.faults_of(teams.write_image(tmp_path / "x.tar.gz", teams.radio_api(**scripts) | (files or {}), modes))


def test_a_radio_api_in_order_has_no_fault(tmp_path):
    start = """#!/bin/sh
    # sleep 360 in a comment
    cat > /root/run.sh <<END
    sleep 360
    END
    prepare() { sleep 1; }
    prepare
    (sleep 360; echo done) &
    while true; do sleep 10; done > /logs/loop.log 2>&1 &
    nohup python3 /root/radio.py >> /logs/radio.log 2>&1 &
    [ -f /root/radio_api/radio.conf ] && cp /root/radio_api/radio.conf /logs/
    for i in 1 2 3; do sleep 0.5; done
    timeout 3 ping 192.168.101.2
    echo ACTIVE > /tmp/state
    """.replace("\n    ", "\n")
    assert faults(tmp_path, start=start, files={"/root/radio.py": "import time\ntime.sleep(100)\n"}) == []


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("sleep 360", "sleep 360"), ("sleep 6m", "sleep 6m"), ("nohup sleep 100", "sleep 100"), ("T=90\nsleep $T", "sleep 90"),
        ("sleep infinity", "infinity"), ("until [ -e /logs/x ]; do sleep 1; done", "until loop"),
        ("tail -f /logs/x", "tail runs"),
        ("ping 192.168.101.2", "ping runs"), ("iperf3 -s", "iperf3 runs"), ("mgen input a.mgn", "mgen runs"),
        ("echo x &\nwait", "waits for what line"), ("read ANSWER", "read waits"), ("timeout 60 true", "timeout 60 s"),
        ("python3 /root/radio.py", "/root/radio.py:2 sleeps"), ("/root/radio.py", "/root/radio.py:2 sleeps"),
        ("sh /root/inner.sh", "/root/inner.sh:3: sleep 30"), ("run() { sleep 9; }\nrun", "sleep 9"),
        ("sleep 2\nsleep 2\nsleep 2", "sleeps of 6 s together"),
    ],
)  # fmt: skip
def test_a_call_that_blocks_is_named_with_its_line(tmp_path, line, words):
    files = {"/root/radio.py": "#!/usr/bin/python3\ntime.sleep(constants.LONG)\n", "/root/inner.sh": "#!/bin/sh\n\nsleep 30\n"}
    found = faults(tmp_path, start=f"#!/bin/sh\n{line}\n", files=files)
    number = 2 + line.count("\n") if "run()" not in line else 2
    assert len(found) == 1 and words in found[0]
    assert f"x.tar.gz: {API}/start.sh:{number}: blocks: " in found[0]


@pytest.mark.parametrize(
    ("first", "words"),
    [
        ("# !/bin/sh", "no interpreter line"), ("", "no interpreter line"), ("#!/bin/sh\r", "CR LF"), ("#!sh", "whole path"),
        ("#!/bin/zsh", "interpreter /bin/zsh: not in the image"), ("#!/usr/bin/python3 -u", None),
    ],
)  # fmt: skip
def test_a_first_line_that_no_kernel_runs_is_named(tmp_path, first, words):
    found = faults(tmp_path, stop=f"{first}\nexit 0\n")
    assert found == [] if words is None else any(f"{API}/stop.sh:1: " in line and words in line for line in found)


def test_missing_scripts_and_run_bits_are_named(tmp_path):
    found = faults(tmp_path, update_outcomes=None, modes={f"{API}/start.sh": 0o644})
    assert found == [
        f"x.tar.gz: {API}/start.sh:1: mode 0644: no run bit: chmod 755",
        f"x.tar.gz: {API}/update_outcomes.sh: missing: Colosseum calls it",
    ]


def test_paths_that_nothing_writes_are_named(tmp_path):
    status = '#!/bin/sh\nif [ -e /tmp/LTE_STATE ]; then\nSTATE=$(cat /tmp/LTE_STATE)\nfi\necho "$STATE"\n'
    files = {"/root/rx.py": "sink = file_sink('/root/results/raw/rx_' + str(n) + '.iq')\n"}
    found = faults(tmp_path, status=status, stop="#!/bin/sh\nmv ./*.iq /logs/\ncp -r /root/results /logs/\n", files=files)
    assert found == [
        f"x.tar.gz: {API}/stop.sh:2: {API}/*.iq: nothing in the image writes it",
        f"x.tar.gz: {API}/status.sh:2: /tmp/LTE_STATE: nothing in the image writes it",
        f"x.tar.gz: {API}/status.sh:3: /tmp/LTE_STATE: nothing in the image writes it",
    ]


def test_a_state_that_colosseum_does_not_know_is_named(tmp_path):
    found = faults(tmp_path, status='#!/bin/sh\necho \'{"STATUS": "RUNNING", "INFO": ""}\'\n')
    assert len(found) == 1 and f"{API}/status.sh:2: status 'RUNNING'" in found[0]


def test_an_image_that_leaves_its_folder_or_holds_no_root_is_refused(tmp_path):
    for name, words in (
        ("rootfs/../../etc/passwd", "leaves the image"),
        ("/etc/passwd", "leaves the image"),
        ("etc/x", "no rootfs/"),
    ):
        with tarfile.open(tmp_path / "y.tar", "w") as tar:
            tar.addfile(tarfile.TarInfo(name), io.BytesIO())
        with pytest.raises(CastError, match=words):
            check.faults_of(tmp_path / "y.tar")
    (tmp_path / "z.tar.gz").write_bytes(b"no tarball")
    with pytest.raises(CastError, match="not a tarball"):
        check.faults_of(tmp_path / "z.tar.gz")
