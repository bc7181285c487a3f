# SPDX-License-Identifier: GPL-3.0-or-later
"""JSON Schemas of the files that are read, made from what the strict reader asks for: schemas.py FOLDER.

Nothing is declared twice: the readers read examples that use every key, and each question that they put to
`core.documents.Reader` (which keys, which kind, which limits) becomes a line of the schema. A limit or a list of names
that differs between examples depends on the document, and is left out.
"""

import json
import math
import re
import shutil
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import effect_schemas
import numpy as np
from gr_cast.core import documents, frequencies
from gr_cast.core.documents import Reader
from gr_cast.experiments.traffic import flows
from gr_cast.pipeline import document, site
from gr_cast.scenario import examples_folder, yaml_file
from gr_cast.scenario.create import spec
from gr_cast.signals import recording
from gr_cast.twin.document import read_twin
from gr_cast.twin.places import document as places

FILES = Path(__file__).resolve().parent / "examples" / "files"
STACK = FILES.parent / "stack"
TRAFFIC = Path(flows.__file__).parent / "examples"
# format → (what it is, its reader, examples that together use every key)
FORMATS = {
    "scenario": (
        "A scenario, cast_scenario: 1",
        yaml_file.read,
        list(FILES.glob("scenario*.yaml")),
    ),
    "place": (
        "A place to create a scenario of, cast_create: 1",
        spec.read,
        [*examples_folder().glob("*.yaml"), FILES / "spec.yaml"],
    ),
    "place_case": ("What was sounded in a place, cast_place: 1", places.read_file, list(FILES.glob("place*.yaml"))),
    "twin": ("A twin, cast_twin: 1", read_twin, list(FILES.glob("twin*.yaml"))),
    "traffic": ("Flows of packets, cast_traffic: 1", flows.read, [*TRAFFIC.glob("*.yaml"), *FILES.glob("traffic*.yaml")]),
    "pipeline": ("A stack's pipeline, cast_pipeline: 1", document.read, [STACK / "pipeline.yaml", FILES / "pipeline.yaml"]),
    "site": ("A site's inventory, cast_site: 1", site.read, [*FILES.glob("site*.yaml"), *STACK.glob("sites/*.yaml")]),
}
WRITTEN = {"diagnosis": effect_schemas.diagnosis, "place_diagnosis": effect_schemas.place_diagnosis}  # that nobody reads
ASKED = ("keys", "number", "hertz", "whole", "truth", "text", "name", "path_inside", "choice", "sequence", "mapping")
TEXT = {"type": ["string", "integer"]}  # a whole number stands for its digits


class Node:
    """What is asked for at one place: kinds with what they were told, and the places below it."""

    def __init__(self):
        self.asked: dict[str, list] = {}
        self.below: dict[str, Node] = {}
        self.values: list = []  # that the examples hold here

    def at(self, steps):
        node = self
        for step in steps:
            node = node.below.setdefault(step, Node())
        return node


@contextmanager
def noted(root: Node, names: set[str]):
    """While this is entered, every question to a Reader of a file with one of these names is noted in `root`."""
    own = {name: getattr(Reader, name) for name in ASKED}

    def noting(name):
        def ask(self, value, place, *told, **more):
            if re.fullmatch(r"[\w>.\[\]-]*", place) and Path(self.faults.where).name in names:
                steps = ["[]" if step.startswith("[") else step for step in re.findall(r"\[\d+\]|[^.\[\]]+", place)]
                root.at(steps).asked.setdefault(name, []).append((told, more))
            return own[name](self, value, place, *told, **more)

        return ask

    def version(self, key, value):
        if Path(self.faults.where).name in names:
            root.at([key]).asked.setdefault("version", []).append(((value,), {}))
        return own["version"](self, key, value)

    for name in ASKED:
        setattr(Reader, name, noting(name))
    own["version"] = Reader.version
    Reader.version = version
    try:
        yield
    finally:
        for name, method in own.items():
            setattr(Reader, name, method)


def merged(nodes: list[Node]) -> Node:
    """One node that was asked all that these were."""
    whole = Node()
    for node in nodes:
        whole.values += node.values
        for kind, asked in node.asked.items():
            whole.asked.setdefault(kind, []).extend(asked)
    for step in dict.fromkeys(step for node in nodes for step in node.below):
        whole.below[step] = merged([node.below[step] for node in nodes if step in node.below])
    return whole


