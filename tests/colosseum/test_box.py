# SPDX-License-Identifier: GPL-3.0-or-later
"""A box of containers as documented: what a script does wrong is named and the job goes on, and nothing is left behind."""

import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
import team as teams
from gr_cast.colosseum import box, host, job, play, session, storage, timeline, unpacked
from gr_cast.colosseum.emulator import Channel
from gr_cast.report.colosseum_page import page

APPS = Path(__file__).resolve().parents[2] / "apps"
KILLS = int(os.environ.get("CAST_KILLS", 2))  # 30 by hand
FORWARD = """#!/bin/sh
echo 1 > /proc/sys/net/ipv4/ip_forward
read ME < /proc/sys/kernel/hostname
OTHER=1; [ "${ME#*srn}" = 001 ] && OTHER=2
ip route add 192.168.10$OTHER.0/24 via 172.30.100.$OTHER dev col0
cat /root/radio_api/radio.conf /root/radio_api/colosseum_config.ini > /logs/config
echo ACTIVE > /tmp/state
"""


def team_with(folder: Path, images: dict[str, dict]) -> Path:
    team = teams.make(folder)
    for name, scripts in images.items():
        teams.write_system(team / "images" / f"{name}.tar", teams.radio_api(**scripts))
    return team


def player(
    folder: Path,
    team: Path,
    images: list[str],
    *,
    traffic: int = 0,
    duration: int = 600,
    least_s: float = 60.0,
    emulator: Path = APPS / "cast_emulator.py",
) -> play.Player:
    document = teams.job_document(len(images)) | {"TrafficScenario": traffic, "Duration": duration}
    for node, image in zip(document["NodeData"], images, strict=True):
        node |= {"ImageName": image, "isGateway": True}
    path = team / "batch" / "job.json"
    path.write_text(json.dumps(document))
    here = storage.storage_of(path, None)
    taken = job.read(path, here)
    clock = timeline.Clock(
        profile=timeline.PROFILES["current"], scale=600, duration_s=duration, least_boot_s=least_s, least_stop_s=least_s
    )
    scenario = play.sc.load(str(taken.rf_scenario))
    changes = play.changes_of(taken, clock.run_s, scenario, Channel(), None)
    output = folder / "out"
    output.mkdir()
    return play.Player(taken, here, clock, Channel(), emulator, output, changes=changes)


def left_behind(folder: Path, name: str) -> list[str]:
    """Whatever of a box is still there, as the system tells it and not the box."""
    place = str(folder / "b" / name)
    found = [f"process {p.parent.name}" for p in Path("/proc").glob("[0-9]*/environ") if mentions(p, place)]
    found += [line for line in Path("/proc/self/mounts").read_text().splitlines() if place in line]
    found += [line for line in Path("/proc/net/unix").read_text().splitlines() if place in line]
    links = subprocess.run(["ip", "-o", "link"], capture_output=True, text=True, check=True).stdout
    found += [line for line in links.splitlines() if ": tr" in line or ": col" in line]
    found += [place] if Path(place).exists() else []
    return found + [str(path) for path in Path("/sys/fs/cgroup").glob(f"**/cast_box/{name}-*")]


def mentions(path: Path, text: str) -> bool:
    try:
        return int(path.parent.name) != os.getpid() and f"CAST_BOX={text}".encode() in path.read_bytes()
    except OSError:
        return False


def test_a_job_is_played_and_its_traffic_passes_through_tr0(boxes):
    if shutil.which("mgen") is None:
        pytest.skip("NO MGEN: apt install mgen")
    team = team_with(boxes, {"wire": {"start": FORWARD}})
    played = player(boxes, team, ["wire", "wire"], traffic=1, duration=1800)
    document = played.run()
    assert document["outcome"] == "played", document["faults"]
    assert [fault for fault in document["faults"] if "no sample" not in fault and "took more than" not in fault] == []
    for node in document["nodes"]:
        assert [state["state"] for state in node["states"]] == ["READY", "ACTIVE", "FINISHED"]
        assert [c["script"] for c in node["calls"]] == ["start.sh", "update_outcomes.sh", "update_environment.sh", "stop.sh"]
    rows = document["traffic"]
    assert len(rows) == 2 and all(row["sent"] > 10 and row["received"] >= row["sent"] - 2 for row in rows)
    config = (boxes / "out" / "team-srn001" / "config").read_text()
    assert "center_frequency = 1000000000" in config and "device_args = driver=zmq" in config
    assert left_behind(boxes, played.box.name) == []


