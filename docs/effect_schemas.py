# SPDX-License-Identifier: GPL-3.0-or-later
"""JSON Schemas of effects and diagnoses: entries from what every family declares of its parameters, the rest as it is written."""

from gr_cast.report.link.page import EXPERIMENTS
from gr_cast.twin.contract import KEYS, MEASURED, Known, limits
from gr_cast.twin.effects import FAMILIES, NAMED, Value
from gr_cast.twin.places.families import FAMILIES as OF_PLACES

NUMBER, TEXT = {"type": "number"}, {"type": "string"}
NUMBER_OR_NULL, TEXT_OR_NULL = (
    {"type": ["number", "null"]},
    {"type": ["string", "null"]},
)  # null: there is none, or none is finite
NAMES = {"type": "array", "items": TEXT}
INTERVAL = {"anyOf": [{"type": "array", "items": NUMBER, "minItems": 2, "maxItems": 2}, {"type": "null"}]}
VERDICTS = {"enum": ["no_mismatch", "identified", "ambiguous", "unexplained"]}
FIT = ("twin_nmse_db", "corrected_nmse_db", "noise_floor_db")
FIT_OF_POWERS = ("twin_rmse_db", "corrected_rmse_db", "noise_rmse_db")


def mapping(properties: dict, *required: str, closed: bool = True) -> dict:
    found = {"type": "object", "properties": properties, "required": list(required)}
    return found | ({"additionalProperties": False} if closed else {})


def every(properties: dict) -> dict:
    """A mapping that must have all its keys."""
    return mapping(properties, *properties)


def one(name: str, value: Value) -> dict:
    """What may stand under a name, within limits that hold at every sample rate."""
    if value.words:
        return {"enum": list(value.words)}
    if value.kind is bool:
        return {"type": "boolean"}
    if value.kind is str:
        return TEXT
    told = [limits(name, value, Known(nodes=(), links=(), waveforms=(), rate_hz=rate_hz)) for rate_hz in (1.0, 1e12)]
    (unit, *ends), (_, *others) = told
    number = {"type": "integer" if value.whole else "number"} | ({"description": f"in {unit}"} if unit else {})
    pairs = zip(("minimum", "maximum"), ends, others, strict=True)
    return number | {key: end for key, end, other in pairs if end == other}


def parameter(name: str, value: Value) -> dict:
    plain = one(name, value)
    told = mapping({"value": plain, "std": {"type": ["number", "null"], "minimum": 0}}, "value")
    by_recording = {"type": "object", "additionalProperties": {"anyOf": [told, plain]}, "minProperties": 1}
    return {"anyOf": [plain, told, every({"per_recording": by_recording})]}


def _of_family(name: str) -> dict:
    """What an entry of this family holds beside what all do."""
    family = FAMILIES[name]
    parameters = {key: parameter(key, value) for key, value in family.parameters.items()}
    needed = [key for key, value in family.parameters.items() if value.needed]
    model = {key: {"type": "array", "items": one(key, v)} if v.many else one(key, v) for key, v in family.remembered.items()}
    model |= {key: {"type": "object", "additionalProperties": NUMBER} for key in MEASURED}
    return {
        "properties": {
            "parameters": mapping(parameters, *needed),
            "model": mapping(model) | {"type": ["object", "null"]},
            "owner": {"properties": {"level": {"enum": list(family.owners)}}},
        }
    }


def entry(**more: dict) -> dict:
    """An entry of `effects`; `more` are keys that it must have, and what they hold."""
    owner = mapping({"level": TEXT, "name": TEXT, "alternatives": {"type": "array"}}, "level", "name")
    own = {"family": {"enum": list(NAMED)}, "owner": owner, "parameters": {"type": "object"}}
    properties = {key: {} for key in sorted(KEYS)} | own | more
    families = [{"if": {"properties": {"family": {"const": name}}}, "then": _of_family(name)} for name in NAMED]
    return mapping(properties, *own, *more) | {"allOf": families}


