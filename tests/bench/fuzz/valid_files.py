# SPDX-License-Identifier: GPL-3.0-or-later
"""A valid file for every reader: each function makes one in a folder and gives it with the call that reads it."""

import json
import os
from pathlib import Path

import numpy as np
import scipy.io
import yaml
from gr_cast import scenario as sc
from gr_cast.comparing import responses, series
from gr_cast.core import documents
from gr_cast.experiments.cellular import stack
from gr_cast.experiments.traffic import flows, log
from gr_cast.scenario import colosseum, mat_file, yaml_file, zarr_file
from gr_cast.scenario.create import mesh_files, osm, p2m, pipeline, spec
from gr_cast.signals import recording
from gr_cast.sounding import calibration, collect
from gr_cast.twin import document as twin
from gr_cast.twin.places import document as places


def _yaml(folder: Path, name: str, document) -> Path:
    path = folder / name
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def _json(folder: Path, name: str, document) -> Path:
    path = folder / name
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def _samples() -> np.ndarray:
    return np.exp(1j * np.arange(64)).astype(np.complex64)


def twin_yaml(folder):
    recording.write(folder / "wave", _samples(), sample_rate_hz=1e6)
    entries = [
        ("carrier_frequency_offset", "rx", "rx1", {"offset_hz": {"value": 100.0, "std": 1.0}}, {"at": "rx"}),
        ("extra_path", "link", "tx1>rx1", {"delay_s": 1e-6, "gain_db": {"per_recording": {"r1": {"value": -9.0, "std": 1}}}}, {}),
        ("front_end_filter", "rx", "rx1", {"ripple_db": 1.0}, {"side": "rx", "low": -1, "taps": [0.1, 0.0, 0.0, 0.1]}),
        ("second_transmitter", "environment", "environment", {"code": "w2", "gain_db": -20.0, "delay_s": 0.0}, {}),
        ("pa_nonlinearity", "tx", "tx1", {"compression_db": 1.0, "memory": False}, {"orders": [1], "coefficients": [-0.1, 0.0]}),
        ("phase_noise", "rx", "rx1", {"rms_rad": 0.1}, {"law": "held", "corner_hz": 1e3, "gain_db": {"r1": -3.0}}),
    ]
    document = {
        "cast_twin": 1, "sample_rate_hz": 1e6, "center_frequency_hz": 1e9, "unknown": ["delay", "phase", "gain"],
        "waveforms": {
            "w1": {"file": "wave", "repeat": True},
            "w2": {"code": "glfsr", "degree": 8, "mask": 0, "seed": 1, "samples_per_chip": 1},
            "w3": {"code": "zadoff_chu", "length": 63, "root": 5},
        },
        "nodes": {"tx1": {"transmit": "w1", "amplitude": 1.0}, "rx1": {}},
        "links": [{"tx": "tx1", "rx": "rx1", "taps": [{"delay_s": 0.0, "gain_db": -3.0, "phase_rad": 0.1, "doppler_hz": 5.0}]}],
        "recordings": [{"file": "r1", "receiver": "rx1", "transmitters": ["tx1"], "amplitude": {"tx1": 0.5}}],
        "noise": {"rx1": {"power_db": -40.0}},
        "effects": [
            {"family": family, "owner": {"level": level, "name": name}, "parameters": parameters, "model": model}
            for family, level, name, parameters, model in entries
        ],
    }  # fmt: skip
    return _yaml(folder, "twin.yaml", document), twin.read_twin


def scenario_yaml(folder):
    document = {
        "cast_scenario": 1, "name": "x", "description": "d", "center_frequency_hz": 1e9, "duration_s": 0.1, "update_s": 1e-3,
        "interpolation": "hold", "reciprocal": True, "base_loss_db": 57.5,
        "nodes": {"a": {"position_m": [0, 0, 1]}, "b": {}, "c": {}},
        "all_links": {"taps": [{"delay_s": 1e-6, "gain_db": -3, "phase_rad": 1, "doppler_hz": 7}]},
        "links": [{"tx": "a", "rx": "b", "base_loss_db": 3, "taps": [{"delay_s": 0.0, "gain_db": 0.0}]}],
    }  # fmt: skip
    return _yaml(folder, "scenario.yaml", document), yaml_file.read


