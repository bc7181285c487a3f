# SPDX-License-Identifier: GPL-3.0-or-later
"""Powers and noise figures of a created scenario's radios, as its SPEC has them."""

from dataclasses import dataclass, replace
from pathlib import Path

from ..core.documents import Reader
from . import zarr_file
from .catalogue import catalogue_entries
from .model import Scenario, base_loss_db


@dataclass(frozen=True, kw_only=True)
class Radios:
    """Node to what it sends, dBm, and to the noise figure that it hears with, dB."""

    power_dbm: dict[str, float]
    noise_figure_db: dict[str, float]


def radios_of(name_or_path: str | Path) -> Radios | None:
    """The radios of a created scenario, by id or path; None where its SPEC says nothing of them, or there was none."""
    path = Path(catalogue_entries().get(str(name_or_path), name_or_path))
    if path.suffix != ".zarr":
        return None
    get = Reader(f"{path}: .zattrs", zarr_file.attributes(path))
    said = {
        node: get.mapping(about, f"radios.{node}")
        for node, about in get.mapping(get.document.get("radios", {}), "radios").items()
    }
    read = {
        key: {node: get.number(about.get(key, 0.0), f"radios.{node}.{key}", unit) for node, about in said.items()}
        for key, unit in (("power_dbm", "dBm"), ("noise_figure_db", "dB"))
    }
    get.faults.raise_if_any()
    is_said = any(value for values in read.values() for value in values.values())  # 0 dBm and 0 dB are what is not said
    return Radios(**read) if is_said else None


def with_radios(scenario: Scenario, radios: Radios, power_dbm: float, noise_figure_db: float) -> Scenario:
    """The same scenario for who plays every node at one power and noise figure: what its radios have more or less of them is
    put on the links. A weaker transmitter or a noisier receiver is so much more loss; ratios of power to noise are theirs."""
    losses_db = {
        (tx, rx): base_loss_db(scenario, (tx, rx))
        + power_dbm - radios.power_dbm.get(tx, power_dbm)
        + radios.noise_figure_db.get(rx, noise_figure_db) - noise_figure_db
        for tx, rx in scenario.links
    }  # fmt: skip
    return replace(scenario, link_base_loss_db=losses_db)
