# SPDX-License-Identifier: GPL-3.0-or-later
"""Valid files changed: trees of YAML and JSON as trees, tables and logs by lines and cells, all by bytes and cuts."""

import copy
import json
import math
import random
from contextlib import suppress

import yaml

ODD = (
    None, True, False, "", " ", "x", "1", "1e6", "nan", "NaN", "inf", ".inf", "../../evil", "/etc/passwd", "a\0b", "a\nb",
    "\x1b[31m", "é", "\ud800", "x" * 300, "0x10", "1_0", "tx1", "w1", "a>b",
    0, -0.0, -1, 1, 0.5, 2, 3, 255, 256, 257, 1e-300, 1e300, -1e300, 1e-9, 1e9, 2**31, 2**32, 2**53, 2**63, 2**64, -(2**63),
    10**40, 10**400, float("nan"), float("inf"), -float("inf"),
    [], {}, [[]], [{}], [None], {"": None}, {"a": {}}, [1] * 50, {"value": None}, {"value": 1.0, "std": None},
    {"per_recording": {}}, {"per_recording": {"r": 1}}, [[[[[[1]]]]]],
)  # fmt: skip
MOST_PLACES = 3000  # of a tree that are looked at: a change of a change of a change is not larger


TWICE = "\0"  # behind a key that is written as its double


def odd(rng: random.Random):
    return copy.deepcopy(rng.choice(ODD))


def _places(tree) -> list:
    """(container, key) of every value in a tree, the deepest last."""
    found, boxes = [], [tree]
    for box in boxes:
        if len(found) > MOST_PLACES:
            break
        for key in list(box) if isinstance(box, dict) else range(len(box)):
            found.append((box, key))
            if isinstance(box[key], (dict, list)):
                boxes.append(box[key])
    return found


class _Mark(str):
    """Text that stands in a document as it is."""


def _written(tree, is_yaml: bool) -> str:
    """A tree as JSON, or as YAML that is JSON but for odd numbers and plain words; cut at a megabyte."""
    parts, size, stack = [], 0, [tree]
    while stack and size < 1 << 20:
        one = stack.pop()
        if isinstance(one, dict):
            inner = [x for k, v in one.items() for x in (_Mark(json.dumps(str(k).rstrip(TWICE)) + ": "), v, _Mark(", "))]
            stack += [_Mark("}"), *reversed(inner[:-1])]
            text = "{"
        elif isinstance(one, list):
            stack += [_Mark("]"), *reversed([x for v in one for x in (v, _Mark(", "))][:-1])]
            text = "["
        elif is_yaml and isinstance(one, float) and not math.isfinite(one):
            text = ".nan" if math.isnan(one) else ".inf" if one > 0 else "-.inf"
        elif isinstance(one, _Mark) or is_yaml and isinstance(one, str) and one.isalnum():
            text = one
        else:
            text = json.dumps(one)
        parts.append(text)
        size += len(text)
    return "".join(parts)


def _mutate_tree(tree, rng: random.Random):
    """The tree with one change, or another tree in its place."""
    places = _places(tree) if isinstance(tree, (dict, list)) else []
    if not places or rng.random() < 0.01:
        return odd(rng)
    box, key = rng.choice(places)
    kind = rng.choice(("drop", "odd", "odd", "odd", "copy", "wrap", "grow", "double", "rename", "scale", "deep", "many"))
    if kind == "drop":
        del box[key]
    elif kind == "odd":
        box[key] = odd(rng)
    elif kind == "copy":
        other, place = rng.choice(places)
        with suppress(RecursionError):  # of what was made deep before: it stays where it is
            box[key] = copy.deepcopy(other[place])
    elif kind == "double" and isinstance(box, dict):
        box[f"{key}{TWICE}"] = copy.copy(box[key]) if rng.random() < 0.5 else odd(rng)
    elif kind == "wrap":
        box[key] = rng.choice(([box[key]], {"value": box[key]}, {str(key): box[key]}))
    elif kind == "grow":
        if isinstance(box, list):
            box.extend([box[key]] * rng.choice((1, 2, 300)))
        else:
            box[rng.choice(("x", "offset", "value", "", "../x", "1", "a\nb"))] = odd(rng)
    elif kind == "rename" and isinstance(box, dict):
        box[rng.choice((str(key)[:-1], str(key).upper(), str(key) + "_", "../" + str(key), "1", "on"))] = box.pop(key)
    elif kind == "scale" and isinstance(box[key], (int, float)) and not isinstance(box[key], bool):
        with suppress(OverflowError):  # the largest stay as they are
            box[key] = box[key] * rng.choice((-1, 0, 1e-12, 1e3, 1e6, 1e12, 1e30)) + rng.choice((0, 0, 1, 1e-12))
    elif kind == "deep":
        value = box[key]
        for _ in range(rng.choice((5, 70, 400))):
            value = [value]
        box[key] = value
    elif kind == "many":
        box[key] = [rng.choice(ODD[:50]) for _ in range(rng.choice((3, 20, 2000)))]
    return tree


