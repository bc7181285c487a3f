# SPDX-License-Identifier: GPL-3.0-or-later
"""A batch job: the JSON file, read strictly, every fault at once with its key and its rule, and nothing started."""

from dataclasses import dataclass
from pathlib import Path

from .. import scenario as sc
from ..core.documents import Reader, json_file, listed, read_bytes, short
from ..core.errors import CastError
from ..core.files import is_name
from .storage import IMAGE_RULE, Storage, is_image_name, rf_scenarios, traffic_nodes

MAX_SRNS = 128
MAX_DURATION_S = 7 * 86400
MAX_LOOPS = 1000
MAX_CONFIG = 1 << 20  # bytes of a radio.conf
NODE_TYPES = ("competitor", "bot")
_KEYS = ("BatchName", "Duration", "RFScenario", "TrafficScenario", "NodeData")
_NODE_KEYS = ("RFNode_ID", "ImageName", "ModemConfig", "isGateway", "TrafficNode_ID", "node_type")


@dataclass(frozen=True, kw_only=True)
class Node:
    """One standard radio node of a job; `srn` counts from 1 in the order of the file."""

    srn: int
    rf_node: int
    image: str
    image_path: Path
    modem_config: Path
    is_gateway: bool
    traffic_node: int
    node_type: str


@dataclass(frozen=True, kw_only=True)
class Job:
    name: str
    duration_s: int
    rf_scenario: int
    traffic_scenario: int
    traffic_path: Path | None
    nodes: tuple[Node, ...]
    loops: int


def read(path: str | Path, storage: Storage) -> Job:
    """A batch job. Raises CastError with a line per fault: file, key, value, rule."""
    get = json_file(path)
    document = get.keys(get.document, "", (*_KEYS, "Loopinfo"), _KEYS)
    entries = _entries(get)
    srns = len(entries)
    name = _text(get, document, "BatchName")
    duration_s = _integer(get, document, "Duration", "seconds", 1, MAX_DURATION_S)
    rf_scenario, rf_nodes = _rf_scenario(get, document)
    traffic_scenario, traffic_path, most_traffic = _traffic_scenario(get, document, storage, srns)
    images = storage.images()
    nodes = []
    for index, entry in enumerate(entries):
        place = f"NodeData[{index}]"
        entry = get.keys(entry, place, _NODE_KEYS, _NODE_KEYS)
        nodes.append(
            Node(
                srn=index + 1,
                rf_node=_integer(get, entry, f"{place}.RFNode_ID", "1 … number of SRNs", 1, srns),
                image=(image := _image(get, entry, f"{place}.ImageName", images)),
                image_path=images.get(image, Path()),
                modem_config=_modem_config(get, entry, f"{place}.ModemConfig", storage),
                is_gateway=_truth(get, entry, f"{place}.isGateway"),
                traffic_node=_integer(get, entry, f"{place}.TrafficNode_ID", "1 … min(SRNs, traffic nodes)", 1, most_traffic),
                node_type=_choice(get, entry, f"{place}.node_type", NODE_TYPES),
            )
        )
    _check_unique(get, entries, "RFNode_ID")
    _check_unique(get, entries, "TrafficNode_ID")
    if rf_nodes and srns > rf_nodes:
        get.faults.add("NodeData", f"got {srns} SRNs, RF scenario {rf_scenario} has {rf_nodes} nodes")
    loops = _loops(get, document)
    get.faults.raise_if_any()
    return Job(
        name=name, duration_s=duration_s, rf_scenario=rf_scenario, traffic_scenario=traffic_scenario, traffic_path=traffic_path,
        nodes=tuple(nodes), loops=loops,
    )  # fmt: skip


def _entries(get: Reader) -> list:
    if "NodeData" not in get.document:
        return []
    entries = get.sequence(get.document["NodeData"], "NodeData")
    if isinstance(get.document["NodeData"], list) and not 1 <= len(entries) <= MAX_SRNS:
        get.faults.add("NodeData", f"got {len(entries)} entries, needs one per SRN, 1 to {MAX_SRNS}")
    return entries[:MAX_SRNS]


def _key(place: str) -> str:
    return place.rpartition(".")[2]


def _text(get: Reader, mapping: dict, place: str) -> str:
    """A string that is not blank, else ""; a key that is missing has been named already."""
    value = mapping.get(_key(place))
    if _key(place) in mapping and not (isinstance(value, str) and value.strip() and len(value) <= 256):
        get.faults.add(place, f"got {short(value)}, needs a string of 1 to 256 characters")
    return value if isinstance(value, str) else ""


