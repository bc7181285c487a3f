# SPDX-License-Identifier: GPL-3.0-or-later
"""Series as they come from files: every number in its place, and nothing where there was none."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.comparing.series import MAX_STEPS, Series, read, resampled, write_csv
from gr_cast.core.errors import CastError

TIME_S, VALUE = [0.0, 0.5, 1.0, 1.5], [1.25, np.nan, -3.0, 2e6]


def test_what_is_written_is_read_again(tmp_path):
    write_csv(tmp_path / "s.csv", {"time_s": TIME_S, "value": VALUE, "other": [1, 2, 3, 4]})
    assert (tmp_path / "s.csv").read_text().splitlines()[2] == "0.5,,2"
    found = read(tmp_path / "s.csv")
    assert np.array_equal(found.time_s, TIME_S) and np.array_equal(found.value, VALUE, equal_nan=True)
    assert np.array_equal(read(tmp_path / "s.csv", "other").value, [1, 2, 3, 4])


@pytest.mark.parametrize("as_rows", [False, True])
def test_json_comes_as_lists_by_name_or_as_a_list_of_objects(tmp_path, as_rows):
    value = [None if v != v else v for v in VALUE]
    rows = [{"time_s": t, "value": v} for t, v in zip(TIME_S, value, strict=True)]
    (tmp_path / "s.json").write_text(json.dumps(rows if as_rows else {"time_s": TIME_S, "value": value, "note": "x"}))
    found = read(tmp_path / "s.json")
    assert np.array_equal(found.time_s, TIME_S) and np.array_equal(found.value, VALUE, equal_nan=True)


def test_every_row_that_is_no_number_is_told_with_its_place(tmp_path):
    (tmp_path / "s.csv").write_text("time_s,value\n0,1\n1,up\n2,3\n3,down\n")
    with pytest.raises(CastError) as refused:
        read(tmp_path / "s.csv")
    assert [fault.split(": ")[1] for fault in refused.value.faults] == ["row 2", "row 4"]


def test_a_step_holds_the_mean_of_what_was_measured_in_it_and_empty_ones_are_interpolated():
    uneven = Series(name="s", time_s=np.array([2.0, 2.1, 2.2, 3.0, 5.0, 5.9]), value=np.array([1.0, np.nan, 3.0, 5.0, 9.0, 11.0]))
    found = resampled(uneven, 1.0)
    assert np.array_equal(found.time_s, [2, 3, 4, 5]) and np.array_equal(found.value, [2, 5, 7.5, 10])
    assert found.is_uniform and found.step_s == 1 and not uneven.is_uniform


def test_steps_that_cannot_be_meant_are_refused_and_as_many_as_may_be_are_not():
    long = Series(name="s", time_s=[0.0, MAX_STEPS], value=[1.0, 2.0])
    assert resampled(long, 1.0).value.size == MAX_STEPS + 1
    for step_s, says in ((0.99, "limit 10000000 steps"), (0.0, "above 0"), (np.inf, "finite"), (np.nan, "finite")):
        with pytest.raises(CastError, match=says):
            resampled(long, step_s)
    with pytest.raises(CastError, match="no measured value"):
        resampled(Series(name="s", time_s=[0.0, 1.0], value=[np.nan, np.nan]), 1.0)


def test_a_series_is_uniform_up_to_a_hundredth_of_its_step():
    for off_s, uniform in ((0.0, True), (0.009, True), (-0.009, True), (0.011, False)):
        assert Series(name="s", time_s=[0.0, 1.0 + off_s, 2.0], value=np.zeros(3)).is_uniform == uniform


def test_floats_are_written_with_nine_digits_and_what_is_none_as_it_is(tmp_path):
    write_csv(
        tmp_path / "s.csv", {"time_s": [1 / 3, 1.0], "value": [2e9 / 3, np.nan], "name": ["a, b", "c"], "count": [10**10, 2]}
    )
    assert (tmp_path / "s.csv").read_text() == 'time_s,value,name,count\n0.333333333,666666667,"a, b",10000000000\n1,,c,2\n'


@pytest.mark.parametrize("document", [[], [1, 2], [{"time_s": 0, "value": 1}, 2]])
def test_a_list_that_is_none_of_objects_is_told_what_it_needs(tmp_path, document):
    (tmp_path / "s.json").write_text(json.dumps(document))
    with pytest.raises(CastError, match="needs .*or a list of such objects"):
        read(tmp_path / "s.json")


def test_what_is_missing_in_the_end_holds_the_last_value():
    ended = Series(name="s", time_s=np.arange(4.0), value=np.array([1.0, 2.0, np.nan, np.nan]))
    assert np.array_equal(resampled(ended, 1.0).value, [1, 2, 2, 2])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time_s,value,value\n0,1,2\n1,2,3\n", "two columns are named value"),
        ("time_s,values\n0,1\n1,2\n", "no column value; has time_s, values"),
        ("time_s,value\n0,1\n1,2,3\n", "row 2: got 3 cells, the header has 2"),
        ("", "is empty"),
        ("time_s,value\n0,1\n", "got 1 samples, needs 2 or more"),
        ("time_s,value\n0,1\n0,2\n", "got 0 s after 0 s, needs to ascend"),
        ("time_s,value\n0,1\n,2\n", "sample 1 is not a finite number of s"),
        ("time_s,value\n0,1\n1,inf\n", "value at 1 s is infinite"),
    ],
)
def test_what_is_no_series_is_refused_and_its_fault_is_named(tmp_path, text, says):
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(CastError, match=says):
        read(tmp_path / "s.csv")
    (tmp_path / "good.csv").write_text(
        "time_s,value,note,note\n0,1,a,b\n1,2,c,d\n"
    )  # a name that nobody asks for may be there twice
    assert np.array_equal(read(tmp_path / "good.csv").value, [1, 2])


def test_times_on_the_grid_fall_into_a_step_each_and_a_negative_step_is_refused():
    tenths = Series(name="s", time_s=np.arange(1000) / 10, value=np.arange(1000.0))
    found = resampled(tenths, 0.1)
    assert np.array_equal(found.value, tenths.value) and np.allclose(found.time_s, tenths.time_s)
    with pytest.raises(CastError, match="above 0"):
        resampled(tenths, -0.1)


def test_a_cell_beyond_any_number_is_no_csv(tmp_path):
    (tmp_path / "s.csv").write_text(f"time_s,value\n0,{'1' * 200_000}\n")
    with pytest.raises(CastError, match="not CSV"):
        read(tmp_path / "s.csv")


class NoParquet(Exception):
    """What a reader of Parquet raises."""


def parquet(monkeypatch, table):
    """A library that knows one table, or raises it: Debian has none."""

    def known(asked=None):
        if isinstance(table, Exception):
            raise table
        return table if asked is None else {name: table[name] for name in asked}

    files = SimpleNamespace(
        read_schema=lambda path: SimpleNamespace(names=list(known())),
        read_table=lambda path, columns: SimpleNamespace(to_pydict=lambda: known(columns)),
    )
    monkeypatch.setitem(sys.modules, "pyarrow", SimpleNamespace(ArrowException=NoParquet, parquet=files))


def test_parquet_gives_the_columns_that_are_asked_for(monkeypatch):
    parquet(monkeypatch, {"time_s": [0.0, 1.0], "value": [5.0, None], "note": ["a", "b"]})
    assert np.array_equal(read("s.parquet").value, [5, np.nan], equal_nan=True)
    with pytest.raises(CastError, match="no column loss; has time_s, value, note"):
        read("s.parquet", "loss")


@pytest.mark.parametrize(
    ("fault", "says"), [(NoParquet("no magic bytes"), "not Parquet: no magic bytes"), (FileNotFoundError(), "no such file")]
)
def test_what_is_no_parquet_is_one_line(monkeypatch, fault, says):
    parquet(monkeypatch, fault)
    with pytest.raises(CastError, match=says):
        read("s.parquet")


def test_without_a_library_parquet_is_told_what_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(CastError, match="needs pyarrow"):
        read("s.parquet")


def test_columns_of_different_lengths_are_not_cut_to_the_shortest(tmp_path):
    with pytest.raises(ValueError, match="shorter"):
        write_csv(tmp_path / "s.csv", {"time_s": [0.0, 1.0], "value": [1.0]})
    assert not (tmp_path / "s.csv").exists()


def test_columns_of_a_list_of_objects_are_those_of_the_first(tmp_path):
    (tmp_path / "s.json").write_text(json.dumps([{"time_s": 0, "value": 1}]))
    with pytest.raises(CastError, match="got 1 samples, needs 2 or more"):
        read(tmp_path / "s.json")
    (tmp_path / "s.json").write_text(json.dumps([{"time_s": 0, "loss": 1}, {"value": 2}]))
    with pytest.raises(CastError, match="no column value; has time_s, loss"):
        read(tmp_path / "s.json")