def _mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        at = rng.randrange(len(data) + 1)
        kind = rng.choice(("flip", "put", "cut", "remove", "repeat", "number"))
        if kind == "flip" and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif kind == "put":
            data[at:at] = rng.choice(
                (b"\0", b"\xff", b"{", b"[", b'"', b":", b"- ", b"\n", b"&a ", b"*a", b"!!x ", b"? ", b",", b"\x80")
            )
        elif kind == "cut":
            del data[at:]
        elif kind == "remove":
            del data[at : at + rng.choice((1, 4, 64))]
        elif kind == "repeat":
            data[at:at] = data[at : at + rng.choice((1, 16, 256))] * rng.choice((1, 3, 100))
        elif kind == "number":
            data[at : at + rng.choice((0, 1, 4))] = rng.choice(
                (b"9" * 400, b"-1", b"1e999", b"nan", b"\xff\xff\xff\x7f", b"\0\0\0\x80")
            )
    return bytes(data)


def _mutate_lines(text: str, rng: random.Random) -> str:
    """A table or a log with lines and cells changed."""
    lines = text.split("\n")
    at = rng.randrange(len(lines))
    kind = rng.choice(("drop", "double", "swap", "cell", "cell", "cell", "more", "cut"))
    if kind == "drop":
        del lines[at]
    elif kind == "double":
        lines[at:at] = [lines[at]] * rng.choice((1, 500))
    elif kind == "swap":
        other = rng.randrange(len(lines))
        lines[at], lines[other] = lines[other], lines[at]
    elif kind == "more":
        lines[at] += rng.choice((";", ",", ",,,,", " x>1", '"', " flow>1", "\0", "\r", "é"))
    elif kind == "cut":
        lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)]
    else:
        for mark in rng.sample((";", ",", " ", ">", ":", '"', "/"), 7):
            if mark in lines[at]:
                cells = lines[at].split(mark)
                cells[rng.randrange(len(cells))] = rng.choice(
                    ("", "x", "nan", "inf", "-1", "1e400", "9" * 5000, "0x1", "1_0", "²", "-")
                )
                lines[at] = mark.join(cells)
                break
    return "\n".join(lines)


def mutated(data: bytes, name: str, rng: random.Random) -> bytes:
    """A valid file changed."""
    is_yaml, is_table = name.endswith((".yaml", ".yml")), name.endswith((".csv", ".log", ".p2m", ".obj", ".osm", ".dae"))
    is_json = name.endswith((".json", ".sigmf-meta", ".zattrs", ".zarray"))
    if rng.random() < 0.3 or not (is_yaml or is_json or is_table):
        return _mutate_bytes(data, rng)
    if is_table:
        text = data.decode()
        for _ in range(rng.choice((1, 1, 2, 5))):
            text = _mutate_lines(text, rng)
        return text.encode("utf-8", "surrogatepass")
    tree = yaml.safe_load(data) if is_yaml else json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        tree = _mutate_tree(tree, rng)
    text = _written(tree, is_yaml)
    if is_yaml and rng.random() < 0.1 and text.endswith("}"):  # aliases of aliases
        levels = range(rng.choice((2, 9)))
        text = text[:-1] + "".join(f", z{k}: &z{k} [{', '.join([f'*z{k - 1}' if k else '1'] * 9)}]" for k in levels) + "}"
    return text.encode("utf-8", "surrogatepass")