def _integer(get: Reader, mapping: dict, place: str, rule: str, low: int, high: int) -> int:
    value = mapping.get(_key(place))
    is_integer = isinstance(value, int) and not isinstance(value, bool)
    if _key(place) in mapping and not (is_integer and low <= value <= high):
        get.faults.add(place, f"got {short(value)}, needs an integer of {low} to {high} ({rule})")
    return value if is_integer else low


def _truth(get: Reader, mapping: dict, place: str) -> bool:
    return get.truth(mapping[_key(place)], place) if _key(place) in mapping else False


def _choice(get: Reader, mapping: dict, place: str, choices: tuple) -> str:
    return get.choice(mapping[_key(place)], place, choices) if _key(place) in mapping else choices[0]


def _is_integer(value) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _rf_scenario(get: Reader, document: dict) -> tuple[int, int]:
    """The scenario's number and how many nodes it has; 0 where it is not known."""
    value, known = document.get("RFScenario"), rf_scenarios()
    if "RFScenario" not in document:
        return 0, 0
    if not _is_integer(value) or value not in known:
        get.faults.add("RFScenario", f"got {short(value)}, needs an integer that is a scenario: {listed(sorted(known))}")
        return 0, 0
    return value, len(sc.load(str(value)).nodes)


def _traffic_scenario(get: Reader, document: dict, storage: Storage, srns: int) -> tuple[int, Path | None, int]:
    """The scenario's number, its file, and the highest number of a traffic node; without traffic any SRN's."""
    value, known = document.get("TrafficScenario"), storage.traffic()
    if "TrafficScenario" not in document:
        return 0, None, max(srns, 1)
    if not _is_integer(value) or value not in known:
        get.faults.add(
            "TrafficScenario", f"got {short(value)}, needs an integer that is a traffic scenario: {listed(sorted(known))}"
        )
        return 0, None, max(srns, 1)
    try:
        nodes = traffic_nodes(known[value])
    except CastError as error:
        for fault in error.faults:
            get.faults.add("TrafficScenario", fault)
        nodes = ()
    return value, known[value], min(srns, max(map(int, nodes))) if nodes else max(srns, 1)


def _image(get: Reader, entry: dict, place: str, images: dict[str, Path]) -> str:
    value = entry.get("ImageName")
    if "ImageName" not in entry:
        return ""
    if not is_image_name(value):
        get.faults.add(place, f"got {short(value)}, needs {IMAGE_RULE}")
        return ""
    if value not in images:
        get.faults.add(place, f"got {short(value)}, needs an image of the team or a common one: {listed(sorted(images))}")
    return value


def _modem_config(get: Reader, entry: dict, place: str, storage: Storage) -> Path:
    value = entry.get("ModemConfig")
    if "ModemConfig" not in entry:
        return Path()
    if not isinstance(value, str) or not is_name(value):
        get.faults.add(place, f"got {short(value)}, needs the name of a file in {storage.config}")
        return Path()
    try:
        read_bytes(storage.config / value, limit=MAX_CONFIG)
    except CastError as error:
        get.faults.add(place, f"got {short(value)}, needs a file in {storage.config}: {error.faults[0]}")
    return storage.config / value


def _check_unique(get: Reader, entries: list, key: str) -> None:
    first = {}
    for index, entry in enumerate(entries):
        value = entry.get(key) if isinstance(entry, dict) else None
        if _is_integer(value) and first.setdefault(value, index) != index:
            get.faults.add(f"NodeData[{index}].{key}", f"got {value}, needs to be unique: NodeData[{first[value]}] has it")


def _loops(get: Reader, document: dict) -> int:
    """How often the job is played."""
    if "Loopinfo" not in document:
        return 1
    info = get.keys(document["Loopinfo"], "Loopinfo", ("Enabled", "NumOfLoops"), ("Enabled",))
    enabled = info.get("Enabled")
    if "Enabled" in info and not (isinstance(enabled, bool) or enabled in ("True", "False")):
        get.faults.add("Loopinfo.Enabled", f'got {short(enabled)}, needs true or false (or "True", "False")')
    is_enabled = enabled is True or enabled == "True"
    if is_enabled and "NumOfLoops" not in info:
        get.faults.add("Loopinfo", "NumOfLoops is missing")
    loops = _integer(get, info, "Loopinfo.NumOfLoops", "how often the job is played", 1, MAX_LOOPS)
    return loops if is_enabled else 1


def images_named(path: str | Path) -> tuple[str, ...]:
    """The images that a job names, whatever else is wrong with it; none of a file that cannot be read."""
    try:
        entries = json_file(path).document.get("NodeData")
    except CastError:
        return ()
    names = [entry.get("ImageName") for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []
    return tuple(dict.fromkeys(name for name in names if is_image_name(name)))
