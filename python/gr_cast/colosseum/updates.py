# SPDX-License-Identifier: GPL-3.0-or-later
"""What Colosseum tells a radio during a job: mandated_outcomes.json and environment.json, and when they are replaced."""

import json
from dataclasses import dataclass
from pathlib import Path

from ..core.documents import json_file
from ..experiments.traffic.flows import Traffic

OUTCOMES, ENVIRONMENT = "mandated_outcomes.json", "environment.json"
SCRIPT_OF = {OUTCOMES: "update_outcomes.sh", ENVIRONMENT: "update_environment.sh"}
_GOAL = ("goal_type", "flow_uid", "goal_set", "hold_period", "requirements")
_REQUIREMENTS = ("max_latency_s", "min_throughput_bps", "file_transfer_deadline_s", "file_size_bytes")
_ENVIRONMENT = ("collab_network_type", "incumbent_protection", "scenario_rf_bandwidth", "scenario_center_frequency")


@dataclass(frozen=True, kw_only=True)
class Update:
    """A file that every SRN gets `at_s` of the job's Duration."""

    at_s: float
    file: str
    data: bytes


def first(traffic: Traffic | None, center_frequency_hz: float, bandwidth_hz: float) -> list[Update]:
    """The files that a job begins with: a goal for each flow, and the scenario's carrier and band."""
    goals = [
        {
            "goal_type": "Traffic", "flow_uid": flow.number, "goal_set": "box", "hold_period": 1,
            "requirements": {"max_latency_s": 1.0, "min_throughput_bps": round(8 * flow.size_bytes * flow.rate_pps)},
        }
        for flow in (traffic.flows if traffic else ())
    ]  # fmt: skip
    environment = {
        "collab_network_type": "INTERNET", "incumbent_protection": {},
        "scenario_rf_bandwidth": round(bandwidth_hz), "scenario_center_frequency": round(center_frequency_hz),
    }  # fmt: skip
    return [
        Update(at_s=0.0, file=name, data=json.dumps(value).encode())
        for name, value in ((OUTCOMES, goals), (ENVIRONMENT, environment))
    ]


def read(path: Path, duration_s: float) -> list[Update]:
    """A list of {"at_s": …, "mandated_outcomes": […]} and {"at_s": …, "environment": {…}}. Raises CastError, all faults."""
    get = json_file(path, kind=list)
    found = []
    for index, entry in enumerate(get.document):
        place = f"[{index}]"
        entry = get.keys(entry, place, ("at_s", "mandated_outcomes", "environment"), ("at_s",))
        at_s = get.number(entry.get("at_s", 0), f"{place}.at_s", "s", 0, duration_s)
        if ("mandated_outcomes" in entry) == ("environment" in entry):
            get.faults.add(place, "needs one of mandated_outcomes, environment")
        elif "environment" in entry:
            get.keys(entry["environment"], f"{place}.environment", _ENVIRONMENT)
            found.append(Update(at_s=at_s, file=ENVIRONMENT, data=json.dumps(entry["environment"]).encode()))
        else:
            for number, goal in enumerate(get.sequence(entry["mandated_outcomes"], f"{place}.mandated_outcomes")):
                where = f"{place}.mandated_outcomes[{number}]"
                goal = get.keys(goal, where, _GOAL, _GOAL)
                get.keys(goal.get("requirements", {}), f"{where}.requirements", _REQUIREMENTS)
            found.append(Update(at_s=at_s, file=OUTCOMES, data=json.dumps(entry["mandated_outcomes"]).encode()))
    get.faults.raise_if_any()
    return sorted(found, key=lambda update: update.at_s)
