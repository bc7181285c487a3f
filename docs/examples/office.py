#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""A worked example: an office whose glass partition nobody drew. Its path loss looks right, its correlation looks right.

The soundings are those of another tracer (tests/bench/places), which has the partition, 10 cm of glass blocks between the
office and the corridor behind it. The office's are for the diagnosis, the corridor's for the vault.

    docs/examples/office.py make FOLDER      FOLDER/office: a place case; prints what path loss and correlation say of its twin
    docs/examples/office.py foretell FOLDER SPEC    what a SPEC foretells of the corridor, by that other tracer
"""

import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench" / "places"))
from unknowns import excess
from world import new_world, read_spec, response

CARRIER_HZ, BANDWIDTH_HZ, TONES, SNR_DB = 3.5e9, 200e6, 40, 12.0
UNKNOWN = {"phase": "snapshot", "delay": "none", "gain": "none"}
LONG_M, WIDE_M, HIGH_M, PARTITION_M = 14.0, 9.0, 2.8, 6.2
NODES = {  # m
    "desk": (3.2, 4.4, 1.1),
    "sofa": (11.2, 1.2, 0.9),
    "printer": (6.8, 2.6, 1.3),
    "table": (9.4, 4.6, 1.0),
    "wall_west": (0.4, 2.6, 2.2),
    "wall_east": (13.6, 3.4, 2.2),
    "door": (0.5, 8.2, 2.2),
    "plant": (5.1, 7.3, 1.2),
    "lift": (13.4, 7.2, 2.2),
    "sign": (9.7, 8.3, 1.9),
}
CORRIDOR = list(combinations(("door", "plant", "lift", "sign"), 2))
OFFICE = list(combinations([name for name in NODES if name not in {*sum(CORRIDOR, ())}], 2))


def quad(*corners) -> np.ndarray:
    a, b, c, d = (np.array(corner, float) for corner in corners)
    return np.array([[a, b, c], [a, c, d]])


def office() -> dict:
    """The world as the sounders meet it, without the partition; in the north it is open to the yard."""
    x, y, z = LONG_M, WIDE_M, HIGH_M
    shell = {
        "floor": (quad((0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0)), "concrete"),
        "ceiling": (quad((0, 0, z), (x, 0, z), (x, y, z), (0, y, z)), "ceiling_board"),
        "south": (quad((0, 0, 0), (x, 0, 0), (x, 0, z), (0, 0, z)), "brick"),
        "west": (quad((0, 0, 0), (0, y, 0), (0, y, z), (0, 0, z)), "plasterboard"),
        "east": (quad((x, 0, 0), (x, y, 0), (x, y, z), (x, 0, z)), "plasterboard"),
        "cupboard": (quad((8.0, 0.6, 0), (10.0, 0.6, 0), (10.0, 0.6, 1.9), (8.0, 0.6, 1.9)), "metal"),
        "garage": (quad((5.0, y + 1.2, 0), (9.0, y + 1.2, 0), (9.0, y + 1.2, z), (5.0, y + 1.2, z)), "concrete"),
        "stairs": (quad((5.0, -1.2, 0), (9.0, -1.2, 0), (9.0, -1.2, z), (5.0, -1.2, z)), "concrete"),
    }
    still = {"speed_m_per_s": 0.0, "antenna": "iso", "orientation_rad": [0.0] * 3}
    nodes = {name: {"waypoints_m": [list(place)], **still} for name, place in NODES.items()}
    return new_world() | {
        "objects": {name: {"tris": tris, "surface": None} for name, (tris, _) in shell.items()},
        "materials": {name: material for name, (_, material) in shell.items()},
        "nodes": nodes, "carrier_hz": CARRIER_HZ, "bandwidth_hz": BANDWIDTH_HZ, "max_depth": 1,
    }  # fmt: skip


def with_partition(world: dict) -> dict:
    low, high = (1.0, PARTITION_M, 0.0), (13.0, PARTITION_M, 2.6)
    glass = quad(low, (high[0], *low[1:]), high, (low[0], PARTITION_M, high[2]))
    return world | {
        "objects": world["objects"] | {"partition": {"tris": glass, "surface": None}},
        "materials": world["materials"] | {"partition": "glass"},
    }


def sounded(rng, world: dict, links, time_s, frequency_hz) -> dict:
    """A campaign as its file has it."""
    clean = response(world, links, time_s, frequency_hz)
    power = (np.abs(clean) ** 2).mean(axis=(1, 2))
    noise = np.full(len(links), np.exp(np.log(power).mean()) / 10 ** (SNR_DB / 10))
    turn = np.exp(2j * np.pi * rng.random((*clean.shape[:2], 1)))
    hiss = (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape)) * np.sqrt(noise / 2)[:, None, None]
    tx, rx = (np.array(end) for end in zip(*links, strict=True))
    heard = (clean * turn + hiss).astype(np.complex64)
    return {"tx": tx, "rx": rx, "time_s": time_s, "frequency_hz": frequency_hz, "response": heard, "noise_power": noise}


def spec_of(world: dict) -> dict:
    return {
        "cast_create": 1, "id": "office",
        "environment": {"place": "an office", "carrier_hz": CARRIER_HZ, "bandwidth_hz": BANDWIDTH_HZ},
        "model": {"mesh": "office.obj"}, "materials": world["materials"],
        "nodes": {name: {"position_m": list(place), "antenna": "iso"} for name, place in NODES.items()},
        "sampling": {"duration_s": 1.0, "step_s": 0.5, "max_depth": world["max_depth"]},
    }  # fmt: skip


def obj_of(world: dict) -> str:
    lines, count = ["# metres, z up"], 0
    for name, thing in world["objects"].items():
        lines.append(f"o {name}")
        for triangle in thing["tris"]:
            lines += ["v {:.6f} {:.6f} {:.6f}".format(*corner) for corner in triangle]
            lines.append(f"f {count + 1} {count + 2} {count + 3}")
            count += 3
    return "\n".join(lines) + "\n"


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """ρ of two series of path loss."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def make(folder: Path) -> None:
    rng, twin = np.random.default_rng(20), office()
    world, case = with_partition(twin), folder / "office"
    case.mkdir(parents=True)
    frequency_hz = ((np.arange(TONES) + 0.5) / TONES - 0.5) * BANDWIDTH_HZ
    campaigns = {"office.npz": (OFFICE, np.array([0.0, 0.5])), "corridor.npz": (CORRIDOR, np.array([0.8]))}
    for name, (links, time_s) in campaigns.items():
        arrays = sounded(rng, world, links, time_s, frequency_hz)
        np.savez_compressed(case / name, **arrays)
        if name == "office.npz":
            predicted = response(twin, links, time_s, frequency_hz)
            loss_db = [-10 * np.log10((np.abs(h) ** 2).mean(axis=2)) for h in (arrays["response"], predicted)]
            print(f"path loss, twin less sounding: {np.mean(loss_db[1] - loss_db[0]):+.2f} dB in the mean")
            print(f"correlation of path loss: rho = {correlation(*loss_db):.3f}")
    (case / "office.obj").write_text(obj_of(twin))
    (case / "spec.yaml").write_text(yaml.safe_dump(spec_of(twin), sort_keys=False, default_flow_style=None))
    entries = [{"file": "office.npz", "kind": "response"}, {"file": "corridor.npz", "kind": "response", "use": "vault"}]
    place = {"cast_place": 1, "twin": "spec.yaml", "soundings": entries, "unknown": UNKNOWN}
    (case / "place.yaml").write_text(yaml.safe_dump(place, sort_keys=False, default_flow_style=None))


def foretell(folder: Path, spec: Path) -> None:
    heard = np.load(folder / "office" / "corridor.npz")
    links = list(zip(heard["tx"].tolist(), heard["rx"].tolist(), strict=True))
    model = response(read_spec(spec), links, heard["time_s"], heard["frequency_hz"])
    energy, _ = excess(model, heard["response"], heard["noise_power"], links, heard["frequency_hz"], UNKNOWN)
    total = float((np.abs(heard["response"]) ** 2 / heard["noise_power"][:, None, None]).sum())
    noise = heard["response"].size
    print(f"corridor, never fitted: residual {10 * np.log10(energy / total):.1f} dB, noise {10 * np.log10(noise / total):.1f} dB")


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[1] == "make":
        make(Path(sys.argv[2]))
    elif len(sys.argv) == 4 and sys.argv[1] == "foretell":
        foretell(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        sys.exit(__doc__)
