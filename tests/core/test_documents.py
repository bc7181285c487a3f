# SPDX-License-Identifier: GPL-3.0-or-later
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from gr_cast.core import documents, files
from gr_cast.core.errors import CastError, Faults
from hypothesis import given, settings
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parents[2]


BUILDBOTS_OWN = "master_cfg.py"  # runs in Buildbot's Python, without this package, on what the pipeline wrote


def test_no_other_module_reads_or_writes_yaml_or_reads_json():
    """Whatever is imported from PyYAML or read by json elsewhere would go round the limits."""
    away = []
    for path in sorted([*ROOT.glob("python/gr_cast/**/*.py"), *ROOT.glob("apps/*.py")]):
        words = re.findall(r"\bimport yaml\b|\bjson\.loads?\b|\bloadmat\b|JSONDecoder", path.read_text(encoding="utf-8"))
        away += [f"{path.name}: {word}" for word in words if path.name not in ("documents.py", BUILDBOTS_OWN)]
    assert away == []


def written(tmp_path, text):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    return path


def faults_of(reader):
    with pytest.raises(CastError) as error:
        reader.faults.raise_if_any()
    return error.value.faults


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e6", 1e6), ("1E-3", 1e-3), ("+5", 5), ("-.5", -0.5), ("5.", 5.0), ("1_000", 1000), ("0x10", 16), ("~", None),
        ("yes", True), ("'1e6'", "1e6"), ('"5"', "5"), ("010", "010"), ("12:30", "12:30"), ("2020-01-01", "2020-01-01"),
        ("e5", "e5"), ("-", "-"), (".", "."), ("1.2.3", "1.2.3"), ("=", "="),
    ],
)  # fmt: skip
def test_a_number_is_a_number_in_every_form_and_text_in_quotes_is_none(tmp_path, text, value):
    if text == "-":
        text = "'-'"
    found = documents.yaml_file(written(tmp_path, f"a: {text}\n")).document["a"]
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize("value", [True, False, "5", "1e6", None, [1], {}, float("nan"), float("inf"), 10**400])
def test_what_is_no_finite_number_is_refused_with_what_is_needed(value):
    get = documents.Reader("x")
    assert get.number(value, "gain_db", "dB") != get.number(value, "gain_db", "dB")  # NaN
    (line, _) = faults_of(get)
    assert line.startswith("x: gain_db: got ") and line.endswith("needs a finite number of dB")


def test_a_limit_is_told_with_its_unit():
    get = documents.Reader("x")
    get.number(-1, "a", "s", 0.0)
    get.number(11, "b", "Hz", 0.0, 10.0)
    get.whole(2.5, "c", "steps", 0, 9)
    assert faults_of(get) == (
        "x: a: got -1, needs a finite number of s of 0 or more", "x: b: got 11, needs a finite number of Hz in 0 to 10",
        "x: c: got 2.5, needs a whole number of steps in 0 to 9",
    )  # fmt: skip
    assert documents.Reader("x").whole(1e3, "c", "steps", 0, 9999) == 1000


def test_every_doubled_key_is_a_fault_beside_all_others(tmp_path):
    reader = documents.yaml_file(written(tmp_path, "a: 1\na: 2\nb:\n  - {c: 1, c: 1}\n"))
    reader.keys(reader.document, "", {"b"})
    lines = faults_of(reader)
    assert [line.split("a.yaml: ")[1] for line in lines] == [
        "line 2: the key 'a' is given twice", "b[0]: line 4: the key 'c' is given twice", "unknown key 'a', knows b",
    ]  # fmt: skip
    lines = faults_of(documents.json_text('{"a": 1, "b": [{"c": 1, "c": 2}], "a": 2}', "x"))
    assert lines == ("x: the key 'a' is given twice", "x: b[0]: the key 'c' is given twice")


