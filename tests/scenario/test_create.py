# SPDX-License-Identifier: GPL-3.0-or-later
"""The eight steps, with a tracer of one line of sight in the place of the ray tracer."""

import contextlib
import os
import re
import resource
import shutil
import signal
import sys

import _program
import cast_scenario
import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario.create import materials, mesh_files, nodes, osm, paths, pipeline, spec, trace

CARRIER_HZ, C_M_PER_S = 2.4e9, 299_792_458.0
tasks_run = pipeline.tasks.run
SPEC = """
cast_create: 1
id: yard
name: A yard
environment: {carrier_hz: 2.4e9, bandwidth_hz: 20e6}
model: {mesh: yard.obj}
materials: {"*": concrete}
nodes:
  a: {position_m: [0, 0, 5]}
  b: {position_m: [30, 0, 2]}
  w: {waypoints_m: [[5, 9, 1], [20, 9, 1], [20, 20, 1]], speed_m_per_s: 20, power_dbm: 10}
sampling: {duration_s: 1.5, step_s: 0.1, check_instants: 3}
approximation: {hold_s: 0.5}
"""
YARD = "v 0 0 0\nv 40 0 0\nv 40 40 0\nv 0 40 0\no ground\nf 1 2 3 4\n" + "".join(
    f"v {x} {y} {z}\n" for z in (0, 4) for x, y in ((10, 1), (12, 1), (12, 3), (10, 3))
) + "o hut\nf 5 6 7 8\nf 9 10 11 12\nf 5 6 10 9\nf 6 7 11 10\nf 7 8 12 11\nf 8 5 9 12\n"  # fmt: skip


def line_of_sight(solids, settings, task):
    """Free space: one path per pair, of gain wavelength / (4 pi distance)."""
    tx, rx = np.array(task.pairs, np.int32).T
    none = np.full((len(tx), 1), -1)
    delay_s, rates = trace.image_delays(trace.surfaces(solids), none > 0, none, task, tx, rx)
    gain = C_M_PER_S / settings.carrier_hz / (4 * np.pi * delay_s * C_M_PER_S)
    return trace.Traced(
        tx=tx, rx=rx, surfaces=none, delay_s=delay_s, rate_before=rates[0], rate_after=rates[1], gain=gain + 0j
    )  # fmt: skip


@pytest.fixture
def yard(tmp_path, monkeypatch):
    (tmp_path / "yard.obj").write_text(YARD)
    (tmp_path / "yard.yaml").write_text(SPEC)
    monkeypatch.setenv("CAST_CATALOGUE", str(tmp_path / "catalogue"))
    monkeypatch.setenv("CAST_RAYTRACER", str(tmp_path / "none"))
    monkeypatch.setattr(trace, "run", line_of_sight)
    monkeypatch.setattr(trace, "is_installed", lambda: True)
    run_tasks_in(1, monkeypatch)
    return tmp_path


def run_tasks_in(processes, monkeypatch):
    def run_tasks(function, *work, dask=None, **_):
        if function is pipeline._trace_task:  # other processes would not have this tracer
            return tasks_run(function, *work, processes=1)
        return tasks_run(function, *work, dask=dask, processes=processes)

    monkeypatch.setattr(pipeline.tasks, "run", run_tasks)


def run(folder, **about):
    return pipeline.Run(folder=folder, tell=lambda line: None, **about)


