# SPDX-License-Identifier: GPL-3.0-or-later
"""The one strict reader of documents: YAML and JSON become plain values within limits, and every fault is named with its place.

Size is limited before anything is built, aliases counted as often as they are used; a key stands once; keys are text; `1e6` is
a number, "1e6" and true are none. `yaml_file`, `json_file` and `json_text` give a `Reader`: the document, what is wrong with it
so far, and getters that note what else is, so that all faults come at once.
"""

import json
import math
import os
import re
import reprlib
import stat
from collections import Counter
from pathlib import Path

import yaml

from .errors import CastError, Faults
from .files import NAME_RULE, is_inside, is_name
from .frequencies import hertz

MAX_BYTES = 64 << 20  # of a file, and of its text with aliases written out
MAX_VALUES = 2_000_000  # of a document, aliases written out: some 500 MB once they are Python's
MAX_DEPTH = 64  # of lists and mappings in one another; Python's own limit lies near 1000
LONGEST_NUMBER = 400  # characters; the smallest double written out has 330
MAX_WHOLE = 1 << 64  # larger whole numbers are none of any field, and slow to print

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml where it is there: ten times faster
_WORDS = {"": None, "~": None} | {
    form: value
    for words, value in ((("null",), None), (("true", "yes", "on"), True), (("false", "no", "off"), False))
    for word in words
    for form in (word, word.capitalize(), word.upper())
}
_WHOLE = re.compile(r"[-+]?(?:0|[1-9][0-9_]*)")
_HEX = re.compile(r"[-+]?0x[0-9a-fA-F_]+")
_REAL = re.compile(r"[-+]?(?:(?:[0-9][0-9_]*)?\.[0-9][0-9_]*|[0-9][0-9_]*\.?)(?:[eE][-+]?[0-9]+)?")
_ENDLESS = re.compile(r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq")} | {"!"}
_UNPRINTABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")  # in no text: they end or forge what is shown


class _Brief(reprlib.Repr):
    """Values in the words of documents: Python's None and True are nobody's who wrote YAML or JSON."""

    def repr_NoneType(self, value, level) -> str:
        return "null"

    def repr_bool(self, value, level) -> str:
        return "true" if value else "false"


def short(value) -> str:
    """A value as a message shows it, on one line of some 60 characters, however large it is."""
    brief = _Brief()
    brief.maxlevel, brief.maxstring, brief.maxother, brief.maxlong = 2, 60, 60, 40
    brief.maxlist = brief.maxdict = 4
    text = brief.repr(value)
    return text if len(text) < 60 else text[:57] + "..."


def listed(names) -> str:
    """Names as a message lists them, the first twenty."""
    names = [str(name)[:60] for name in names]
    return ", ".join(names[:20]) + (", …" if len(names) > 20 else "") or "none"


def read_bytes(path: str | Path, *, missing: str = "", limit: int = MAX_BYTES) -> bytes:
    """A file of at most `limit` bytes; `missing` goes on where the message of a missing file ends."""
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:  # a FIFO would wait
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise CastError(f"{path}: not a file")
            data = file.read(limit + 1)
    except FileNotFoundError:
        raise CastError(f"{path}: no such file{missing}") from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise CastError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > limit:
        raise CastError(f"{path}: got more than {limit} bytes, limit {limit} bytes")
    return data


def read_text(path: str | Path, *, missing: str = "", limit: int = MAX_BYTES) -> str:
    """`read_bytes` as text, UTF-8."""
    data = read_bytes(path, missing=missing, limit=limit)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CastError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None


class Reader:
    """A document and its faults. Every getter notes what is wrong at `place` and gives something of its type to go on with."""

    def __init__(self, where: str, document=None):
        self.document = document
        self.faults = Faults(where)

    def keys(self, mapping, place: str, allowed, required=()) -> dict:
        """A mapping of no key but `allowed`, with all of `required`."""
        mapping = self.mapping(mapping, place)
        for key in mapping:
            if key not in allowed:
                self.faults.add(place, f"unknown key {short(key)}, knows {', '.join(sorted(map(str, allowed))) or 'none'}")
        for key in required:
            if key not in mapping:
                self.faults.add(place, f"{key} is missing")
        return mapping

    def version(self, key: str, version: int) -> None:
        """The document names its format's version under `key`."""
        value = self.document.get(key)
        if not is_number(value) or value != version:
            self.faults.add(key, f"got {short(value)}, needs {version}: the version of this format")

    def number(self, value, place: str, unit: str = "", low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number in [low, high], else NaN."""
        try:
            number = float(value) if is_number(value) else math.nan
        except OverflowError:
            number = math.nan
        if math.isfinite(number) and low <= number <= high:
            return number
        limit = {(False, False): "", (True, False): f" of {low:g} or more", (False, True): f" up to {high:g}"}.get(
            (low > -math.inf, high < math.inf), f" in {low:g} to {high:g}"
        )
        self.faults.add(place, f"got {short(value)}, needs a finite number{f' of {unit}' if unit else ''}{limit}")
        return math.nan

    def hertz(self, value, place: str, least_hz: float, what: str, high_hz: float = math.inf) -> float:
        """A frequency above 0 as on the command line (`frequencies`): a number, or text such as 20M or 2400Hz; else NaN."""
        try:
            number_hz = hertz(value if is_number(value) or isinstance(value, str) else short(value), least_hz, what)
            if 0 < number_hz <= high_hz:
                return number_hz
            self.faults.add(place, f"got {short(value)}, needs a frequency above 0, at most {high_hz:g} Hz")
        except (ValueError, OverflowError) as error:
            self.faults.add(place, str(error))
        return math.nan

    def whole(self, value, place: str, unit: str, low: int, high: int) -> int:
        """A whole number in [low, high], else `low`; 1e3 is one."""
        if is_number(value) and low <= value <= high and value == int(value):
            return int(value)
        self.faults.add(place, f"got {short(value)}, needs a whole number of {unit} in {low} to {high}")
        return low

    def truth(self, value, place: str) -> bool:
        if not isinstance(value, bool):
            self.faults.add(place, f"got {short(value)}, needs true or false")
        return value is True

    def text(self, value, place: str) -> str:
        """Text that is not blank, else ""; a whole number stands for its digits."""
        if isinstance(value, (str, int)) and not isinstance(value, bool) and str(value).strip():
            return str(value)
        self.faults.add(place, f"got {short(value)}, needs text")
        return ""

    def name(self, value, place: str) -> str:
        """A name that may become one step of a path, else ""."""
        text = self.text(value, place)
        if not text or is_name(text):
            return text
        self.faults.add(place, f"got {short(value)}, needs a name: {NAME_RULE}")
        return ""

    def path_inside(self, value, place: str) -> str:
        """A name, with folders perhaps, that stays inside the document's folder, else ""."""
        text = self.text(value, place)
        if not text or is_inside(text):
            return text
        self.faults.add(place, f"got {short(value)}, needs a name inside the folder, each step of it {NAME_RULE}")
        return ""

    def choice(self, value, place: str, choices):
        """One of `choices`, else the first."""
        choices = tuple(choices)
        if isinstance(value, str) and value in choices:
            return value
        self.faults.add(place, f"got {short(value)}, needs one of {', '.join(choices)}")
        return choices[0]

    def sequence(self, value, place: str) -> list:
        if isinstance(value, list):
            return value
        self.faults.add(place, f"got {short(value)}, needs a list")
        return []

    def mapping(self, value, place: str) -> dict:
        if isinstance(value, dict):
            return value
        self.faults.add(place, f"got {short(value)}, needs a mapping")
        return {}


def is_number(value) -> bool:
    """Whether a value is a number: true and false are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def yaml_file(path: str | Path, *, missing: str = "") -> Reader:
    """The mapping of a YAML file. Raises CastError where it cannot be read at all; doubled keys and the like are faults."""
    text = read_text(path, missing=missing)
    reader = Reader(str(path))
    reader.document = _Composer(text, reader.faults).document()
    return _checked(reader, dict)


def json_file(path: str | Path, *, kind: type | tuple = dict, missing: str = "") -> Reader:
    """The document of a JSON file, an object or what `kind` says. Raises CastError where it cannot be read at all."""
    return json_text(read_text(path, missing=missing), str(path), kind=kind)


def json_text(text: str | bytes, where: str, *, kind: type | tuple = dict) -> Reader:
    """`json_file` of a text, or of bytes that came from elsewhere; `where` begins its messages."""
    if len(text) > MAX_BYTES:
        raise CastError(f"{where}: got {len(text)} bytes, limit {MAX_BYTES} bytes")
    try:
        text = text if isinstance(text, str) else text.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CastError(f"{where}: not UTF-8 text: {error.reason} at byte {error.start}") from None
    most = 1 + sum(map(text.count, ",[{"))  # commas within text count too: that many values are far from any file
    if most > MAX_VALUES:
        raise CastError(f"{where}: got some {most} values, limit {MAX_VALUES}")
    reader = Reader(where)
    try:
        reader.document = json.loads(text, object_pairs_hook=_object)
    except (ValueError, RecursionError) as error:
        raise CastError(f"{where}: not JSON: {_brief(error)}") from None
    return _checked(reader, kind, endless=False)


def is_cut(data: bytes) -> bool:
    """Whether more may still come of a JSON document: it ends too early, and is no nonsense before."""
    try:
        json.loads(data.decode())
    except UnicodeDecodeError as error:
        return error.reason == "unexpected end of data"
    except json.JSONDecodeError as error:
        return error.pos >= len(error.doc.rstrip()) or error.msg.startswith("Unterminated string")
    except (ValueError, RecursionError):
        pass  # the strict reader says why
    return False


class _Doubled(dict):
    """An object that named `keys_twice`, until its place is known."""

    keys_twice: tuple = ()


def _object(pairs: list) -> dict:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        mapping = _Doubled(reversed(pairs))  # the first of each is gone on with
        mapping.keys_twice = tuple(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
    return mapping


def _brief(error: Exception) -> str:
    text = str(error).partition("; use sys.")[0]  # what Python's own programmers may do about it
    return "nested too deep" if isinstance(error, RecursionError) else " ".join(text.split())


def _checked(reader: Reader, kind: type | tuple, endless: bool = True) -> Reader:
    """The reader, once its document is of its kind and no text or number in it is beyond all fields; `endless` ones may be."""
    if not isinstance(reader.document, kind):
        needs = " or ".join({dict: "a mapping", list: "a list"}[one] for one in (kind if isinstance(kind, tuple) else (kind,)))
        raise CastError(f"{reader.faults.where}: got {short(reader.document)}, needs {needs}")
    boxes = [(reader.document, "", 1)]
    while boxes:
        box, place, depth = boxes.pop()
        if depth > MAX_DEPTH:
            raise CastError(f"{reader.faults.where}: {place[:60]}…: nested too deep, limit {MAX_DEPTH}")
        is_mapping = isinstance(box, dict)
        for key in box.keys_twice if isinstance(box, _Doubled) else ():
            reader.faults.add(place, f"the key {short(key)} is given twice")
        for key, value in box.items() if is_mapping else enumerate(box):
            fault = _never(key) if is_mapping else None
            if isinstance(value, (dict, list)):
                boxes.append((value, _below(place, key), depth + 1))
            else:
                fault = fault or _never(value, endless)
            if fault:
                reader.faults.add(_below(place, key), fault, last=True)
    return reader


def _below(place: str, key) -> str:
    """The place of a key of a mapping, or of an index of a list, below another."""
    return f"{place}[{key}]" if isinstance(key, int) else f"{place}.{short(key)[1:-1]}" if place else short(key)[1:-1]


def _never(value, endless: bool = True) -> str | None:
    """What is wrong with a value whatever the field."""
    if isinstance(value, str) and not (value.isascii() and value.isprintable()) and (bad := _UNPRINTABLE.search(value)):
        return f"got {short(value)}, text holds no character {bad[0]!r}"
    if isinstance(value, int) and abs(value) > MAX_WHOLE:
        return f"got a whole number of {value.bit_length()} bits, limit 64 bits"
    if isinstance(value, float) and not endless and not math.isfinite(value):
        return f"got {value}, needs a finite number"
    return None


class _Composer:
    """Builds a document from the events of a YAML parser, counting first."""

    def __init__(self, text: str, faults: Faults):
        self._events = yaml.parse(text, _LOADER)
        self._faults = faults
        self._anchors: dict = {}  # name → (value, its values, its characters), None while it is built
        self._values = self._characters = 0

    def document(self):
        try:
            next(self._events)  # the stream's beginning
            if isinstance(next(self._events), yaml.StreamEndEvent):
                return None
            value = self._value(next(self._events), "", 1)
            next(self._events)  # the document's end
            if not isinstance(next(self._events), yaml.StreamEndEvent):
                raise CastError(f"{self._faults.where}: holds more than one document")
            return value
        except (yaml.YAMLError, ValueError) as error:
            raise CastError(f"{self._faults.where}: not YAML: {_brief(error)}") from None

    def _refuse(self, event, message: str):
        raise CastError(f"{self._faults.where}: line {event.start_mark.line + 1}: {message}")

    def _take(self, event, values: int, characters: int) -> None:
        self._values += values
        self._characters += characters
        if self._values > MAX_VALUES:
            self._refuse(
                event, f"got more than {MAX_VALUES} values, limit {MAX_VALUES}, aliases counted as often as they are used"
            )
        if self._characters > MAX_BYTES:
            self._refuse(event, f"got more than {MAX_BYTES} characters, aliases counted as often as they are used")

    def _value(self, event, place: str, depth: int):
        if isinstance(event, yaml.AliasEvent):
            if self._anchors.get(event.anchor) is None:
                self._refuse(event, f"the alias *{short(event.anchor)[1:-1]} stands before or within what it is for")
            value, *size = self._anchors[event.anchor]
            self._take(event, *size)
            return value
        before = self._values, self._characters
        self._take(event, 1, len(event.value) if isinstance(event, yaml.ScalarEvent) else 0)
        if event.anchor:
            self._anchors[event.anchor] = None
        if isinstance(event, yaml.ScalarEvent):
            value = self._scalar(event)
        elif depth > MAX_DEPTH:
            self._refuse(event, f"nested too deep, limit {MAX_DEPTH}")
        elif event.tag not in (None, *_TAGS):
            self._refuse(event, f"got the tag {short(event.tag)}, no tags are known here")
        else:
            value = (self._list if isinstance(event, yaml.SequenceStartEvent) else self._mapping)(place, depth)
        if event.anchor:
            self._anchors[event.anchor] = (value, self._values - before[0], self._characters - before[1])
        return value

    def _list(self, place: str, depth: int) -> list:
        found = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            found.append(self._value(event, _below(place, len(found)), depth + 1))
        return found

    def _mapping(self, place: str, depth: int) -> dict:
        found = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent) or event.anchor:
                self._refuse(event, "a key must be plain text")
            self._take(event, 0, len(event.value))
            where = _below(place, event.value)
            value = self._value(next(self._events), where, depth + 1)
            if event.value in found:
                self._faults.add(place, f"line {event.start_mark.line + 1}: the key {short(event.value)} is given twice")
            found.setdefault(event.value, value)
        return found

    def _scalar(self, event):
        if event.tag not in (None, "!", "tag:yaml.org,2002:str"):
            self._refuse(event, f"got the tag {short(event.tag)}, no tags are known here")
        return _plain(event.value) if event.implicit[0] and event.tag is None else event.value


def _plain(text: str):
    """What a scalar without quotes is: nothing, true or false, a number, else text."""
    if text in _WORDS:
        return _WORDS[text]
    if not (text[0].isdigit() or text[0] in "+-.") or len(text) > LONGEST_NUMBER:
        return text
    if _WHOLE.fullmatch(text):
        return int(text.replace("_", ""))
    if _HEX.fullmatch(text):
        return int(text.replace("_", ""), 16)
    if _ENDLESS.fullmatch(text):
        return float(text.replace(".", "", 1))
    if _REAL.fullmatch(text) and not text.lstrip("+-").isdecimal():
        return float(text.replace("_", ""))
    return text


class _Dumper(yaml.SafeDumper):
    """Writes every entry in full, for people, and in quotes the text that would be read as a number here."""

    def ignore_aliases(self, data):
        return True


_Dumper.add_representer(
    str,
    lambda dumper, text: dumper.represent_scalar(
        "tag:yaml.org,2002:str", text, style="'" if isinstance(text, str) and text and not isinstance(_plain(text), str) else None
    ),
)


def yaml_text(document, **style) -> str:
    """A document of plain values as YAML that `yaml_file` reads as the same; `style` as `yaml.dump` has it."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, **style)