def test_scripts_that_go_wrong_are_named_and_the_job_goes_on(boxes):
    wrong = {
        "hangs": {"start": "#!/bin/sh\nwhile :; do sleep 1; done\n"},
        "fails": {"start": "#!/bin/sh\necho no radio >&2\nexit 7\n"},
        "nojson": {"status": "#!/bin/sh\necho ready\n"},
        "much": {"stop": "#!/bin/sh\nhead -c 300000 /dev/zero\n"},
        "dies": {"start": "#!/bin/sh\nkill -9 $$\n"},
    }
    played = player(boxes, team_with(boxes, wrong), list(wrong), least_s=3.0)
    document = played.run()
    assert document["outcome"] == "played"
    told = "\n".join(document["faults"])
    for words in (
        "team-srn001: start.sh: took more than 5 s: ended", "team-srn002: start.sh: exit status 7, needs 0: no radio",
        "team-srn003: status.sh: printed 'ready', needs JSON", "team-srn003: not READY at 5:00",
        "team-srn004: stop.sh: printed 300000 bytes, limit 65536 bytes", "team-srn005: start.sh: exit status 137",
    ):  # fmt: skip
        assert words in told
    assert all("stop.sh" in [call["script"] for call in node["calls"]] for node in document["nodes"])
    assert left_behind(boxes, played.box.name) == []