def diagnosis() -> dict:
    """`diagnosis.json` of links."""
    where = {key: INTERVAL for key in ("delay_s", "time_s", "frequency_hz", "amplitude")}
    evidence = {key: NUMBER_OR_NULL for key in ("heldout_gain_nats", "runner_up_margin_nats", "explains_db")}
    record_next = {"enum": [*EXPERIMENTS, None]}
    left = {"test": TEXT, "recording": TEXT, "sentence": TEXT, "signal_absent": {"const": True}, "confidence": NUMBER}
    residual = {
        "unexplained_db": NUMBER_OR_NULL,
        "p_value": NUMBER_OR_NULL,
        "tested": NAMES,
        "where": {"type": "array", "items": mapping(left, "test", "recording", closed=False)},
        "record_next": record_next,
        "out_of_time": {"type": "boolean"},
    }
    effects = entry(
        where=every(where | {"recording": {"anyOf": [TEXT, NAMES]}}),
        evidence=every(evidence | {"runner_up": TEXT_OR_NULL}),
        confidence={"type": "number", "minimum": 0, "maximum": 1},
        sentence=TEXT,
        model={"type": "object"},
    )
    open_ones = {"families": NAMES | {"minItems": 2}, "why": TEXT, "record_next": record_next}
    fit = every({name: NUMBER_OR_NULL for name in (*FIT, "heldout_gain_nats")} | {"split": {"const": "vault"}})
    return _document("A diagnosis of links, cast_diagnosis: 1", effects, open_ones, fit, residual)


def place_diagnosis() -> dict:
    """`diagnosis.json` of a place."""
    numbers = {"anyOf": [NUMBER_OR_NULL, TEXT, {"type": ["array", "boolean"]}]}
    told = {"anyOf": [mapping({"value": numbers, "std": numbers}, "value"), TEXT]}
    parameters = {"type": "object", "additionalProperties": told}
    evidence = {key: NUMBER_OR_NULL for key in ("gain_nats", "heldout_gain_nats", "runner_up_margin_nats")}
    box = {"type": "array", "items": {"type": "array", "items": NUMBER, "minItems": 3, "maxItems": 3}}
    where = {"links": NAMES, "time_s": INTERVAL, "delay_s": INTERVAL, "position_m": box, "extent_m": box}
    effect = {
        "family": {"enum": sorted({family.name for family in OF_PLACES})},
        "owner": mapping({"level": TEXT, "name": TEXT, "alternatives": NAMES}, "level", "name"),
        "where": mapping(where, "links", "time_s", "delay_s"),
        "parameters": parameters,
        "evidence": every(evidence | {"runner_up": TEXT_OR_NULL}),
        "confidence": {"type": "number", "minimum": 0, "maximum": 1},
        "sentence": TEXT,
    }
    spot = every({"node": TEXT, "position_m": {"type": "array", "items": NUMBER}, "why": TEXT})
    open_ones = {"families": NAMES | {"minItems": 2}, "why": TEXT, "record_next": {"anyOf": [TEXT, spot]}}
    left = {"type": "array", "items": every({"links": NAMES, "deviations": NUMBER})}
    residual = {"unexplained_db": NUMBER, "p_value": NUMBER, "where": left, "out_of_time": {"type": "boolean"}}
    split = {"split": {"enum": ["vault", "fitted"]}}
    fit = {"anyOf": [every({name: NUMBER_OR_NULL for name in names} | split) for names in (FIT, FIT_OF_POWERS)]}
    return _document("A diagnosis of a place, cast_diagnosis: 1", every(effect), open_ones, fit, residual)


def _document(title: str, effect: dict, open_ones: dict, fit: dict, residual: dict) -> dict:
    keys = {
        "cast_diagnosis": {"const": 1},
        "verdict": VERDICTS,
        "effects": {"type": "array", "items": effect},
        "ambiguous": {"type": "array", "items": every(open_ones)},
        "fit": fit,
        "residual": every(residual),
        "seconds": NUMBER,
    }
    whole = mapping(keys | {"warnings": NAMES}, *keys)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title} | whole
