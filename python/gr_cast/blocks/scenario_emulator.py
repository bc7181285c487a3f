# SPDX-License-Identifier: GPL-3.0-or-later
"""The Scenario Emulator of GNU Radio Companion: a scenario on the channel emulator, changed while it runs."""

from gnuradio import gr

from .. import scenario as scenarios
from ..core.errors import CastError
from ..emulation.reference import filter_length
from .network import emulated_network, play_on, set_noise


class ScenarioEmulator(gr.hier_block2):
    """Transmitters in, receivers out, both named nodes of a scenario (catalogue name or file).

    `noise_power` is every receiver's, in units of the samples squared. Messages on `taps` and `status` are those of
    `channel_emulator`. Raises CastError where scenario, nodes and rate do not fit; a setter that does changes nothing.
    """

    def __init__(
        self, scenario: str, transmitters, receivers, sample_rate_hz: float, noise_power: float = 0.0, n_threads: int = 0
    ):
        self._nodes = list(transmitters), list(receivers)
        counts = [len(nodes) for nodes in self._nodes]
        signatures = [gr.io_signature(count, count, gr.sizeof_gr_complex) for count in counts]
        super().__init__("scenario_emulator", *signatures)
        self._scenario, self._sample_rate_hz = self._load(scenario), sample_rate_hz
        self._n_taps = filter_length(sample_rate_hz)
        self.emulator = emulated_network(self._scenario, *self._nodes, sample_rate_hz, n_threads)
        self.set_noise_power(noise_power)
        for port in range(counts[0]):
            self.connect((self, port), (self.emulator, port))
        for port in range(counts[1]):
            self.connect((self.emulator, port), (self, port))
        self.message_port_register_hier_in("taps")
        self.message_port_register_hier_out("status")
        self.msg_connect((self, "taps"), (self.emulator, "taps"))
        self.msg_connect((self.emulator, "status"), (self, "status"))

    def _load(self, name: str) -> scenarios.Scenario:
        found = scenarios.load(name)
        missing = sorted({node for nodes in self._nodes for node in nodes} - set(found.nodes))
        if missing:
            raise CastError(f"{found.name}: nodes: got {', '.join(missing)}, the scenario has {', '.join(found.nodes)}")
        return found

    def set_scenario(self, scenario: str) -> None:
        """Play another scenario of these nodes from the next sample on."""
        found = self._load(scenario)
        play_on(self.emulator, found, *self._nodes, self._sample_rate_hz)
        self.emulator.set_scenario_name(found.name)
        self._scenario = found

    def set_sample_rate(self, sample_rate_hz: float) -> None:
        """Play the scenario anew at another rate, one at which its longest delay has as many taps as at the first, or fewer."""
        if (needed := filter_length(sample_rate_hz)) > self._n_taps:
            raise CastError(f"sample rate: got {sample_rate_hz:g} Hz, which needs {needed} taps, limit {self._n_taps} taps")
        play_on(self.emulator, self._scenario, *self._nodes, sample_rate_hz)
        self.emulator.set_sample_rate(sample_rate_hz)
        self._sample_rate_hz = sample_rate_hz

    def set_noise_power(self, power: float) -> None:
        """Every receiver's, in units of the samples squared, from the next sample on."""
        set_noise(self.emulator, power)
