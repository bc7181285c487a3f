# SPDX-License-Identifier: GPL-3.0-or-later
"""The world of a reservation: the catalogue's scenarios and a team's traffic, as the command line lists them."""

from functools import lru_cache
from pathlib import Path

from .. import scenario as sc
from ..core.errors import CastError
from .desk import TRAFFIC_LEAD_S, RfScenario, World
from .storage import Storage, rf_scenarios, traffic_nodes


@lru_cache(maxsize=64)
def _listed(number: int, path: Path, changed: float) -> RfScenario:
    scenario = sc.read(path)
    return RfScenario(
        number=number, title=scenario.name, nodes=len(scenario.nodes), center_frequency_hz=scenario.center_frequency_hz,
        length_s=None if scenario.is_static else float(scenario.time_s[-1]),
    )  # fmt: skip


def world_of(storage: Storage, srns: int, time_scale: float = 1.0) -> World:
    """Scenarios that cannot be read are left out: `validate` names them where a job asks for one."""
    rf, traffic = {}, {}
    for number, path in sorted(rf_scenarios().items()):
        try:
            rf[number] = _listed(number, path, path.stat().st_mtime)
        except CastError:
            continue
    for number, path in sorted(storage.traffic().items()):
        try:
            nodes = traffic_nodes(path)
        except CastError:
            continue
        traffic[number] = (f"{len(nodes)} nodes" if path else "none", max(map(int, nodes), default=0))
    return World(
        srns=tuple(range(1, srns + 1)), rf=rf, traffic=traffic, traffic_lead_s=TRAFFIC_LEAD_S / time_scale,
        images=f"/share/nas/{storage.team}/images",
    )  # fmt: skip
