# SPDX-License-Identifier: GPL-3.0-or-later
"""When what happens in a batch job, in seconds from its beginning."""

from dataclasses import dataclass

POLL_S = 10.0
LEAST_POLL_S = 0.5
STOP_S = 120.0  # from stop.sh to a container's being taken away
# What only waits is made shorter by --time-scale. What works takes its time: on this machine it is given at least so long.
LEAST_BOOT_S = 90.0
LEAST_STOP_S = 120.0


@dataclass(frozen=True, kw_only=True)
class Profile:
    """All containers must be READY at `ready_s`; scripts, scenario and traffic start at `start_s`."""

    name: str
    ready_s: float
    start_s: float


PROFILES = {
    "current": Profile(name="current", ready_s=300.0, start_s=480.0),
    "older": Profile(name="older", ready_s=600.0, start_s=780.0),
}


@dataclass(frozen=True, kw_only=True)
class Clock:
    """A profile at a scale. Waits end early where all is done that is waited for, once their scaled time is over."""

    profile: Profile
    scale: float
    duration_s: float
    least_boot_s: float = LEAST_BOOT_S
    least_stop_s: float = LEAST_STOP_S

    @property
    def poll_s(self) -> float:
        return max(POLL_S / self.scale, LEAST_POLL_S)

    def ready_s(self) -> tuple[float, float]:
        """(scaled, at most) of the wait for READY."""
        wait_s = self.profile.ready_s / self.scale
        return wait_s, max(wait_s, self.least_boot_s)

    @property
    def start_s(self) -> float:
        """From READY's deadline to the start."""
        return (self.profile.start_s - self.profile.ready_s) / self.scale

    @property
    def run_s(self) -> float:
        return self.duration_s / self.scale

    def stop_s(self) -> tuple[float, float]:
        """(scaled, at most) of the wait for FINISHED."""
        wait_s = STOP_S / self.scale
        return wait_s, max(wait_s, self.least_stop_s)
