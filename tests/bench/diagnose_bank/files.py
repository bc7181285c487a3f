# SPDX-License-Identifier: GPL-3.0-or-later
"""A case as the contract's folder: twin.yaml and SigMF."""

import json

import numpy as np
import yaml

# numbers = samples · scale + middle, as the type
KINDS = {"ci16_le": (32768, 0, "<i2"), "ci8": (128, 0, "i1"), "cu8": (128, 127.5, "u1")}


def encoded(samples, datatype):
    """Complex samples as the numbers that a file of this type holds, I and Q in turn."""
    x = np.asarray(samples)
    if datatype == "cf32_le":
        return x.astype("<c8")
    scale, middle, kind = KINDS[datatype]
    limits = np.iinfo(kind)
    pairs = np.stack([x.real, x.imag], 1) * scale + middle
    return np.clip(np.round(pairs), limits.min, limits.max).astype(kind)


def decoded(numbers, datatype):
    """What a reader of the file gets: complex samples."""
    if datatype == "cf32_le":
        return numbers.astype(complex)
    scale, middle, _ = KINDS[datatype]
    pairs = (numbers - float(middle)) / scale
    return pairs[:, 0] + 1j * pairs[:, 1]


def write_samples(folder, stem, samples, datatype, rate, carrier_hz):
    encoded(samples, datatype).tofile(folder / f"{stem}.sigmf-data")
    meta = {
        "global": {"core:datatype": datatype, "core:sample_rate": rate, "core:version": "1.0.0"},
        "captures": [{"core:sample_start": 0, "core:frequency": carrier_hz}],
        "annotations": [],
    }
    (folder / f"{stem}.sigmf-meta").write_text(json.dumps(meta, indent=1) + "\n")


def write_case(folder, twin, waveforms, recordings, datatype):
    """waveforms: {key: Waveform}; recordings: {stem: samples}. Adds `waveforms` to the twin; writes all."""
    folder.mkdir(parents=True)
    rate, carrier = twin["sample_rate_hz"], twin["center_frequency_hz"]
    entries = {}
    for key, w in waveforms.items():
        if w.code:
            entries[key] = w.code
            continue
        stem = f"reference_{key}"
        write_samples(folder, stem, w.samples, "cf32_le", rate, carrier)
        entries[key] = {"file": stem, "repeat": w.repeat}
    for stem, samples in recordings.items():
        write_samples(folder, stem, samples, datatype, rate, carrier)
    ordered = {
        "cast_twin": 1,
        "sample_rate_hz": rate,
        "center_frequency_hz": carrier,
        "waveforms": entries,
        **{k: v for k, v in twin.items() if k not in ("sample_rate_hz", "center_frequency_hz")},
    }
    (folder / "twin.yaml").write_text(yaml.safe_dump(ordered, sort_keys=False, default_flow_style=None))
