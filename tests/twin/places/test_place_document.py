# SPDX-License-Identifier: GPL-3.0-or-later
"""Place cases are read as their files have them, or refused with all their faults."""

import io
import zipfile

import numpy as np
import place_case
import pytest
from gr_cast.core import arrays
from gr_cast.core.errors import CastError
from gr_cast.scenario.create.media import Medium
from gr_cast.twin.places import document
from gr_cast.twin.places.world import of_place


def faults(folder):
    with pytest.raises(CastError) as error:
        document.read(folder)
    return error.value.faults


def test_a_case_is_read_as_its_files_have_it(tmp_path):
    place = document.read(place_case.write(tmp_path / "office"))
    assert document.is_place(tmp_path / "office") and not document.is_place(tmp_path)
    assert (place.name, place.folder, place.max_range_m) == ("office", tmp_path / "office", 500.0)
    assert place.unknown == {"phase": "link", "delay": "node", "gain": "none"}
    assert [solid.name for solid in place.solids] == ["floor", "wall"]
    assert place.media == {"floor": Medium(material="concrete"), "wall": Medium(material="glass", thickness_m=0.02)}
    monday, flight = place.soundings
    assert (monday.file, monday.kind, monday.vault, monday.tx, monday.rx) == (
        "monday.npz",
        "response",
        False,
        ("a", "b"),
        ("b", "c"),
    )
    given = place_case.response()
    np.testing.assert_array_equal(monday.response, given["response"])
    assert monday.response.dtype == np.complex64 and np.isnan(monday.response).sum() == 1
    for name in ("time_s", "frequency_hz", "noise_power"):
        np.testing.assert_array_equal(getattr(monday, name), given[name])
    assert (flight.kind, flight.vault, flight.power_db.shape) == ("power", True, (1, 4)) and flight.response is None
    np.testing.assert_array_equal(flight.limits_db, [-110, -30])
    np.testing.assert_array_equal(flight.position_m["c"][:, 0], [2, 3, 4, 5])


def test_what_is_not_said_to_be_unknown_is_known(tmp_path):
    place = place_case.PLACE.replace("unknown: {phase: link, delay: node}\nlimits: {max_range_m: 500}\n", "")
    read = document.read(place_case.write(tmp_path, place=place))
    assert read.unknown == {"phase": "none", "delay": "none", "gain": "none"} and read.max_range_m is None


@pytest.mark.parametrize(
    "change, says",
    [
        (dict(tx=np.array(["a", "z"])), "tx[1]: got 'z', no node of the SPEC, needs one of a, b, c"),
        (dict(tx=np.array(["b", "b"])), "rx[0]: b is its own transmitter"),
        (dict(rx=np.array(["b"])), "rx: got 1 names, tx has 2"),
        (dict(rx=np.array([b"b", b"c"], object)), "rx: got Python objects, needs numbers or text"),
        (dict(time_s=np.array([0, 1, np.inf])), "time_s[2]: got inf, needs numbers of s in -1e+09 to 1e+09"),
        (dict(response=np.zeros((2, 3, 7), np.complex64)), "response: got 2 × 3 × 7 numbers, needs 2 × 3 × 8"),
        (dict(response=np.zeros((2, 3, 8))), "response: got float64, needs complex numbers"),
        (dict(response=np.full((2, 3, 8), np.inf + 0j)), "response[0, 0, 0]: is infinite; NaN says missing"),
        (dict(response=np.full((2, 3, 8), np.nan + 0j)), "monday.npz: all of its entries are missing"),
        (dict(noise_power=np.array([1e-9, 0])), "noise_power[1]: got 0, needs numbers in 1e-40 to 1e+40"),
        (dict(noise_power=np.array([1e-9, np.nan])), "noise_power[1]: got nan"),
        (dict(frequency_hz=np.linspace(1e8, -1e8, 8)), "frequency_hz: needs to ascend"),
        (
            dict(frequency_hz=5e9 + np.linspace(-1e8, 1e8, 8)),
            "frequency_hz: got 4.9e+09 to 5.1e+09 Hz, needs offsets from the carrier, 5e+09 Hz",
        ),
        (dict(frequency_hz=np.arange(8.0) ** 2), "frequency_hz: got steps of 1 to 13 Hz, needs equal ones"),
        (dict(power_db=np.zeros(3)), "power_db: unknown array, a response file knows"),
    ],
)
def test_what_no_campaign_is_gets_one_line_with_its_array_and_limit(tmp_path, change, says):
    told = faults(place_case.write(tmp_path, monday=place_case.response() | change))
    assert len(told) == 1 and says in told[0] and "monday.npz" in told[0], told


