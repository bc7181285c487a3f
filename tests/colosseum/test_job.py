# SPDX-License-Identifier: GPL-3.0-or-later
"""A batch job is taken or refused as Colosseum's documentation says, every fault by its key and its rule; nothing starts."""

import copy
import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
import team as teams
from gr_cast.colosseum import job, storage
from gr_cast.core.errors import CastError

# What may be wrong with a key: a value, and words of the rule that refuses it.
TEXT = [(5, "string"), ("", "string"), (None, "string"), (["a"], "string")]
WHOLE = [
    ("1", "integer"),
    (1.5, "integer"),
    (True, "integer"),
    (None, "integer"),
    (0, "integer"),
    (-3, "integer"),
    (10**9, "integer"),
]
TRUTH = [("True", "true or false"), (1, "true or false"), (None, "true or false")]
TOP = {
    "BatchName": TEXT,
    "Duration": WHOLE,
    "RFScenario": [*WHOLE, (424242, "a scenario")],
    "TrafficScenario": [*WHOLE[:4], (-1, "a traffic scenario"), (777, "a traffic scenario")],
}
NODE = {
    "RFNode_ID": [*WHOLE, (4, "number of SRNs")],
    "ImageName": [
        (5, "letters"),
        ("a b", "letters"),
        ("x" * 32, "31 characters"),
        ("absent", "an image of the team"),
        ("-a", "letters"),
    ],
    "ModemConfig": [(7, "a file in"), ("absent.conf", "a file in"), ("../radio.conf", "a file in"), ("/etc/passwd", "a file in")],
    "isGateway": TRUTH,
    "TrafficNode_ID": [*WHOLE, (4, "min(SRNs, traffic nodes)")],
    "node_type": [("robot", "competitor, bot"), (1, "competitor, bot"), ("Competitor", "competitor, bot")],
}
LOOPS = [
    ({"Enabled": "yes", "NumOfLoops": 2}, "Loopinfo.Enabled", "true or false"),
    ({"Enabled": True, "NumOfLoops": 0}, "Loopinfo.NumOfLoops", "integer"),
    ({"Enabled": True}, "Loopinfo", "NumOfLoops is missing"),
    ({"NumOfLoops": 3}, "Loopinfo", "Enabled is missing"),
    ({"Enabled": True, "NumOfLoops": 2, "More": 1}, "Loopinfo", "unknown key 'More'"),
    ([], "Loopinfo", "mapping"),
]


def read(folder, document):
    path = folder / "batch" / "job.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return job.read(path, storage.storage_of(path, None))


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    return teams.make(tmp_path_factory.mktemp("nas"))


def mutate(rng: random.Random) -> tuple[dict, list[tuple[str, str]]]:
    """A job with one to four faults in places of their own, and (key, words of the rule) of each."""
    document, expected = teams.job_document(), []
    kinds = [("top", key) for key in TOP] + [("node", n, key) for n in range(3) for key in NODE]
    kinds += (
        [("gone", key) for key in ("BatchName", "Duration")] + [("gone node", n) for n in range(3)] + [("loops",), ("unknown",)]
    )
    touched = set()
    for kind in rng.sample(kinds, rng.randint(1, 4)):
        where = (kind[1] if kind[0] in ("node", "gone node") else kind[-1],) + ((kind[2],) if kind[0] == "node" else ())
        if where in touched or (where[0],) in touched:
            continue
        touched.add(where)
        if kind[0] == "top":
            document[kind[1]], rule = rng.choice(TOP[kind[1]]) if kind[1] in document else (None, "missing")
            expected.append((kind[1], rule))
        elif kind[0] == "gone":
            document.pop(kind[1], None)
            expected = [one for one in expected if one[0] != kind[1]] + [("", f"{kind[1]} is missing")]
        elif kind[0] == "node":
            value, rule = rng.choice(NODE[kind[2]])
            document["NodeData"][kind[1]][kind[2]] = value
            expected.append((f"NodeData[{kind[1]}].{kind[2]}", rule))
        elif kind[0] == "gone node":
            key = rng.choice(sorted(NODE))
            document["NodeData"][kind[1]].pop(key)
            expected = [one for one in expected if one[0] != f"NodeData[{kind[1]}].{key}"]
            expected.append((f"NodeData[{kind[1]}]", f"{key} is missing"))
        elif kind[0] == "loops":
            document["Loopinfo"], key, rule = copy.deepcopy(rng.choice(LOOPS))
            expected.append((key, rule))
        else:
            document["Speed"] = 1
            expected.append(("", "unknown key 'Speed'"))
    return document, expected


def test_a_job_by_the_documented_rules_is_taken(team):
    taken = read(team, teams.job_document() | {"Loopinfo": {"Enabled": "True", "NumOfLoops": 2}})
    assert (taken.duration_s, taken.rf_scenario, taken.loops) == (60, 90003, 2)
    assert [node.rf_node for node in taken.nodes] == [1, 2, 3] and taken.nodes[0].is_gateway


def test_200_malformed_jobs_have_every_fault_named_by_key_and_rule(team, monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("something was started"))
    rng = random.Random(19)
    for _ in range(200):
        document, expected = mutate(rng)
        with pytest.raises(CastError) as refused:
            read(team, document)
        lines = refused.value.faults
        for key, rule in expected:
            begin = f"{team}/batch/job.json: {key}: " if key else f"{team}/batch/job.json: "
            assert any(line.startswith(begin) and rule in line for line in lines), (key, rule, lines)
        named = {key for key, _ in expected}
        also = [line for line in lines if line.removeprefix(f"{team}/batch/job.json: ").split(": ")[0] not in named]
        excused = ("needs to be unique", "is missing", "unknown key", "NodeData: got", "number of SRNs", "min(SRNs")
        assert all(any(words in line for words in excused) for line in also), also


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not JSON"), ("{", "not JSON"), ("[]", "needs a mapping"), ('{"Duration": 1, "Duration": 2}', "given twice"),
        ('{"Duration": NaN}', "finite"), ("[" * 5000, "nested too deep"), ('{"NodeData": 3}', "needs a list"),
        ('{"NodeData": []}', "1 to 128"), ('{"NodeData": [3]}', "NodeData[0]: got 3, needs a mapping"),
        (json.dumps({"NodeData": [{}] * 200}), "1 to 128"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_job_is_refused_with_its_reason(team, text, words):
    with pytest.raises(CastError) as refused:
        read(team, text)
    assert any(words in line for line in refused.value.faults)


def test_numbers_that_two_nodes_share_and_a_scenario_too_small_are_named(team):
    document = teams.job_document(6)
    document["NodeData"][1]["RFNode_ID"] = 1
    document["NodeData"][2]["TrafficNode_ID"] = 1
    with pytest.raises(CastError) as refused:
        read(team, document)
    text = str(refused.value)
    assert "NodeData[1].RFNode_ID: got 1, needs to be unique: NodeData[0] has it" in text
    assert "NodeData[2].TrafficNode_ID: got 1, needs to be unique: NodeData[0] has it" in text
    assert "NodeData: got 6 SRNs, RF scenario 90003 has 5 nodes" in text


def test_the_teams_image_comes_before_a_common_one_of_its_name(team):
    teams.write_image(team.parent / "common" / "images" / "good.tar.gz", {})
    teams.write_image(team.parent / "common" / "images" / "shared.tar", teams.radio_api())
    images = storage.Storage(folder=team).images()
    assert images["good"].parent == team / "images" and images["shared"].parent.parent.name == "common"
