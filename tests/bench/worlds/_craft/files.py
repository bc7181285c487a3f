# SPDX-License-Identifier: GPL-3.0-or-later
"""A case's files: twin.yaml and SigMF."""

import json
from pathlib import Path

import numpy as np

FULL = {
    "ci16_le": ("<i2", 32768.0, 0.0, -32768, 32767),
    "ci8": ("i1", 128.0, 0.0, -128, 127),
    "cu8": ("u1", 128.0, 127.5, 0, 255),
}
STEP = {"cf32_le": 0.0, "ci16_le": 1 / 32768, "ci8": 1 / 128, "cu8": 1 / 128}  # of the file's own numbers


def to_file(samples, datatype):
    """The bytes that a recorder writes for these complex samples."""
    if datatype == "cf32_le":
        return np.asarray(samples).astype("<c8").tobytes()
    kind, scale, middle, low, high = FULL[datatype]
    pairs = np.empty((len(samples), 2))
    pairs[:, 0], pairs[:, 1] = samples.real, samples.imag
    return np.clip(np.rint(pairs * scale + middle), low, high).astype(kind).tobytes()


def from_file(data, datatype):
    """The complex samples that a reader gets from these bytes."""
    if datatype == "cf32_le":
        return np.frombuffer(data, "<c8").astype(complex)
    kind, scale, middle, _, _ = FULL[datatype]
    pairs = (np.frombuffer(data, kind).reshape(-1, 2).astype(float) - middle) / scale
    return pairs[:, 0] + 1j * pairs[:, 1]


def through(samples, datatype):
    """What is left of the samples after the file."""
    return from_file(to_file(samples, datatype), datatype)


def write_sigmf(folder, stem, samples, datatype, rate_hz, carrier_hz):
    folder = Path(folder)
    (folder / f"{stem}.sigmf-data").write_bytes(to_file(samples, datatype))
    meta = {
        "global": {"core:datatype": datatype, "core:sample_rate": float(rate_hz), "core:version": "1.0.0"},
        "captures": [{"core:sample_start": 0, "core:frequency": float(carrier_hz)}],
        "annotations": [],
    }
    (folder / f"{stem}.sigmf-meta").write_text(json.dumps(meta, indent=1) + "\n")


def read_sigmf(folder, stem):
    folder = Path(folder)
    meta = json.loads((folder / f"{stem}.sigmf-meta").read_text())
    return from_file((folder / f"{stem}.sigmf-data").read_bytes(), meta["global"]["core:datatype"])


def scalar(value):
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        text = repr(float(value))
        if "e" in text and "." not in text.split("e")[0]:  # YAML 1.1 reads 1e-06 as a string
            text = text.replace("e", ".0e")
        return text.replace("e+", "e") if "e+" not in text else text
    return str(value)


def flow(value):
    """YAML's flow style, which needs no library."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(flow(v) for v in value) + "]"
    return scalar(value)


def twin_text(twin):
    """The twin as YAML: one line per waveform, node, tap, recording and effect."""
    out = []
    for key, value in twin.items():
        if key == "links":
            out.append("links:")
            for link in value:
                out += [f"- tx: {link['tx']}", f"  rx: {link['rx']}", "  taps:"]
                out += [f"  - {flow(tap)}" for tap in link["taps"]]
        elif isinstance(value, dict):
            out += [f"{key}:"] + [f"  {k}: {flow(v)}" for k, v in value.items()]
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            out += [f"{key}:"] + [f"- {flow(v)}" for v in value]
        else:
            out.append(f"{key}: {flow(value)}")
    return "\n".join(out) + "\n"
