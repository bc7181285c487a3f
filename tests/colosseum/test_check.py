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
        ("sleep 2\nsleep 2\nsleep 2", "sleeps of 6 s together"), ("while true; do x=1; done", "while loop without an end"),
        ("until false; do date; done", "until loop without an end"),
        ("spin() { while :; do date; done; }\nspin", "without an end"),
        ("sh /root/spins.sh", "/root/spins.sh:2: while loop without an end"), ("while :; do sleep 1; done", "without an end"),
    ],
)  # fmt: skip
def test_a_call_that_blocks_is_named_with_its_line(tmp_path, line, words):
    files = {"/root/radio.py": "#!/usr/bin/python3\ntime.sleep(constants.LONG)\n", "/root/inner.sh": "#!/bin/sh\n\nsleep 30\n"}
    files |= {"/root/spins.sh": "#!/bin/sh\nwhile true\ndo x=1\ndone\n"}
    found = faults(tmp_path, start=f"#!/bin/sh\n{line}\n", files=files)
    number = 2 + line.count("\n") if "() {" not in line else 2
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


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("echo READY", "prints 'READY', no JSON"), ("echo \"{'STATUS': 'READY'}\"", "in double quotes"),
        ('echo {"STATUS": "READY"}', "prints '{STATUS: READY}', no JSON"), ('printf "STATUS: %s\\n" "$S"', "no JSON"),
        ('if true; then\necho "state $S"; fi', "prints 'state $S', no JSON"),
        ("echo '{\"status\": \"READY\"}'", "without STATUS"),
        ("echo \"{'STATUS': '$S'}\"", "no JSON"), ("echo READY > /tmp/x\nexit 0", "prints nothing"),
    ],
)  # fmt: skip
def test_a_status_that_cannot_be_json_is_named_with_its_line(tmp_path, line, words):
    found = faults(tmp_path, status=f"#!/bin/sh\n{line}\n")
    assert len(found) == 1 and words in found[0] and 'needs {"STATUS": "READY"' in found[0], found
    assert f"{API}/status.sh:{2 + line.count(chr(10))}: " in found[0]


@pytest.mark.parametrize(
    "text",
    [
        "echo '{\"STATUS\": \"READY\", \"INFO\": \"\"}'", 'echo "$S"',
        'echo "{\\"STATUS\\": \\"$S\\", \\"INFO\\": \\"$(date)\\"}"',
        "echo starts >> /logs/x\necho no radio >&2\ncat /root/cast/state", "echo '{'\necho '\"STATUS\": \"READY\"'\necho '}'",
        "echo READY | /root/json", "S=$(echo READY)\n/root/json $S", 'printf \'{"STATUS": "%s", "INFO": ""}\\n\' "$S"',
        "python3 -c 'print(1)'", "{ echo READY; echo x; } | /root/json",
        "report() { echo x; }\ncat /root/cast/state", "/root/json",
    ],
)  # fmt: skip
def test_a_status_that_may_be_json_is_left_alone(tmp_path, text):
    files = {"/root/cast/state": "{}", "/root/json": "#!/bin/sh\nexec cat\n"}
    assert faults(tmp_path, status=f"#!/bin/sh\n{text}\n", files=files) == []


def test_a_python_status_that_prints_a_dictionary_is_named(tmp_path):
    head = "#!/usr/bin/python3\nimport json\n"
    assert faults(tmp_path, status=head + "print(json.dumps({'STATUS': 'READY', 'INFO': ''}))\n") == []
    (found,) = faults(tmp_path, status=head + "print({'STATUS': 'READY', 'INFO': ''})\n")
    assert f"{API}/status.sh:3: prints a dictionary as Python writes it" in found


def test_a_loop_that_ends_is_left_alone(tmp_path):
    start = """#!/bin/sh
    while true; do
      [ -e /root/radio_api/radio.conf ] && break
      exit 1
    done
    while read LINE; do echo $LINE; done < /root/radio_api/radio.conf
    while true; do x=1; done &
    { while :; do date; done; } > /logs/x &
    """.replace("\n    ", "\n")
    assert faults(tmp_path, start=start) == []


@pytest.mark.parametrize(
    "line", ["/root/work &", "nohup /root/work > /logs/w 2>&1 &", "python3 /root/work &", "sh /root/work", "/root/work"]
)
def test_a_program_that_is_not_in_the_image_is_named_where_it_is_run(tmp_path, line):
    (found,) = faults(tmp_path, start=f"#!/bin/sh\n{line}\n")
    assert found == f"x.tar.gz: {API}/start.sh:2: runs /root/work: not in the image, and nothing in it writes it"
    assert faults(tmp_path, start=f"#!/bin/sh\n{line}\n", files={"/root/work": "#!/bin/sh\nexit 0\n"}) == []
    assert faults(tmp_path, start=f"#!/bin/sh\ncp /root/radio_api/radio.conf /root/work\n{line}\n") == []
    asked = faults(tmp_path, start=f"#!/bin/sh\nif [ -x /root/work ]; then\n{line}\nfi\n")
    assert not any("runs /root/work" in fault for fault in asked), "it says itself that it may be missing"


def test_a_program_without_a_run_bit_is_named_where_it_is_run_by_itself(tmp_path):
    files, modes = {"/root/work": "#!/bin/sh\nexit 0\n"}, {"/root/work": 0o644}
    (found,) = faults(tmp_path, start="#!/bin/sh\n/root/work &\n", files=files, modes=modes)
    assert "start.sh:2: runs /root/work: mode 0644: no run bit" in found
    assert faults(tmp_path, start="#!/bin/sh\nsh /root/work\n", files=files, modes=modes) == []


@pytest.mark.parametrize(
    ("metadata", "words"),
    [(None, "metadata.yaml: missing"), (b"architecture: x86_64\n", "creation_date is missing"),
     (b'{"architecture": "x86_64",\n "creation_date": 1}\n', None)],
)  # fmt: skip
def test_an_image_needs_the_metadata_that_lxd_asks_for(tmp_path, monkeypatch, metadata, words):
    if metadata is None:
        monkeypatch.setattr(teams, "_add_metadata", lambda tar: None)
    else:
        monkeypatch.setattr(teams, "METADATA", metadata)
    found = faults(tmp_path)
    assert found == [] if words is None else len(found) == 1 and words in found[0], found


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