def test_what_is_installed_is_free_space_at_every_millisecond(yard):
    record = pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "work"))
    assert list(record) == list(pipeline.STEPS)
    made = sc.load("yard")
    matrix = sc.path_gain_matrix_db(made)[~np.eye(3, dtype=bool)]
    assert made.bandwidth_hz == 20e6
    assert record["install"]["summary"]["path loss dB in 20 MHz"] == f"{-matrix.max():.1f} to {-matrix.min():.1f}"
    assert record["install"]["summary"]["sum of |tap|² over that, dB"] == "{:+.1f} to {:+.1f}".format(*sc.taps_over_band_db(made))
    assert len(made.links) == 6 and made.time_s.size == 1501
    where = spec.read(yard / "yard.yaml").nodes
    for first, second in ((0, 1), (0, 2), (1, 2)):
        a, b = where[first], where[second]
        distance_m = np.linalg.norm(nodes.position_m(a, made.time_s) - nodes.position_m(b, made.time_s), axis=1)
        free_space_db = 20 * np.log10(4 * np.pi * distance_m * CARRIER_HZ / C_M_PER_S)
        assert np.abs(sc.band_power_db(made, (a.name, b.name), 20e6) + free_space_db).max() < 0.2
        taps = made.links[a.name, b.name]
        # In the band's middle the taps add up to the path, whatever its place between them.
        total = np.broadcast_to(np.abs(sc.played_gain(made, (a.name, b.name)).sum(axis=1)), distance_m.shape)
        np.testing.assert_allclose(-20 * np.log10(total), free_space_db, atol=0.2)
        assert np.abs(taps.gain).max() <= 1 + 1e-6 and taps == made.links[b.name, a.name]
    walk_hz = -np.diff(np.unwrap(np.angle(made.links["a", "w"].gain[:400].sum(axis=1)))) * 1000 / (2 * np.pi)
    approach = (nodes.position_m(where[2], made.time_s[:400]) - [0, 0, 5]) @ [20, 0, 0]
    distance_m = np.linalg.norm(nodes.position_m(where[2], made.time_s[:400]) - [0, 0, 5], axis=1)
    np.testing.assert_allclose(walk_hz, (approach / distance_m)[:-1] * CARRIER_HZ / C_M_PER_S, atol=2.0)


@pytest.mark.parametrize("task, count", [("_trace_task", 21), ("_parse_tables", 3), ("_reduce_links", 3)])
def test_a_run_that_is_killed_takes_up_every_finished_task_and_ends_the_same(yard, monkeypatch, task, count):
    """A task in the middle of sampling, parsing or approximation dies; the next run does that one and those after it."""
    monkeypatch.setattr(pipeline, "_LINKS_PER_TASK", 1)
    whole = pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "whole"))
    work, calls, dies_at = getattr(pipeline, task), [], count // 2 + 1

    def dies_midway(*job):
        calls.append(job)
        if len(calls) == dies_at:
            raise KeyboardInterrupt
        return work(*job)

    monkeypatch.setattr(pipeline, task, dies_midway)
    with pytest.raises(KeyboardInterrupt):
        pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "cut"))
    shown = []
    again = run(yard / "cut", progress=lambda *how_far: shown.append(how_far))
    resumed = pipeline.create(spec.read(yard / "yard.yaml"), again)
    step = {"_trace_task": "sampling", "_parse_tables": "parsing", "_reduce_links": "approximation"}[task]
    assert [far for far in shown if far[0] == step] == [(step, done, count) for done in range(dies_at, count + 1)]
    assert len(calls) == count + 1
    assert resumed["install"]["summary"]["sha256"] == whole["install"]["summary"]["sha256"]
    assert resumed["install"]["summary"]["version"] == 1  # the same content is the same version


def dies_at_write(number):
    """Kill this process, as kill -9 does, just before its write of that number: file, folder, renaming or removal."""
    seen = 0

    def watch(event, arguments):
        nonlocal seen
        writes = event == "open" and bool(arguments[2] & (os.O_WRONLY | os.O_RDWR))
        if writes or event in ("os.mkdir", "os.rename", "os.remove", "os.rmdir"):
            seen += 1
            if seen == number:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)


def in_a_process_of_its_own(work) -> bool:
    """Whether `work` came to its end."""
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            work()
            os._exit(0)
        os._exit(1)
    return os.waitpid(child, 0)[1] == 0


