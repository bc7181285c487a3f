# SPDX-License-Identifier: GPL-3.0-or-later
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.signals import recording
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parents[2]
FUZZ = settings(
    max_examples=6000, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


def noise(count, scale=0.3, seed=1):
    random = np.random.default_rng(seed)
    return (scale * (random.standard_normal(count) + 1j * random.standard_normal(count))).astype(np.complex64)


@pytest.mark.parametrize(("datatype", "step"), [("cf32_le", 0.0), ("ci16_le", 2**-15), ("ci8", 2**-7), ("cu8", 2**-7)])
def test_what_was_written_is_read_back_within_half_a_step(tmp_path, datatype, step):
    samples = noise(1000, 0.2)
    recording.write(tmp_path / "x", samples, sample_rate_hz=2e6, datatype=datatype, center_frequency_hz=1e9)
    for path in (tmp_path / "x", tmp_path / "x.sigmf-meta", tmp_path / "x.sigmf-data"):
        back = recording.read(path)
        assert (back.sample_rate_hz, back.center_frequency_hz, back.datatype) == (2e6, 1e9, datatype)
        error = (back.samples - samples).view(np.float32)
        assert np.abs(error).max() <= step / 2 * 1.0001
    assert np.array_equal(recording.read(tmp_path / "x", start=10, count=5).samples, back.samples[10:15])


def test_full_scale_is_as_the_contract_says(tmp_path):
    for name, kind, values, expected in [
        ("ci16", "<i2", [-32768, 16384], -1 + 0.5j),
        ("ci8", "i1", [-128, 64], -1 + 0.5j),
        ("cu8", "u1", [0, 255], (-127.5 + 127.5j) / 128),
    ]:
        np.array(values, kind).tofile(tmp_path / name)
        read = recording.read_raw(tmp_path / name, raw_format=name, sample_rate_hz=1.0)
        assert read.samples.tolist() == [expected]


def test_the_reference_implementation_of_sigmf_accepts_what_is_written(tmp_path):
    python = ROOT / "build" / "tools" / "bin" / "python"
    if not python.exists():
        pytest.skip("NO SIGMF PACKAGE in build/tools: run tests/run.sh once")
    samples = noise(64)
    recording.write(
        tmp_path / "x", samples, sample_rate_hz=1e6, datatype="ci16_le", center_frequency_hz=5e8, fields={"cast:seed": 3},
        captures=[{"core:sample_start": 0, "core:frequency": 5e8}, {"core:sample_start": 40, "cast:lost_samples": 7}],
    )  # fmt: skip
    program = (
        "import sigmf, sys; f = sigmf.fromfile(sys.argv[1]); f.validate();"
        "print(f.get_global_info()['core:sample_rate'], len(f.read_samples()), len(f.get_captures()))"
    )
    told = subprocess.run([python, "-W", "ignore", "-c", program, tmp_path / "x.sigmf-meta"], capture_output=True, text=True)
    assert told.stdout.split() == ["1000000.0", "64", "2"], told.stderr


def test_gaps_are_the_captures_that_tell_of_lost_samples(tmp_path):
    captures = [{"core:sample_start": 0}, {"core:sample_start": 40, "cast:lost_samples": 7}, {"core:sample_start": 50}]
    recording.write(tmp_path / "x", noise(64), sample_rate_hz=1e6, captures=captures)
    assert recording.read(tmp_path / "x").gaps == [(40, 7)]


def written(folder, change=lambda meta: None, data=None):
    stem = recording.write(folder / "x", noise(100), sample_rate_hz=1e6)
    path = recording.meta_path(stem)
    meta = json.loads(path.read_text())
    change(meta)
    path.write_text(json.dumps(meta))
    if data is not None:
        data(recording.data_path(stem))
    return stem


def without_checksum(meta):
    del meta["global"]["core:sha512"]


@pytest.mark.parametrize(
    ("change", "data", "words"),
    [
        (lambda m: m["global"].update({"core:datatype": "rf64_be"}), None, ["core:datatype", "rf64_be", "cf32_le"]),
        (lambda m: m["global"].update({"core:sample_rate": -1}), None, ["core:sample_rate", "-1", "above 0"]),
        (lambda m: m["global"].update({"core:sample_rate": float("nan")}), None, ["core:sample_rate", "nan"]),
        (lambda m: m.pop("global"), None, ["global", "missing"]),
        (lambda m: m.update(captures=[{"core:sample_start": 5}, {"core:sample_start": 2}]), None, ["ascending"]),
        (lambda m: m.update(captures=[{"core:sample_start": 500}]), None, ["truncated", "100 samples", "500"]),
        (lambda m: m["global"].update({"core:num_channels": 2}), None, ["core:num_channels", "2"]),
        (lambda m: None, lambda p: p.write_bytes(p.read_bytes()[:-8]), ["SHA-512"]),
        (without_checksum, lambda p: p.write_bytes(p.read_bytes()[:-3]), ["truncated", "797 bytes"]),
        (without_checksum, lambda p: p.write_bytes(b""), ["no samples"]),
        (without_checksum, lambda p: p.unlink(), ["no such file"]),
        (without_checksum, lambda p: p.write_bytes(np.full(9, np.nan, "c8").tobytes()), ["9 samples are NaN", "index 0"]),
    ],
)
def test_a_broken_recording_is_refused_with_what_is_wrong(tmp_path, change, data, words):
    with pytest.raises(CastError) as error:
        recording.read(written(tmp_path, change, data))
    assert all(word in str(error.value) for word in words), error.value


def test_all_faults_are_told_at_once(tmp_path):
    def change(meta):
        meta["global"].update({"core:datatype": 7, "core:sample_rate": "fast"})
        meta["captures"] = "none"

    with pytest.raises(CastError) as error:
        recording.read(written(tmp_path, change))
    assert len(error.value.faults) == 3


def test_nan_is_read_where_it_stands_for_unknown_samples(tmp_path):
    samples = noise(10)
    samples[3] = np.nan
    recording.write(tmp_path / "x", samples, sample_rate_hz=1.0)
    assert np.flatnonzero(np.isnan(recording.read(tmp_path / "x", allow_nan=True).samples)).tolist() == [3]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=12), inner, max_size=4),
    max_leaves=8,
)
KEYS = st.sampled_from(["core:datatype", "core:sample_rate", "core:sha512", "core:num_channels", "core:metadata_only"])
CAPTURE_KEYS = st.sampled_from(["core:sample_start", "core:frequency", "cast:lost_samples", "core:header_bytes"])
VALUES = st.sampled_from(["cf32_le", "cu8", 1e6, 0, 1, -1, 2**70]) | JSON