def limits(asked: list) -> dict:
    """The limits that every question of a number told alike."""
    found = {}
    for place, name in ((1, "low"), (2, "high")):
        told = {more.get(name, given[place] if len(given) > place else math.inf) for given, more in asked}
        if len(told) == 1 and math.isfinite(limit := told.pop()):
            found["minimum" if name == "low" else "maximum"] = limit
    units = {given[0] for given, _ in asked if given and isinstance(given[0], str) and given[0]}
    return found | ({"description": f"in {units.pop()}"} if len(units) == 1 else {})


def mapping(node: Node) -> dict:
    allowed = [frozenset(map(str, told[0])) for told, _ in node.asked.get("keys", [])]
    given = {str(key) for value in node.values if isinstance(value, dict) for key in value}
    if len(set(allowed)) == 1:
        properties = {key: schema(node.below[key]) if key in node.below else {} for key in sorted(allowed[0])}
        if not given <= allowed[0]:  # an entry of another kind stands here too
            return {"type": "object", "properties": properties}
        required = sorted(set.intersection(*(set(told[1]) if len(told) > 1 else set() for told, _ in node.asked["keys"])))
        closed = {"type": "object", "properties": properties, "additionalProperties": False}
        return closed | ({"required": required} if required else {})
    names = [below for step, below in node.below.items() if step != "[]"]
    return {"type": "object", "additionalProperties": schema(merged(names)) if names else True}


def items(node: Node) -> dict:
    """What a list holds; numbers may have been asked for at the place of the list itself, or of its lists."""
    if "[]" in node.below:
        return {"items": schema(node.below["[]"])}
    if "number" not in node.asked:
        return {}
    numbers = {"type": "number"} | limits(node.asked["number"])
    nested = any(isinstance(one, list) for value in node.values if isinstance(value, list) for one in value)
    return {"items": {"type": "array", "items": numbers} if nested else numbers}


def schema(node: Node) -> dict:
    """The JSON Schema of a place; {} where nothing was asked."""
    found = []
    for kind, asked in node.asked.items():
        if kind == "number":
            numbers = {"type": "number"} | limits(asked)
            if any(not isinstance(value, (list, dict)) for value in node.values):
                found.append(numbers)
            if "sequence" not in node.asked and any(isinstance(value, list) for value in node.values):
                found.append({"type": "array", "items": numbers})
        elif kind == "hertz":
            found.append({"type": "number", "minimum": asked[0][0][0], "description": "in Hz"})
            found.append({"type": "string", "pattern": f"^{frequencies.FREQUENCY.pattern}$"})
        elif kind == "whole":
            found.append({"type": "integer"} | limits(asked))
        elif kind == "version":
            found.append({"const": asked[0][0][0]})
        elif kind == "truth":
            found.append({"type": "boolean"})
        elif kind == "choice":
            found.append({"enum": list(dict.fromkeys(word for told, _ in asked for word in told[0]))})
        elif kind == "sequence":
            found.append({"type": "array"} | items(node))
    if {"keys", "mapping"} & set(node.asked):
        found.append(mapping(node))
    asked_text = {"text", "name", "path_inside"} & set(node.asked)
    if asked_text and (not found or ("keys" in node.asked and any(isinstance(value, str) for value in node.values))):
        found.append(TEXT)  # a name may stand for a mapping
    if None in node.values and found:
        found.append({"type": "null"})
    return {} if not found else found[0] if len(found) == 1 else {"anyOf": found}


def made(name: str) -> dict:
    title, read, examples = FORMATS[name]
    root = Node()
    with tempfile.TemporaryDirectory() as folder, noted(root, {path.name for path in examples}):
        recording.write(Path(folder) / "reference", np.ones(64), sample_rate_hz=2e6)  # that a twin names
        shutil.copy(FILES / "flows.yaml", folder)  # that a pipeline names
        shutil.copy(FILES / "spec.obj", folder)  # that a SPEC names
        for path in examples:
            read(path if path.parent != FILES else shutil.copy(path, folder))
    for path in examples:
        _note_values(root, documents.yaml_file(path).document)
    found = schema(root)
    if name == "twin":  # each family has keys of its own, which no example shows all of
        found["properties"]["effects"] = {"type": ["array", "null"], "items": effect_schemas.entry()}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title} | found


def _note_values(node: Node, value) -> None:
    node.values.append(value)
    pairs = value.items() if isinstance(value, dict) else [("[]", one) for one in value] if isinstance(value, list) else []
    for step, below in pairs:
        if str(step) in node.below or ("mapping" in node.asked and "keys" not in node.asked):
            _note_values(node.at([str(step)]), below)


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, found in [(name, made(name)) for name in FORMATS] + [(name, make()) for name, make in WRITTEN.items()]:
        (folder / f"{name}.schema.json").write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