def test_killed_at_any_write_and_started_again_it_ends_the_same_and_nothing_half_done_is_seen(yard):
    """The scenario is installed a second time over a first one with another hold, so that old results have to go."""
    short = SPEC.replace("duration_s: 1.5", "duration_s: 0.2")
    (yard / "before.yaml").write_text(short)
    (yard / "after.yaml").write_text(short.replace("step_s: 0.1", "step_s: 0.05"))
    before, after = (spec.read(yard / f"{name}.yaml") for name in ("before", "after"))
    whole = pipeline.create(after, run(yard / "whole"))["install"]["summary"]["sha256"]
    work, catalogue = yard / "work", yard / "catalogue"
    first = pipeline.create(before, run(work))["install"]["summary"]["sha256"]
    number, finished = 1, False
    while not finished:
        pipeline.create(before, run(work))
        finished = in_a_process_of_its_own(lambda number=number: (dies_at_write(number), pipeline.create(after, run(work))))
        if "yard" in sc.catalogue_entries():
            assert pipeline.content_hash(sc.load("yard"))[:12] in (whole, first), f"half a scenario after write {number}"
        assert pipeline.create(after, run(work))["install"]["summary"]["sha256"] == whole, f"killed at write {number}"
        assert not [path for folder in (work, catalogue) for path in folder.rglob(".aside-*")]
        number += int(os.environ.get("CAST_KILL_EVERY", 17))  # 1: at every write, minutes
    assert number > 100


def test_two_workers_make_the_identical_scenario_in_processes_and_on_dask(yard, dask_cluster, monkeypatch):
    one = pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "one"))
    monkeypatch.setattr(pipeline, "_LINKS_PER_TASK", 1)
    run_tasks_in(2, monkeypatch)
    for name, dask in (("processes", None), ("dask", dask_cluster(2))):
        two = pipeline.create(spec.read(yard / "yard.yaml"), run(yard / name, dask=dask))
        assert len(list((yard / name / "parsing").glob("*_*.pickle"))) == 3
        assert (yard / name / "parsing/links.npz").read_bytes() == (yard / "one/parsing/links.npz").read_bytes()
        assert two["parsing"]["summary"] == one["parsing"]["summary"]
        assert two["install"]["summary"]["sha256"] == one["install"]["summary"]["sha256"]


@pytest.mark.parametrize("pairs", [1, 3, 100])
def test_batches_of_pairs_hold_the_same_channels_as_all_of_them(pairs):
    """Tables as a tracer leaves them: rows in any order, pairs that are not at every instant, two rows of one path."""
    rng = np.random.default_rng(5)

    def table(rows):
        tx, rx, surfaces, *columns = rng.integers(0, [[3], [5], [4]] + 4 * [[1000]], (7, rows))
        names = ("delay_s", "rate_before", "rate_after", "gain")
        return trace.Traced(tx=tx, rx=rx + 3, surfaces=surfaces[:, None], **dict(zip(names, columns, strict=True)))

    time_s, tables = np.arange(4.0), [table(rows) for rows in (40, 0, 7, 90)]
    together = paths.by_link(tables, time_s)
    apart = [paths.by_link(batch, time_s) for batch in paths.batches(tables, pairs)]
    assert len(apart) == -(-len(together) // pairs) and all(len(links) <= pairs for links in apart)
    assert [pair for links in apart for pair in links] == sorted(together)
    for pair, link in [item for links in apart for item in links.items()]:
        for name, values in vars(link).items():
            np.testing.assert_array_equal(values, getattr(together[pair], name))


def test_a_second_run_in_the_same_folder_is_refused(yard, monkeypatch):
    def while_it_runs(*job):
        with pytest.raises(CastError, match="another run is at work"):
            pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "work"))
        return line_of_sight(*job)

    monkeypatch.setattr(trace, "run", while_it_runs)
    pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "work"))


def test_what_no_tap_reaches_and_places_without_paths_are_refused_with_their_place(yard, monkeypatch):
    (yard / "far.yaml").write_text(SPEC.replace("[30, 0, 2]", "[1600, 0, 2]"))
    with pytest.raises(CastError, match=r"a>b: at 0 s its first path takes 5\.34 us \(1600 m\), the last tap is at 5\.11 us"):
        pipeline.create(spec.read(yard / "far.yaml"), run(yard / "far"))

    def blocked(*job):
        table = line_of_sight(*job)
        return trace.Traced(**{name: values[:0] for name, values in vars(table).items()})

    monkeypatch.setattr(trace, "run", blocked)
    with pytest.raises(CastError, match="no pair of nodes has a path"):
        pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "work"))
    assert not (yard / "catalogue").exists()


