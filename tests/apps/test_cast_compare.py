# SPDX-License-Identifier: GPL-3.0-or-later
"""The program: files of three kinds in, table, picture and JSON out, bad input refused without a trace."""

import json
import re
import subprocess
from pathlib import Path

import cast_compare
import numpy as np
import pytest
from gr_cast.comparing import series
from gr_cast.core.errors import CastError

PROGRAM = Path(__file__).resolve().parents[2] / "apps" / "cast_compare.py"
TIME_S = 0.1 * np.arange(200)
A, B = np.sin(TIME_S), 3 + np.sin(TIME_S)


def call(*arguments):
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, timeout=120)


def compare(*arguments):
    return cast_compare.main([str(argument) for argument in arguments])


def write(path, value, column="value"):
    if path.suffix == ".csv":
        series.write_csv(path, {"time_s": TIME_S, column: value})
    elif path.suffix == ".json":
        path.write_text(json.dumps({"time_s": TIME_S.tolist(), column: value.tolist()}))
    else:
        pyarrow = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        parquet.write_table(pyarrow.table({"time_s": TIME_S, column: value}), path)
    return path


@pytest.mark.parametrize("kind", [".csv", ".json", ".parquet"])
def test_two_series_of_any_kind_give_table_picture_and_json(kind, tmp_path, capsys):
    a, b = write(tmp_path / f"a{kind}", A, "sinr_db"), write(tmp_path / "b.csv", B, "sinr_db")
    assert compare(a, b, "--column", "sinr_db", "--output", tmp_path / "out") == 0
    document = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert document["rho"] == pytest.approx(1) and document["lag"] == 0
    assert document["bias"] == pytest.approx(3) and document["rmse"] == pytest.approx(3)
    assert "blind spot: bias" in capsys.readouterr().out
    assert (tmp_path / "out" / "comparison.png").read_bytes()[:4] == b"\x89PNG"


def test_a_missing_cell_is_a_missing_value(tmp_path):
    a = write(tmp_path / "a.csv", np.where(np.arange(200) == 7, np.nan, A))
    assert "0.7,\n" in a.read_text()
    done = call(a, a, "--output", tmp_path / "out")
    assert done.returncode == 2 and "1 of 200 values are missing" in done.stderr and len(done.stderr.splitlines()) == 1
    assert compare(a, a, "--step", 0.1, "--output", tmp_path / "out") == 0


@pytest.mark.parametrize(
    "name, content, words",
    [
        ("a.csv", "", "is empty"),
        ("a.csv", "time_s,other\n0,1\n1,2\n", "no column value; has time_s, other"),
        ("a.csv", "time_s,value\n0,1\n1,x\n", "row 2: value: got 'x'"),
        ("a.csv", "time_s,value\n0,1\n1\n", "row 2: got 1 cells"),
        ("a.csv", "time_s,value\n0,1\n1,inf\n", "infinite"),
        ("a.json", "{", "not JSON"),
        ("a.json", "3", "needs"),
        ("a.parquet", "no", "arquet"),
        ("a.txt", "", "suffix '.txt'"),
        ("absent.csv", None, "no such file"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_without_a_trace(name, content, words, tmp_path):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(CastError, match=re.escape(words)) as refused:
        compare(tmp_path / name, write(tmp_path / "b.csv", B), "--output", tmp_path / "out")
    assert len(refused.value.faults) == 1
    assert not (tmp_path / "out").exists()


def test_a_sounding_is_compared_with_the_scenario_it_was_made_over(tmp_path):
    document = {"cast_sounding": 1, "taps": [{"delay_s": 0.0, "gain_db": -3.0}, {"delay_s": 1.28e-6, "gain_db": -21.0}]}
    (tmp_path / "sound").mkdir()
    (tmp_path / "sound" / "result.json").write_text(json.dumps(document))
    assert compare("four_tap", tmp_path / "sound", "--link", "1>2", "--output", tmp_path / "out") == 0
    found = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert [round(tap["gain_error_db"], 2) for tap in found["taps"]] == [0, -1]
    assert [round(tap["delay_s"] * 1e6, 3) for tap in found["only_a"]] == [2, 4] and found["only_b"] == []


def test_a_series_is_not_compared_with_a_sounding(tmp_path):
    (tmp_path / "result.json").write_text(json.dumps({"cast_sounding": 1, "taps": [{"delay_s": 0, "gain_db": 0}]}))
    with pytest.raises(CastError, match="two of a kind"):
        compare(tmp_path, write(tmp_path / "b.csv", B), "--output", tmp_path / "out")