def spec_yaml(folder):
    (folder / "room.obj").write_text("v 0 0 0\n")
    document = {
        "cast_create": 1, "id": "room", "name": "Room", "description": "d",
        "materials": {"wall": "concrete", "*": {"permittivity": 3.0, "thickness_m": 0.1}, "x": {"material": "wood"}},
        "environment": {"place": "here", "carrier_hz": 2.4e9, "bandwidth_hz": 80e6, "area_m": [0, 0, 9, 9]},
        "model": {"mesh": "room.obj"},
        "sampling": {"duration_s": 1.0, "step_s": 0.03, "max_depth": 3, "rays": 1000, "refraction": False, "check_instants": 2},
        "approximation": {"method": "kmeans", "update_s": 1e-3, "hold_s": 1.0, "dynamic_range_db": 43},
        "nodes": {
            "a": {"position_m": [1, 1, 1], "antenna": "iso", "power_dbm": 20, "orientation_rad": [0.1, 0, 0]},
            "b": {"waypoints_m": [[1, 2, 1], [3, 2, 1]], "speed_m_per_s": 1.0},
        },
        "node_grids": [{"prefix": "n", "origin_m": [0, 0, 1], "count": [2, 2], "spacing_m": [1, 1]}],
        "effects": [
            {"family": "node_gain", "owner": {"level": "link", "name": "a>b"}, "parameters": {"error_db": {"value": 1}}},
            {"family": "node_position", "owner": {"level": "node", "name": "a"}, "parameters": {"offset_m": [0.1, 0, 0]}},
        ],
    }  # fmt: skip
    return _yaml(folder, "spec.yaml", document), spec.read


def flows_yaml(folder):
    flow = {"from": "a", "to": "b", "pattern": "poisson", "rate_pps": 100, "size_bytes": 500, "start_s": 0, "stop_s": 5}
    burst = flow | {"name": "x", "from": "b", "to": "a", "pattern": "burst", "every_s": 1, "length_s": 0.5}
    return _yaml(folder, "flows.yaml", {"cast_traffic": 1, "duration_s": 10, "flows": [flow, burst]}), flows.read


def series_json(folder):
    return _json(folder, "s.json", {"time_s": [0, 1, 2.5], "value": [1, None, 3.5], "more": ["a"]}), series.read


def series_rows(folder):
    return _json(folder, "rows.json", [{"time_s": k, "value": 1.5 * k} for k in range(5)]), series.read


def series_csv(folder):
    path = folder / "s.csv"
    path.write_text("time_s,value,more\n0,1.5,a\n1,,b\n2.5,3e1,c\n")
    return path, series.read


def result_json(folder):
    taps = [{"delay_s": 0.0, "gain_db": -3.0, "std": 0.1}, {"delay_s": 1e-6, "gain_db": -9.0}]
    return _json(folder, "result.json", {"cast_sounding": 1, "taps": taps}), responses.from_sounding


def collected_json(folder):
    tap = dict(delay_s=1e-7, gain_db=-40.0, phase_rad=0.3, delay_std_s=1e-11, gain_std_db=0.01, phase_std_rad=1e-3)
    document = {
        "cast_sounding": 1, "transmitter": "a", "receiver": "b", "begins_s": 1.5, "band_hz": 8e7, "set_up_db": 3.0,
        "smallest_detectable_gain_db": -80.0, "taps": [tap, tap],
    }  # fmt: skip
    return _json(folder, "result.json", document), collect.read


def calibration_json(folder):
    path = folder / "hall" / "v1.json"
    path.parent.mkdir(exist_ok=True)
    losses = {"a>b": 57.5, "b>a": 57.0}
    _json(
        path.parent,
        path.name,
        {"cast_calibration": 1, "name": "hall", "version": 1, "base_loss_db": losses, "base_delay_s": {"a>b": 1e-7}},
    )
    os.environ["CAST_CALIBRATIONS"] = str(folder)
    return path, lambda _: calibration.load("hall")


def radio_map(folder):
    radio = {"SRN": 1, "RadioA": 1, "RadioB": 2}
    return _json(folder, "radios.json", {"Node 1": radio, "Node 5": "None"}), colosseum.read_radio_map


def node_map(folder):
    return _json(folder, "nodes.json", {"1": 1, "2": 45}), colosseum.read_node_map


def sigmf(folder):
    annotations = [{"core:sample_start": 3, "core:sample_count": 2, "core:comment": "x"}]
    recording.write(folder / "r", _samples(), sample_rate_hz=1e6, center_frequency_hz=1e9, annotations=annotations)
    return folder / "r.sigmf-meta", recording.read