def test_a_changed_section_redoes_its_step_and_what_follows_and_makes_a_new_version(yard):
    pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "work"))
    told = []
    (yard / "yard.yaml").write_text(SPEC.replace("hold_s: 0.5", "hold_s: 0.25"))
    record = pipeline.create(spec.read(yard / "yard.yaml"), pipeline.Run(folder=yard / "work", tell=told.append))
    again = {line.split(":")[0] for line in told if "done before" not in line}
    assert again == {"approximation", "install"} and record["install"]["summary"]["version"] == 2


def test_a_step_alone_stops_there(yard):
    assert list(pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "work"), only="nodes")) == list(pipeline.STEPS[:4])


def command(yard, capsys, *options):
    """Exit status, stdout and lines of stderr of `cast_scenario.py create yard.yaml`, without a ray tracer to go on in."""
    argv = ["create", str(yard / "yard.yaml"), "--work", str(yard / "work"), *options]
    with pytest.raises(SystemExit) as leaves:
        _program.run(lambda: cast_scenario.main(argv))
    said = capsys.readouterr()
    return leaves.value.code, said.out, said.err.splitlines()


def test_a_full_disk_is_one_line_with_its_file_and_leaves_nothing_half_installed(yard, capsys):
    """Every size of file that a run writes is in turn one byte too large: what RLIMIT_FSIZE refuses as a full disk does."""
    (yard / "yard.yaml").write_text(SPEC.replace("duration_s: 1.5", "duration_s: 0.2"))
    whole = pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "whole"))["install"]["summary"]["sha256"]
    written = [path for folder in ("whole", "catalogue") for path in (yard / folder).rglob("*") if path.is_file()]
    sizes = sorted({path.stat().st_size for path in written} - {0})
    assert len(sizes) > 15
    shutil.rmtree(yard / "catalogue")
    for size in sizes[:: max(1, len(sizes) // 12)] + sizes[-1:]:
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size - 1, limits[1]))
        try:
            status, _, lines = command(yard, capsys)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        errors = [
            line
            for line in lines
            if not re.fullmatch(r"((sampling|parsing|approximation): \d+ of \d+(, about \d+ (s|min) left)?)? *", line)
        ]
        assert status == 2 and len(errors) == 1 and errors[0].startswith("error: "), lines
        assert str(yard) in errors[0] and ".aside" not in errors[0] and errors[0].endswith(": File too large")
        assert not list(yard.rglob(".aside-*")) and "yard" not in sc.catalogue_entries()
    assert pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "work"))["install"]["summary"]["sha256"] == whole


HUT_TOP = "f 9 10 11 12\n"


@pytest.mark.parametrize(
    "file, old, new, says",
    [
        ("yaml", "position_m: [0, 0, 5]", "position_m: [11, 2, 1]", "nodes: a: is inside hut at 0 s, [11.0, 2.0, 1.0] m"),
        ("yaml", "[5, 9, 1], [20, 9, 1]", "[5, 2, 1], [20, 2, 1]", "nodes: w: is inside hut at 0.3 s, [11.0, 2.0, 1.0] m"),
        ("yaml", "[30, 0, 2]", "[0, 0, 5.001]", "nodes: a and b: are 0.001 m apart at 0 s, [0.0, 0.0, 5.0] m, limit 0.01 m"),
        ("yaml", "[30, 0, 2]", "[15, 9, 1]", "nodes: b and w: are 0 m apart at 0.5 s, [15.0, 9.0, 1.0] m, limit 0.01 m"),
        ("yaml", "speed_m_per_s: 20", "speed_m_per_s: 200", "nodes: w: moves 20 m between samples, limit 15 m"),
        ("yaml", "speed_m_per_s: 20, ", "", "node w: speed_m_per_s: got 0.0, a moving node needs way-points and speed"),
        ("yaml", "position_m: [30, 0, 2]", "position_m: [30, 0, 40 ft]", "nodes.b.position_m: got '40 ft'"),
        ("yaml", "yard.obj", "field.obj", "field.obj: no such file"),
        ("yaml", '{"*": concrete}', "{ground: concrete}", "materials: 1 objects have none: hut"),
        ("yaml", '{"*": concrete}', '{"*": cheese}', "materials.*: got 'cheese', needs one of concrete, brick"),
        ("yaml", "bandwidth_hz: 20e6", "bandwidth_hz: 20 MHz", "environment.bandwidth_hz: got '20 MHz'"),
        ("yaml", "20e6}", "20e6, area_m: [100, 100, 200, 200]}", "environment.area_m: is empty: the model lies from"),
        ("yaml", "20e6}", "20e6, area_m: [9, 9, 2, 2]}", "environment.area_m: is empty: needs west < east"),
        ("yaml", "cast_create: 1", "cast_create: 1\nspeed: 3", "unknown key 'speed'"),
        ("yaml", "id: yard", "id: ../yard", "id: got '../yard', needs letters"),
        ("obj", "v 40 40 0", "v 40 nan 0", "object ground: a coordinate is not finite"),
        ("obj", "v 40 40 0", "v 40 40", "yard.obj: line 3: got '40 40', a vertex needs x, y and z"),
        ("obj", "v 40 40 0", "v 40 4O 0", "yard.obj: line 3: got '40 4O 0', a vertex needs x, y and z"),
        ("obj", HUT_TOP, "f 9 10 99 12\n", "yard.obj: line 17: a face names a vertex that is not there"),
        ("obj", "f 1 2 3 4", "f 1 2 1", "object ground: all its faces are of zero area"),
        ("obj", "f ", "# ", "yard.obj: holds no faces"),
    ],
)
def test_bad_places_are_refused_by_one_line_with_their_place_and_nothing_is_installed(yard, capsys, file, old, new, says):
    path = yard / f"yard.{file}"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    status, _, lines = command(yard, capsys)
    assert status == 2 and len(lines) == 1 and lines[0].startswith("error: ") and says in lines[0], lines
    assert not (yard / "catalogue").exists()