@pytest.mark.parametrize(
    "change, says",
    [
        (dict(power_db=np.array([[np.inf, 1, 2, 3]])), "power_db[0, 0]: got inf, needs numbers of dB in -400 to 400"),
        (dict(std_db=np.array([-1.0])), "std_db[0]: got -1"),
        (dict(limits_db=np.array([1.0, np.nan])), "limits_db[1]: got nan, needs numbers of dB and no NaN"),
        (dict(position_z=np.zeros((4, 3))), "position_z: no node of the SPEC, needs one of a, b, c"),
        (dict(position_c=np.zeros((3, 3))), "position_c: got 3 × 3 numbers, needs 4 × 3"),
        (dict(position_c=np.full((4, 3), np.nan)), "position_c[0, 0]: got nan, as 11 more, needs numbers of m in"),
    ],
)
def test_what_no_power_file_is_gets_one_line_with_its_array_and_limit(tmp_path, change, says):
    told = faults(place_case.write(tmp_path, flight=place_case.power() | change))
    assert len(told) == 1 and says in told[0] and "flight.npz" in told[0], told


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("cast_place: 1", "cast_place: 2", "cast_place: got 2, needs 1"),
        ("twin: spec.yaml", "twin: ../spec.yaml", "twin: got '../spec.yaml', needs a name inside the folder"),
        ("twin: spec.yaml", "twin: other.yaml", "other.yaml: no such file"),
        ("kind: power", "kind: music", "soundings[1].kind: got 'music', needs one of response, power"),
        ("use: vault", "use: later", "soundings[1].use: got 'later', needs one of vault"),
        ("flight.npz", "monday.npz", "soundings[1].file: monday.npz is named twice"),
        ("flight.npz", "other.npz", "other.npz: no such file"),
        ("phase: link", "phase: node", "unknown.phase: got 'node', needs one of none, link, snapshot"),
        ("max_range_m: 500", "max_range_m: -1", "limits.max_range_m: got -1, needs a finite number of m"),
        ("kind: response}", "kind: response, use: vault}", "soundings: all of them are use: vault"),
    ],
)
def test_what_no_place_file_says_gets_one_line_with_its_place(tmp_path, old, new, says):
    assert old in place_case.PLACE
    told = faults(place_case.write(tmp_path, place=place_case.PLACE.replace(old, new)))
    assert len(told) == 1 and says in told[0], told


def test_faults_of_all_files_come_at_once(tmp_path):
    folder = place_case.write(
        tmp_path, place=place_case.PLACE.replace("limits", "limit"), spec=place_case.SPEC.replace("glass", "cheese"),
        monday=place_case.response() | dict(noise_power=np.array([1.0, -1.0])),
        flight=place_case.power() | dict(std_db=np.zeros(2)),
    )  # fmt: skip
    told = faults(folder)
    for file, says in (("place.yaml", "'limit'"), ("spec.yaml", "cheese"), ("monday", "noise_power[1]"), ("flight", "std_db")):
        assert sum(file in line and says in line for line in told) == 1, told
    assert len(told) == 4


def test_a_mesh_that_is_missing_an_object_without_material_and_a_carrier_out_of_band_are_refused(tmp_path):
    folder = place_case.write(tmp_path, spec=place_case.SPEC.replace("wall", "w"))
    assert any("objects have none: wall" in line for line in faults(folder))
    (one,) = faults(place_case.write(tmp_path, spec=place_case.SPEC.replace("5.0e+9", "0.5e+9")))
    assert "concrete is known from 1 to 100 GHz, the carrier is 0.5 GHz" in one
    (tmp_path / "mesh.obj").unlink()
    assert any("mesh.obj: no such file" in line for line in faults(tmp_path))


def test_objects_that_python_would_run_on_reading_are_never_read(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "burst"), "w"))

    np.savez(tmp_path / "x.npz", tx=np.array([Bomb()], object))
    with pytest.raises(CastError, match="tx: got Python objects, needs numbers or text"):
        arrays.read(tmp_path / "x.npz")
    assert not (tmp_path / "burst").exists()


def header(shape, kind="<f8"):
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": kind, "fortran_order": False, "shape": shape})
    return out.getvalue()


def test_an_archive_that_would_fill_memory_is_refused_before_it_is_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w") as file:
        file.write(header((80 << 20,)))
        for _ in range(80):
            file.write(bytes(8 << 20))
    with pytest.raises(CastError, match="once unpacked, limit 536870912 bytes"):
        arrays.read(tmp_path / "bomb.npz")


@pytest.mark.parametrize(
    "content, says",
    [
        (header((1 << 40,)) + bytes(16), "got 16 bytes, its shape (1099511627776,) needs 8796093022208"),
        (header((-1,)) + bytes(8), "a: "),
        (b"\x93NUMPY\x01\x00", "a: not an array"),
        (b"", "a: not an array"),
        (header((2,), "<M8[s]") + bytes(16), "needs numbers or text"),
    ],
)
def test_an_array_that_is_not_what_its_head_says_is_refused(tmp_path, content, says):
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("a.npy", content)
    with pytest.raises(CastError) as error:
        arrays.read(tmp_path / "x.npz")
    assert says in str(error.value) and len(error.value.faults) == 1


def test_arrays_come_back_as_they_were_written(tmp_path):
    given = dict(
        a=np.asfortranarray(np.arange(6.0).reshape(2, 3)), b=np.array(["x", "äöü"]), c=np.zeros((0, 3)),
        d=np.arange(3, dtype=">i4"), e=np.float32(2.5), f=np.array([1 + 2j], np.complex64),
    )  # fmt: skip
    np.savez_compressed(tmp_path / "x.npz", **given)
    found = arrays.read(tmp_path / "x.npz")
    assert {*found} == {*given}
    for name, values in given.items():
        np.testing.assert_array_equal(found[name], values)
        assert found[name].dtype.isnative


def test_a_coefficient_scatters_only_where_the_spec_has_scattering_on(tmp_path):
    rough = place_case.SPEC.replace("glass, thickness_m: 0.02", "glass, thickness_m: 0.02, scattering_coefficient: 0.6")
    for spec, share in ((rough, 0.0), (rough.replace("max_depth: 1", "max_depth: 1, scattering: true"), 0.6)):
        folder = place_case.write(tmp_path / f"{share}", spec=spec)
        assert of_place(document.read(folder)).surface.scattering.max() == share