def test_a_job_that_ends_before_any_state_is_told_is_reported_all_the_same(boxes):
    team = team_with(boxes, {"wire": {}})
    broken = boxes / "emulator"
    broken.write_text("#!/bin/sh\necho error: none here >&2\nexit 2\n")
    broken.chmod(0o755)
    played = player(boxes, team, ["wire", "wire"], emulator=broken)
    document = played.run()
    assert document["outcome"] == "failed" and any("none here" in fault for fault in document["faults"]), document["faults"]
    assert "none here" in page(document) and left_behind(boxes, played.box.name) == []
    words = [sys.executable, str(APPS / "cast_colosseum.py"), "run", str(team / "batch" / "job.json"), "--time-scale", "600"]
    words += ["--output", str(boxes / "cut"), "--name", "cut"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout.readline() == "containers load and boot\n"
        run.send_signal(signal.SIGINT)
        told, errors = run.communicate(timeout=60)
    assert run.returncode == 130 and "interrupted in" in told and "Traceback" not in errors, errors
    assert (boxes / "cut" / "report.html").is_file() and left_behind(boxes, "cut") == []


def test_an_interrupt_before_the_first_container_leaves_nothing(boxes):
    def say(_):
        raise KeyboardInterrupt

    played = player(boxes, team_with(boxes, {"wire": {}}), ["wire"])
    played.say = say
    assert played.run()["outcome"] == "interrupted" and left_behind(boxes, played.box.name) == []


def test_a_container_has_its_names_and_no_more_than_it_needs(boxes):
    team = team_with(boxes, {"wire": {}})
    here = storage.Storage(folder=team)
    srns = [box.Srn(number=n, image=here.images()["wire"]) for n in (1, 2)]
    with box.Box("names", here, srns, Channel(), APPS / "cast_emulator.py", interactive=True) as made:
        with pytest.raises(Exception, match="there is one of that name"):
            box.Box("names", here, srns, Channel(), APPS / "cast_emulator.py", interactive=True)
        first = made.containers[1]
        assert first.run("/bin/cat", "/proc/sys/kernel/hostname") == "team-srn001\n"
        told = first.run("/bin/ip", "address")
        assert "192.168.101.1/24" in told and "02:10:c0:a8:65:01" in told and "col0" in told
        assert "192.168.101.77 dev tr0 lladdr 02:10:c0:a8:65:4d PERMANENT" in first.run("/bin/ip", "neigh")
        capabilities = int(
            first.run("/bin/sh", "-c", "while read a b; do [ $a = CapEff: ] && echo $b; done < /proc/self/status; true"), 16
        )
        assert capabilities and not capabilities & (1 << 21 | 1 << 16 | 1 << 25 | 1 << 27)  # mounts, modules, the clock, devices
        ended = threading.Event()
        kept = session.Session(made)
        thread = threading.Thread(target=kept.run, args=(ended,))
        thread.start()
        path = made.place(2, "socket", "clisocket")
        while not path.exists():
            time.sleep(0.05)
        assert first.run("/bin/ls", "/socket", "/share/nas/team").split() == [
            "/share/nas/team:", "batch", "config", "images", "/socket:", "clisocket"
        ]  # fmt: skip
        assert ask(path, command="rf_scenario_start", scenario_id=1009, scenario_cycle=True)["status"] == 100
        until_s = time.monotonic() + 20
        while made.emulator.status()["scenario"] != "All paths 0 dB" and time.monotonic() < until_s:
            time.sleep(0.1)
        assert made.emulator.status()["scenario"] == "All paths 0 dB"
        assert ask(path, command="snapshot", filename="mine")["status"] == 200
        images = "/share/nas/team/images"
        assert ask(path, command="snapshot", filename="other", path=f"{images}/here")["status"] == 200
        (team / "images" / "out").symlink_to(boxes)
        assert ask(path, command="snapshot", filename="out", path=f"{images}/out")["status"] == 200
        while not (team / "images" / "here" / "other.tar.gz").exists() and time.monotonic() < until_s + 40:
            time.sleep(0.1)
        assert (team / "images" / "here" / "other.tar.gz").exists() and not (boxes / "out.tar.gz").exists()
        while not (team / "images" / "mine.tar.gz").exists() and time.monotonic() < until_s + 20:
            time.sleep(0.1)
        assert ask(path, command="rf_scenario_stop")["status"] == 200
        assert made.emulator.status()["scenario"] == "cleared"
        ended.set()
        thread.join()
    from gr_cast.colosseum import image

    taken = image.read(team / "images" / "mine.tar.gz")
    assert "/root/radio_api/start.sh" in taken.entries and taken.metadata_faults == []
    assert left_behind(boxes, "names") == []


def test_an_interactive_container_gets_the_configuration_that_up_names(boxes):
    here = storage.Storage(folder=team_with(boxes, {"wire": {}}))
    ended = threading.Event()
    srns = [box.Srn(number=1, image=here.images()["wire"])]
    with box.Box("conf", here, srns, Channel(), APPS / "cast_emulator.py", interactive=True) as made:
        thread = threading.Thread(target=session.Session(made, config=b'{"nodes": 4}').run, args=(ended,))
        thread.start()
        until_s = time.monotonic() + 30
        while not box.state_of(made.folder).get("ready") and time.monotonic() < until_s:
            time.sleep(0.1)
        assert made.containers[1].run("/bin/cat", "/root/radio_api/radio.conf") == '{"nodes": 4}'
        ended.set()
        thread.join()


def test_up_of_a_box_that_is_up_starts_nothing_and_says_so_or_is_refused(boxes):
    team = team_with(boxes, {"wire": {}, "other": {}})

    def up(name="again", **options):
        told = {"srns": 1, "image": "wire", "team": team} | options
        words = [str(word) for key, value in told.items() for word in (f"--{key.replace('_', '-')}", value)]
        program = [sys.executable, str(APPS / "cast_colosseum.py"), "up", "--name", name]
        return subprocess.run([*program, *words], capture_output=True, text=True, check=False)

    (boxes / "conf").write_text("mine")
    try:
        assert up().stdout.startswith("again: team-srn001\n")
        pid = box.state_of(box.boxes()["again"])["pid"]
        same = up()
        assert (same.returncode, same.stdout, same.stderr) == (0, "again: was already up: team-srn001\n", "")
        for option, value in (
            ("config", boxes / "conf"),
            ("srns", 2),
            ("image", "other"),
            ("scenario", 1009),
            ("base_loss", 50),
            ("time_scale", 2),
        ):
            other = up(**{option: value})
            assert other.returncode == 2 and other.stdout == "" and len(other.stderr.splitlines()) == 1, option
            assert other.stderr.startswith(f"error: again: is up already, with --{option.replace('_', '-')} ")
            assert "None" not in other.stderr
        assert box.state_of(box.boxes()["again"])["pid"] == pid and list(box.boxes()) == ["again"]
        os.kill(pid, signal.SIGKILL)
        while host.started_at(pid):
            time.sleep(0.05)
        killed = up()
        assert killed.returncode == 2 and "its runner was killed" in killed.stderr and "down again" in killed.stderr
    finally:
        box.remove("again", boxes / "b" / "again")
    assert left_behind(boxes, "again") == []


def test_a_box_is_listed_until_it_is_down_and_unpacked_images_go_with_the_last(boxes):
    team, images = team_with(boxes, {"wire": {}, "other": {"stop": "#!/bin/sh\n"}}), boxes / "b" / "images"

    def colosseum(*words) -> str:
        done = subprocess.run(
            [sys.executable, str(APPS / "cast_colosseum.py"), *map(str, words)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    try:
        for name, image in (("one", "wire"), ("two", "other")):
            colosseum("up", "--srns", 1, "--image", image, "--scenario", 1009, "--team", team, "--name", name)
        words = [sys.executable, str(APPS / "cast_colosseum.py"), "enter", "one"]
        for more, status, line in (
            ([], 2, "error: one: got no container, needs one of team-srn001"),
            (["team-srn009"], 2, "error: one: got team-srn009, needs one of team-srn001"),
            (["team-srn001", "nosuchcmd", "x"], 127, "error: nosuchcmd: no such command in team-srn001"),
            (["team-srn001", "sh", "-c", "exit 3"], 3, ""),
        ):
            done = subprocess.run([*words, *more], capture_output=True, text=True, check=False)
            assert (done.returncode, done.stderr.strip()) == (status, line)
        told = colosseum("list").splitlines()
        assert [line.split()[:3] for line in told[:2]] == [["one", "up:", "team-srn001;"], ["two", "up:", "team-srn001;"]]
        assert "wire.tar, scenario 1009" in told[0] and told[2].startswith("unpacked images: 2, ")
        assert "removed" not in colosseum("down", "one") and len(unpacked.kept(images)) == 2, "the other may use them"
        assert unpacked.remove_unused(images) == (0, 0), "nor can anybody else remove them"
        pid = box.state_of(box.boxes()["two"])["pid"]
        os.kill(pid, signal.SIGKILL)
        while host.started_at(pid):
            time.sleep(0.05)
        assert "its runner was killed" in colosseum("list") and "down two" in colosseum("list")
        killed = subprocess.run([*words[:-1], "two", "team-srn001"], capture_output=True, text=True, check=False)
        assert killed.returncode == 2 and killed.stderr.startswith("error: two: its runner was killed: ")
        assert "unpacked images: 2 removed" in colosseum("down") and unpacked.kept(images) == []
        assert colosseum("list") == "no box is up\n"
        for verb in ("enter", "down"):
            gone = subprocess.run([*words[:-2], verb, "two"], capture_output=True, text=True, check=False)
            assert gone.stderr == "error: two: no such box on this machine, which has none\n"
    finally:
        for name, folder in box.boxes().items():
            box.remove(name, folder)


def test_images_that_somebody_holds_stay(tmp_path):
    (tmp_path / "x").mkdir()
    with unpacked.held(tmp_path), unpacked.held(tmp_path):
        assert unpacked.remove_unused(tmp_path) == (0, 0) and unpacked.kept(tmp_path) == [tmp_path / "x"]
    assert unpacked.remove_unused(tmp_path)[0] == 1 and unpacked.kept(tmp_path) == []


def test_two_boxes_of_one_name_in_two_folders_do_not_meet(boxes):
    here = storage.Storage(folder=team_with(boxes, {"wire": {}}))
    with box.Box("twins", here, [box.Srn(number=1, image=here.images()["wire"])], Channel(), APPS / "cast_emulator.py",
                 interactive=True) as made:  # fmt: skip
        other = boxes / "elsewhere" / "twins"
        other.mkdir(parents=True)
        assert box.remove("twins", other) == ["its files"]
        assert made.containers[1].is_running
        assert made.containers[1].run("/bin/cat", "/proc/sys/kernel/hostname") == "team-srn001\n"
    assert left_behind(boxes, "twins") == []


def ask(socket_path: Path, /, **request) -> dict:
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(socket_path))
        client.sendall(json.dumps({"version": "3.0"} | request).encode())
        return json.loads(client.recv(3276800))


@pytest.mark.timeout(600 + 90 * KILLS)
def test_a_runner_killed_at_any_moment_leaves_nothing_after_down_and_another_box_alone(boxes):
    team = team_with(boxes, {"good": {}})
    (team / "images" / "good.tar.gz").unlink()
    job_file = team / "batch" / "job.json"
    job_file.write_text(json.dumps(teams.job_document(2) | {"TrafficScenario": 1, "Duration": 1800}))
    words = [sys.executable, str(APPS / "cast_colosseum.py")]
    run = [*words, "run", str(job_file), "--output", str(boxes / "out"), "--time-scale", "600", "--name"]

    def colosseum(*more):
        return subprocess.run([*words, *map(str, more)], capture_output=True, text=True, check=False)

    def check_that_it_is_played() -> float:
        """The job, from its first to its last moment: how long it takes here."""
        begun_s = time.monotonic()
        done = subprocess.run([*run, "whole"], capture_output=True, text=True, check=False)
        assert done.stdout.splitlines()[-1].startswith("played in "), done.stdout + done.stderr
        assert left_behind(boxes, "whole") == []
        return time.monotonic() - begun_s

    other = colosseum("up", "--srns", 1, "--image", "good", "--team", team, "--name", "stays")
    assert other.returncode == 0, other.stderr
    before = system_wide()
    whole_s = check_that_it_is_played()
    rng = random.Random(int(os.environ.get("CAST_SEED", 4)))
    for number in range(KILLS):
        name, after_s = f"kill{number}", rng.uniform(0.2 * whole_s, whole_s)  # before that Python has not come to the box
        held = ["up", "--srns", "2", "--scenario", "90003", "--image", "good", "--team", team, "--foreground", "--name", name]
        runner = subprocess.Popen(
            [*run, name] if number % 4 else [*words, *held], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(after_s)
        runner.send_signal(signal.SIGKILL)
        runner.wait()
        done = colosseum("down")
        assert done.returncode == 0 and "stays: is in use" in done.stdout, done.stderr
        found = [line for line in done.stdout.splitlines() if line.startswith(name)]
        print(f"{'run' if number % 4 else 'up'} killed after {after_s:.1f} s (a whole run: {whole_s:.1f} s): {found}")
        assert left_behind(boxes, name) == []
        assert system_wide() == before
    check_that_it_is_played()
    assert colosseum("enter", "stays", "team-srn001", "cat", "/proc/sys/kernel/hostname").stdout == "team-srn001\n"
    assert colosseum("down", "stays").returncode == 0
    assert left_behind(boxes, "stays") == []


def system_wide() -> dict[str, set[str]]:
    """What anything on this machine could leave, whoever it is: interfaces, mounts, named namespaces, their holders."""
    named = Path("/run/netns")
    return {
        "interfaces": {path.name for path in Path("/sys/class/net").iterdir()},
        "mounts": {" ".join(line.split()[:3]) for line in Path("/proc/self/mounts").read_text().splitlines()},
        "named": {path.name for path in named.iterdir()} if named.is_dir() else set(),
        "spaces": {link for path in Path("/proc").glob("[0-9]*/ns/net") if (link := _link(path))},
    }


def _link(path: Path) -> str:
    try:
        return os.readlink(path)
    except OSError:  # it has ended
        return ""