@FUZZ
@given(
    st.fixed_dictionaries({
        "global": st.dictionaries(KEYS, VALUES) | JSON,
        "captures": st.lists(st.dictionaries(CAPTURE_KEYS, VALUES), max_size=3) | JSON,
        "annotations": JSON,
    })
    | JSON,
    st.binary(max_size=64),
)  # fmt: skip
def test_any_metadata_is_read_or_refused(tmp_path, document, data):
    (tmp_path / "x.sigmf-meta").write_text(json.dumps(document))
    (tmp_path / "x.sigmf-data").write_bytes(data)
    try:
        read = recording.read(tmp_path / "x")
    except CastError:
        return
    assert np.isfinite(read.samples).all() and len(read.samples) > 0


@FUZZ
@given(st.binary(max_size=200), st.binary(max_size=40), st.sampled_from([*recording.RAW_FORMATS, "f64"]), st.floats())
def test_any_bytes_are_read_or_refused(tmp_path, meta, data, raw_format, rate):
    (tmp_path / "x.sigmf-meta").write_bytes(meta)
    (tmp_path / "x.sigmf-data").write_bytes(data)
    for read in (
        lambda: recording.read(tmp_path / "x"),
        lambda: recording.read_raw(tmp_path / "x.sigmf-data", raw_format=raw_format, sample_rate_hz=rate),
    ):
        try:
            assert len(read().samples) > 0
        except CastError:
            pass


def test_a_cut_file_is_told_with_its_size_also_where_a_checksum_is_known(tmp_path):
    recording.write(tmp_path / "a", np.ones(100), sample_rate_hz=1e6)
    data = recording.data_path(tmp_path / "a")
    data.write_bytes(data.read_bytes()[:401])
    with pytest.raises(CastError, match="truncated: 401 bytes is not a whole number of cf32_le samples"):
        recording.read(tmp_path / "a")
    data.write_bytes(data.read_bytes()[:400])
    with pytest.raises(CastError, match=r"truncated or changed: holds 50 samples \(400 bytes\)"):
        recording.read(tmp_path / "a")
