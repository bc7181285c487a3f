# SPDX-License-Identifier: GPL-3.0-or-later
"""SigMF and twin.yaml as the contract of cases has them."""

import json
from pathlib import Path

import numpy as np
import yaml

INTEGERS = {"ci16_le": ("<i2", 32768.0, 0.0), "ci8": ("i1", 128.0, 0.0), "cu8": ("u1", 128.0, 127.5)}


def encoded(samples, datatype):
    if datatype == "cf32_le":
        return np.asarray(samples).astype("<c8")
    kind, scale, middle = INTEGERS[datatype]
    pairs = np.stack([samples.real, samples.imag], -1) * scale + middle
    limits = np.iinfo(kind)
    return np.clip(np.rint(pairs), limits.min, limits.max).astype(kind)


def decoded(raw, datatype):
    if datatype == "cf32_le":
        return np.frombuffer(raw, "<c8").astype(complex)
    kind, scale, middle = INTEGERS[datatype]
    pairs = (np.frombuffer(raw, kind).astype(float) - middle) / scale
    return pairs[::2] + 1j * pairs[1::2]


def write(folder, stem, samples, datatype, rate, carrier_hz):
    folder = Path(folder)
    (folder / f"{stem}.sigmf-data").write_bytes(encoded(samples, datatype).tobytes())
    capture = {"core:sample_start": 0}
    if carrier_hz is not None:
        capture["core:frequency"] = carrier_hz
    head = {"core:datatype": datatype, "core:sample_rate": rate, "core:version": "1.0.0"}
    meta = {"global": head, "captures": [capture], "annotations": []}
    (folder / f"{stem}.sigmf-meta").write_text(json.dumps(meta, indent=1) + "\n")


def read(folder, stem):
    folder = Path(folder)
    meta = json.loads((folder / f"{stem}.sigmf-meta").read_text())
    return decoded((folder / f"{stem}.sigmf-data").read_bytes(), meta["global"]["core:datatype"])


def plain(value):
    """NumPy scalars as Python's, for YAML and JSON."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def write_twin(folder, twin):
    text = yaml.safe_dump(plain(twin), sort_keys=False, default_flow_style=None, width=200)
    (Path(folder) / "twin.yaml").write_text(text)