def nine_times_nine(levels):
    lines = ["a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9]"]
    return "\n".join(lines + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, levels)])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (nine_times_nine(12), "aliases counted as often as they are used"),
        ("a: &a " + "x" * 100_000 + "\nb: [" + ", ".join(["*a"] * 1000) + "]", "characters, aliases counted"),
        ("[" * 100_000, "nested too deep, limit 64"),
        ("a: &a [*a]", "stands before or within"),
        ("a: *b", "stands before or within"),
        ("a: !!python/object:os.system x", "no tags are known here"),
        ("a: 1\n---\nb: 1", "more than one document"),
        ("? [1]\n: 2", "a key must be plain text"),
        ('a: "x\\0y"', "text holds no character"),
        ("a: 0x" + "f" * 300, "got a whole number of 1200 bits, limit 64 bits"),
        ("- 1", "needs a mapping"),
        ("", "needs a mapping"),
    ],
)
def test_what_is_no_document_of_any_program_is_refused_in_one_line(tmp_path, text, says):
    with pytest.raises(CastError) as error:
        documents.yaml_file(written(tmp_path, text)).faults.raise_if_any()
    assert says in str(error.value) and len(error.value.faults) == 1 and len(str(error.value)) < 500


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"a": NaN}', "a: got nan, needs a finite number"),
        ('{"a": [1, -1e999]}', "a[1]: got -inf, needs a finite number"),
        ("[" * 100_000, "nested too deep"),
        ('{"a":' * 100 + "1" + "}" * 100, "nested too deep"),
        ('{"a": "\\ud800"}', "text holds no character"),
        ('{"a": 99999999999999999999999}', "limit 64 bits"),
        (b"\xff", "not UTF-8"),
        ("[1", "not JSON"),
        ("[" + "1," * 2_000_001 + "1]", "limit 2000000"),
    ],
)
def test_json_is_read_by_the_same_rules(text, says):
    with pytest.raises(CastError) as error:
        documents.json_text(text, "x", kind=(dict, list)).faults.raise_if_any()
    assert says in str(error.value) and len(error.value.faults) == 1


def test_small_files_of_many_aliases_take_little_memory(tmp_path):
    """The reader counts before it builds: 200 MB of address space beyond what is loaded are enough to refuse them."""
    written(tmp_path, nine_times_nine(40))
    code = (
        "import resource, sys; from gr_cast.core import documents, errors\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + (200 << 20),) * 2)\n"
        "try: documents.yaml_file(sys.argv[1])\n"
        "except errors.CastError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "a.yaml")], capture_output=True, text=True, timeout=60, check=True,
        env=os.environ | {"PYTHONPATH": ":".join(sys.path)},
    )  # fmt: skip
    assert "limit 2000000" in done.stdout


def test_a_pipe_a_folder_and_a_name_that_no_file_has_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name, says in (("pipe", "not a file"), (".", "Is a directory"), ("none", "no such file"), ("a\0b", "cannot be read")):
        with pytest.raises(CastError, match=says):
            documents.read_text(tmp_path / name)
    (tmp_path / "long").write_bytes(b"x" * 11)
    with pytest.raises(CastError, match="limit 10 bytes"):
        documents.read_text(tmp_path / "long", limit=10)


def test_a_fault_is_one_line_whatever_stands_in_names():
    faults = Faults("x")
    faults.add("a\nb\x1b[31m", "bad")
    with pytest.raises(CastError) as error:
        faults.raise_if_any()
    assert error.value.faults == ("x: a\\nb\\x1b[31m: bad",)


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(blacklist_categories=("Cs", "Cc")), max_size=12)
    | st.sampled_from(["1e6", "yes", "~", "010", "1_0", "0x1", ".inf", "<<", "=", "1:30", "- a", "a: b", "#", "&a", "*a", "!x"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("ab1e._-", min_size=1, max_size=4), inner, max_size=4),
    max_leaves=20,
)  # fmt: skip


@settings(max_examples=300, deadline=None)
@given(st.dictionaries(st.text("abc1e6", min_size=1, max_size=4), PLAIN, min_size=1, max_size=5))
def test_what_is_written_is_read_as_the_same_and_by_other_readers_too(tmp_path_factory, document):
    path = tmp_path_factory.getbasetemp() / "same.yaml"
    path.write_text(documents.yaml_text(document), encoding="utf-8")
    assert documents.yaml_file(path).document == document
    assert documents.json_text(json.dumps(document), "x").document == document


def test_documents_without_numbers_in_disguise_are_read_as_pyyaml_reads_them(tmp_path):
    text = "a: [1, -2.5, 1.0e+3, true, null, x y, 'q', \"w\\n\", {b: ~}]\nc: &c {d: 1}\ne: *c\nf: |\n  two\n  lines\n"
    assert documents.yaml_file(written(tmp_path, text)).document == yaml.safe_load(text)


@pytest.mark.parametrize("name", ["rx1", "1", "Node 1", "tx_2.left", "größe", "a+b (2)", "tx@lab:1", "x" * 128])
def test_a_name_of_a_node_can_be_a_name_of_a_file(tmp_path, name):
    assert files.is_name(name)
    (tmp_path / f"{name}.sigmf-meta").touch()
    assert [path.name for path in tmp_path.iterdir()] == [f"{name}.sigmf-meta"]


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../../evil", "/etc/x", "a/b", "a\\b", ".hidden", "-o", "a\0", "a\n", "a>b", " a", "x" * 129]
)
def test_a_name_that_leads_elsewhere_is_none(name):
    assert not files.is_name(name)
    assert files.is_inside(name) == (name == "a/b")


def test_a_file_may_be_told_from_the_folder_that_it_lies_in():
    assert files.is_inside("./recording") and files.is_inside("part/recording")
    assert not files.is_inside("./../x") and not files.is_inside("a//b") and not files.is_inside("./.")