def iperf3(folder):
    sums = [{"sum": {"start": k, "end": k + 1.0, "seconds": 1.0, "bytes": 9, "bits_per_second": 4e6}} for k in range(3)]
    document = {"start": {}, "intervals": sums, "server_output_json": {"intervals": sums}}
    return _json(folder, "iperf3.json", document), stack.read_iperf3


def _metrics(folder, head, row):
    path = folder / "metrics.csv"
    path.write_text(head + "\n" + "".join(row.format(t=k) + "\n" for k in range(4)) + "#eof\n")
    return path


def terminal_metrics(folder):
    return _metrics(folder, "time;cc;rsrp;dl_snr;dl_brate;ul_ta", "{t}000;0;-80;21.5;4e6;0"), stack.read_terminal_metrics


def station_metrics(folder):
    return _metrics(folder, "time;nof_ue;dl_brate;ul_brate", "{t}.0;1;4e6;1e5"), stack.read_station_metrics


def mgen(folder):
    flow = flows.Flow(
        number=1, name="x", source="a", destination="b", pattern="periodic", rate_pps=9, size_bytes=99, start_s=0, stop_s=5
    )  # fmt: skip
    traffic = flows.Traffic(duration_s=5.0, flows=(flow,))
    other = folder / "b.log"
    other.write_text("12:00:00.000001 START Mgen Version 5.1.1\n12:00:02.2 RECV proto>UDP flow>1 seq>0 src>10.45.0.1/5001\n")
    path = folder / "a.log"
    lines = [f"12:00:0{k}.123456 SEND proto>UDP flow>1 seq>{k} srcPort>5001 dst>10.45.0.2/5000 size>99" for k in range(1, 5)]
    path.write_text("\n".join(["12:00:00.000000 START Mgen Version 5.1.1", "12:00:00.1 LISTEN proto>UDP port>5000", *lines, ""]))
    return path, lambda path: [log.row(found) for found in log.evaluate(traffic, {"a": path, "b": other})]


def _scenario(instants=3):
    gain = 0.1j * np.arange(1, 2 * instants + 1).reshape(instants, 2)
    moving = sc.LinkTaps(delay_s=np.full((instants, 2), 1e-7), gain=gain)
    links = {("1", "2"): moving, ("2", "1"): sc.LinkTaps(delay_s=[[0.0]], gain=[[0.5]])}
    return sc.Scenario(name="x", nodes=("1", "2"), links=links, time_s=np.arange(instants) * 1.0)


def mat(folder):
    colosseum.write(folder / "x.mat", _scenario())
    return folder / "x.mat", colosseum.read


def mat_unpacked(folder):
    scipy.io.savemat(folder / "u.mat", {"chMatrix": -np.ones((2, 2)), "time": [[0.0]], "origin": {"long": 1.0, "lat": 2.0}})
    return folder / "u.mat", lambda path: (mat_file.read(path), colosseum.read(path))


def _zarr(folder, *inside):
    if not (folder / "x.zarr").exists():
        zarr_file.write(folder / "x.zarr", _scenario())
    return (folder / "x.zarr").joinpath(*inside), lambda _: zarr_file.read(folder / "x.zarr")


def zarr_attributes(folder):
    return _zarr(folder, ".zattrs")


def zarr_array(folder):
    return _zarr(folder, "moving_gain", ".zarray")


def zarr_chunk(folder):
    return _zarr(folder, "moving_gain", "0.0.0")


def steps_json(folder):
    entry = {"fingerprint": "ab", "result": "model/x.npz", "seconds": 1.0, "peak_mib": 9, "summary": {"faces": 3}}
    return _json(folder, "steps.json", {"model": entry, "nodes": entry}), lambda path: pipeline._read_record(path.parent)


def request(folder):
    command = {"command": "set_link", "tx": "a", "rx": "b", "taps": [{"delay_s": 0.0, "gain_db": -3.0}]}

    def read(path):
        get = documents.json_text(path.read_bytes(), "command")
        get.faults.raise_if_any()

    return _json(folder, "command.json", command), read


def _text(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def paths_p2m(folder):
    text = "# points\n 2\n1 2\n1 90.0 2.0e-07 -50.0\n2 -45.0 5.0e-07 -60.0\n2 0\n"
    return _text(folder, "x.cir.t001_01.r002.p2m", text), lambda path: p2m.read(path, tx_power_dbm=0.0)


CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
FACES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))


def mesh_obj(folder):
    corners = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    faces = [f"f {a + 1} {b + 1}/1 {c - 4}" for a, b, c in FACES]
    return _text(folder, "x.obj", "\n".join(["o wall", "usemtl brick", *corners, *faces])), mesh_files.read