def test_an_object_that_is_not_closed_is_named_with_a_place_where_it_is_open(yard, capsys):
    (yard / "yard.obj").write_text(YARD.replace(HUT_TOP, ""))
    status, out, lines = command(yard, capsys, "--until", "nodes")
    assert status == 0 and not lines and "flat sheets 1, open hulls hut (4 open edges, one at [" in out
    (yard / "yard.obj").write_text(YARD)
    assert "flat sheets 1, open hulls none" in command(yard, capsys, "--until", "nodes")[1]


def test_a_room_that_is_one_closed_object_holds_its_nodes_and_a_wall_does_not(yard, capsys):
    corners = [(x, y, z) for z in (-1, 9) for x, y in ((-5, -5), (45, -5), (45, 45), (-5, 45))]
    faces = ("13 14 15 16", "17 18 19 20", "13 14 18 17", "14 15 19 18", "15 16 20 19", "16 13 17 20")
    room = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "o room\n" + "".join(f"f {face}\n" for face in faces)
    (yard / "yard.obj").write_text(YARD + room)
    status, out, _ = command(yard, capsys, "--until", "nodes")
    assert status == 0 and "all inside room" in out
    (yard / "yard.yaml").write_text(SPEC.replace("[30, 0, 2]", "[60, 0, 2]"))
    status, _, lines = command(yard, capsys)
    assert status == 2 and [line.split(" at ")[0] for line in lines] == [
        "error: nodes: a: is inside room", "error: nodes: w: is inside room"
    ]  # fmt: skip


def test_the_examples_are_read_and_their_nodes_stand_in_the_open():
    for name, radios in (("arena", 42), ("street", 3)):
        read = spec.read(sc.examples_folder() / f"{name}.yaml")
        assert len(read.nodes) == radios and read.id == name
        solids = mesh_files.read(read.model_path) if name == "arena" else osm.read(read.model_path, area_m=read.area_m)[0]
        materials.assign(solids, read.materials, read.carrier_hz)
        nodes.check(list(read.nodes), solids, np.arange(0, read.duration_s, 0.2), read.step_s)


def test_a_walker_keeps_its_speed_along_its_way_and_stops_at_its_end():
    walker = nodes.Node(name="w", waypoints_m=[[0, 0, 1], [3, 0, 1], [3, 4, 1]], speed_m_per_s=1.0)
    np.testing.assert_allclose(
        nodes.position_m(walker, [0, 1.5, 5.0, 7.0, 99]), [[0, 0, 1], [1.5, 0, 1], [3, 2, 1], [3, 4, 1], [3, 4, 1]]
    )
    np.testing.assert_allclose(nodes.velocity_m_per_s(walker, [3.0], "left"), [[1, 0, 0]])
    np.testing.assert_allclose(nodes.velocity_m_per_s(walker, [3.0], "right"), [[0, 1, 0]])
    assert not nodes.velocity_m_per_s(walker, [7.0, 9.0], "right").any()
    assert 3.0 in nodes.sampling_times_s([walker], 9.0, 0.7)  # the corner is an instant of its own