def mesh_ply(folder):
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [f"{x} {y} {z}" for x, y, z in CORNERS] + [f"3 {a} {b} {c}" for a, b, c in FACES]
    return _text(folder, "x.ply", head + "\n".join(rows)), mesh_files.read


def mesh_binary_ply(folder):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    body = np.array(CORNERS, "<f4").tobytes() + b"".join(b"\3" + np.array(face, "<i4").tobytes() for face in FACES)
    (folder / "x.ply").write_bytes(head.encode() + body)
    return folder / "x.ply", mesh_files.read


def mesh_stl(folder):
    row = np.zeros(4, np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]))
    row["v"] = np.array(CORNERS, float)[np.array(FACES)]
    (folder / "x.stl").write_bytes(b"\0" * 80 + np.uint32(4).tobytes() + row.tobytes())
    return folder / "x.stl", mesh_files.read


def mesh_dae(folder):
    floats = " ".join(str(x) for corner in CORNERS for x in corner)
    faces = " ".join(str(x) for face in FACES for x in face)
    text = f"""<COLLADA><asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array count="12">{floats}</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="m" count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>{faces}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene><node id="n" name="n"><translate>0 0 1</translate><rotate>0 0 1 90</rotate>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes></COLLADA>"""
    return _text(folder, "x.dae", text), mesh_files.read


def map_osm(folder):
    corners = ((7.0, 50.0), (7.001, 50.0), (7.001, 50.001), (7.0, 50.001))
    nodes = "\n".join(f'<node id="{k}" lon="{lon}" lat="{lat}"/>' for k, (lon, lat) in enumerate(corners, 1))
    way = "\n".join(f'<nd ref="{k}"/>' for k in (1, 2, 3, 4, 1))
    text = f"""<osm version="0.6"><bounds minlat="50" minlon="7" maxlat="50.001" maxlon="7.001"/>
{nodes}
<way id="1">{way}
<tag k="building" v="yes"/>
<tag k="height" v="9 m"/><tag k="building:levels" v="3"/></way></osm>"""
    return _text(folder, "x.osm", text), osm.read


def _place(folder, name):
    floor = "o floor\nv 0 0 0\nv 9 0 0\nv 9 9 0\nf 1 2 3\n"
    (folder / "room.obj").write_text(floor)
    spec_document = {
        "cast_create": 1, "environment": {"carrier_hz": 5e9, "bandwidth_hz": 2e8}, "model": {"mesh": "room.obj"},
        "materials": {"*": "wood"}, "nodes": {"a": {"position_m": [1, 1, 1]}, "b": {"position_m": [2, 2, 1]}},
    }  # fmt: skip
    _yaml(folder, "spec.yaml", spec_document)
    campaigns = [{"file": "one.npz", "kind": "response"}, {"file": "two.npz", "kind": "power", "use": "vault"}]
    document = {"cast_place": 1, "twin": "spec.yaml", "soundings": campaigns, "unknown": {"phase": "link"}}
    _yaml(folder, "place.yaml", document | {"limits": {"max_range_m": 100}})
    link = dict(tx=np.array(["a"]), rx=np.array(["b"]), time_s=np.arange(2.0))
    response = np.full((1, 2, 4), 1 + 1j, np.complex64)
    np.savez(folder / "one.npz", **link, frequency_hz=np.arange(4.0), response=response, noise_power=np.array([1e-9]))
    power = dict(power_db=np.full((1, 2), -60.0), std_db=np.ones(1), limits_db=np.array([-100.0, -20.0]))
    np.savez_compressed(folder / "two.npz", **link, **power, position_b=np.zeros((2, 3)))
    return folder / name, lambda path: places.read(path.parent)


def place_yaml(folder):
    return _place(folder, "place.yaml")


def place_response(folder):
    return _place(folder, "one.npz")


def place_power(folder):
    return _place(folder, "two.npz")


READERS = (
    twin_yaml, scenario_yaml, spec_yaml, flows_yaml, series_json, series_rows, series_csv, result_json, calibration_json,
    radio_map, node_map, sigmf, iperf3, terminal_metrics, station_metrics, mgen, mat, mat_unpacked, zarr_attributes, zarr_array,
    zarr_chunk, steps_json, request, paths_p2m, mesh_obj, mesh_ply, mesh_binary_ply, mesh_stl, mesh_dae, map_osm,
    place_yaml, place_response, place_power, collected_json,
)  # fmt: skip