def moving_path(time_s, present):
    """One reflection that a receiver at 20 m/s passes at 8 m; exact delay, rate and its cubic's inputs."""
    x = 20.0 * time_s - 10
    length_m = np.hypot(x, 8.0)
    rate = 20.0 * x / length_m / C_M_PER_S
    column = {"delay_s": length_m / C_M_PER_S, "rate_before": rate, "rate_after": rate, "gain": present / length_m + 0j}
    return paths.LinkPaths(time_s=time_s, **{key: value[:, None] for key, value in column.items()})


def test_between_traced_instants_a_path_is_where_it_truly_is():
    traced, fine_s = np.arange(0, 1.01, 0.02), np.arange(0, 1.0, 0.001)
    delay_s, gain = paths.at(moving_path(traced, np.ones(len(traced))), fine_s, CARRIER_HZ)
    truth_m = np.hypot(20 * fine_s - 10, 8.0)
    truth = np.exp(-2j * np.pi * CARRIER_HZ * truth_m / C_M_PER_S) / truth_m
    error = np.abs(gain[:, 0] / truth - 1)
    assert np.median(error) < 10 ** (-50 / 20) and error.max() < 10 ** (-40 / 20)


def test_a_path_that_vanishes_fades_and_keeps_its_doppler():
    traced = np.array([0.0, 0.02, 0.04])
    fine_s = np.linspace(0.02, 0.0399, 50)
    delay_s, gain = paths.at(moving_path(traced, np.array([1.0, 1.0, 0.0])), fine_s, CARRIER_HZ)
    amplitude = np.abs(gain[:, 0])
    np.testing.assert_allclose(amplitude / amplitude[0], 1 - (fine_s - 0.02) / 0.02, atol=1e-6)
    rate = moving_path(traced, np.ones(3)).rate_after[1, 0]
    np.testing.assert_allclose(np.diff(delay_s[:, 0]) / np.diff(fine_s), rate, rtol=1e-6)


def test_effects_are_played_and_a_gain_anew_needs_no_new_sampling(yard):
    def made(text):
        (yard / "yard.yaml").write_text(SPEC + text)
        told = []
        record = pipeline.create(spec.read(yard / "yard.yaml"), pipeline.Run(folder=yard / "work", tell=told.append))
        matrix = sc.path_gain_matrix_db(sc.load("yard"))
        return record, matrix[~np.eye(3, dtype=bool)].reshape(3, 2), told

    before = made("")[1]
    entry = "\n  - {family: %s, owner: {level: %s, name: %s}, parameters: {%s}}"
    record, louder, told = made("effects:" + entry % ("node_gain", "node", "a", "error_db: 4.5"))
    np.testing.assert_allclose(louder - before, [[4.5, 4.5], [4.5, 0], [4.5, 0]], atol=0.02)
    assert "sampling: done before, taken up" in told and record["environment"]["summary"].get("effects played") is None
    person = entry % ("moving_scatterer", "place", "place", "")
    record, lower, _ = made("effects:" + entry % ("carrier", "place", "place", "carrier_hz: 1.2e+9") + person)
    np.testing.assert_allclose(lower - before, 20 * np.log10(2), atol=0.1)  # half the carrier: 6 dB less loss in free space
    assert sc.load("yard").center_frequency_hz == 1.2e9
    assert record["environment"]["summary"]["effects left out"] == "moving_scatterer (place)"


def test_a_band_wider_than_the_grid_is_played_as_far_as_taps_stand_for_it(yard):
    (yard / "yard.yaml").write_text(SPEC.replace("20e6", "400e6"))
    record = pipeline.create(spec.read(yard / "yard.yaml"), run(yard / "work"))
    assert sc.load("yard").bandwidth_hz == 1e8 and record["approximation"]["summary"]["over MHz"] == 100
