# SPDX-License-Identifier: GPL-3.0-or-later
"""A network on a device: what `emulator_kernel` is on the processor, with the same updates at the same samples."""

from dataclasses import dataclass, replace

import numpy as np

from ...core.errors import CastError
from ...core.units import amplitude_from_db
from .faults import DeviceFault, told
from .form import Ends, Form
from .links import Links, Segment, Table

MOST_PRODUCTS = 65535  # matrices that cuBLAS multiplies in one call
MOST_WASTE = 2  # blocks computed for one that is wanted, where segments of a round differ in length


@dataclass(frozen=True, kw_only=True)
class _Round:
    """Segments that are computed together, and how many blocks each has room for."""

    segments: tuple[Segment, ...]
    n_blocks: int


class DeviceNetwork:
    """y_j = Σ_i x_i * h_ij on a device, chunk after chunk, in the way that `form` says.

    Transmitters in, receivers out; `ops` are the steps on the device (`ArrayOps` or those in CUDA). `share` of the free memory is
    used for spectra. Where the device fails in process(), `spare(fault)` gives what goes on in its place. Noise, fixed point,
    ramps and late updates are those of `emulator_kernel`.
    """

    def __init__(self, ops, form: Form, seed: int = 0, share: float = 0.25, spare=None):
        self.ops, self.form, self._spare = ops, form, spare
        self.links = Links(form.n_inputs, form.n_outputs, form.n_taps)
        self.ends = Ends(seed=seed, noise_power=np.zeros(form.n_outputs))
        self._budget = max(int(share * ops.free_bytes()), form.segment_bytes(form.tile))
        self._kept = None  # (version, spectra of links, scale)
        self._clipped, self._clipped_seen = ops.upload(np.zeros(1, np.int64)), 0

    # --- updates, named as emulator_kernel names them
    def set_sparse_taps(self, tx: int, rx: int, delays, gains, offset: int | None = None, ramp: int = 0) -> None:
        """Taps of a link from sample `offset` on (None: the next); with `ramp` they arrive, straight, so many samples later."""
        self.links.schedule(tx, rx, offset, taps=(delays, gains), ramp=ramp)

    def set_base_loss(self, tx: int, rx: int, base_loss_db: float, offset: int | None = None) -> None:
        """Loss of the link on top of its taps."""
        self.links.schedule(tx, rx, offset, gain=float(amplitude_from_db(-base_loss_db)))

    def enable_link(self, tx: int, rx: int, enabled: bool, offset: int | None = None) -> None:
        """Switch a link off or on again; it keeps its taps."""
        self.links.schedule(tx, rx, offset, enabled=enabled)

    def set_network(self, offset: int | None, table: Table) -> None:
        """Taps of every link from sample `offset` on."""
        self.links.schedule_all(offset, table)

    def set_noise_power(self, rx: int, power: float) -> None:
        """Mean power of a receiver's noise, in units of the samples squared."""
        if not 0 <= power < np.inf:
            raise CastError(f"noise power: got {power}, expected a finite number, 0 or more")
        powers = self.ends.noise_power.copy()
        powers[rx] = power
        self.ends = replace(self.ends, noise_power=powers)

    def set_fixed_point(self, bits: int, tap_bits: int, input_full_scale: float, output_full_scale: float) -> None:
        """Round samples and taps as a fixed-point machine does."""
        levels = 2 ** (bits - 1)
        self.links.round_taps(tap_bits)
        self.ends = replace(
            self.ends, scale_in=input_full_scale, levels_in=levels, scale_out=output_full_scale, levels_out=levels
        )

    def set_samples(
        self, *, int16_in: bool, int16_out: bool, input_full_scale: float = 1.0, output_full_scale: float = 1.0
    ) -> None:
        """Samples in and out as integers of 16 bits, 32768 of which are full scale; those out saturate."""
        levels_out = 32768 if int16_out else self.ends.levels_out
        self.ends = replace(
            self.ends, int16_in=int16_in, int16_out=int16_out, scale_in=input_full_scale, scale_out=output_full_scale,
            levels_out=levels_out,
        )  # fmt: skip

    def clear(self) -> None:
        """No link has taps from the next sample on, and no update is pending."""
        self.links.clear()

    def skip_to(self, position: int) -> None:
        """On to sample number `position` as if all before had been processed."""
        self.links.skip(position - self.links.position)

    @property
    def position(self) -> int:
        return self.links.position

    def clipped_samples(self) -> int:
        """Samples that a full scale cut off."""
        self._clipped_seen = int(self.ops.download(self._clipped)[0])
        return self._clipped_seen

    def plan(self) -> str:
        """How the network is computed, in words."""
        return f"{self.form.words()}, {self.ops.name}"

    # --- samples
    def process(self, inputs: np.ndarray) -> np.ndarray:
        """(transmitters, n_taps - 1 past and n new samples) in, (receivers, n) out, complex64."""
        first, segments = self.position, self.links.cut(inputs.shape[1] - (self.form.n_taps - 1))
        inputs = np.ascontiguousarray(inputs, np.complex64)
        try:
            with told():
                return self._processed(inputs, segments, first)
        except DeviceFault as fault:
            if self._spare is None:
                raise
            self.ops, self._spare, self._kept = self._spare(fault), None, None
            self._clipped = self.ops.upload(np.array([self._clipped_seen]))
            return self._processed(inputs, segments, first)

    def _processed(self, inputs: np.ndarray, segments: list[Segment], first: int) -> np.ndarray:
        past = self.form.n_taps - 1
        x = self.ops.upload(inputs)
        return self.ops.download(self._computed(x[:, :past], x[:, past:], segments, first, None))

    def run(self, before, now, out=None):
        """The samples of all receivers for those of all transmitters `now`, on the device; `before` are the last ones before,
        n_taps - 1 and more."""
        first = self.position
        return self._computed(before, now, self.links.cut(now.shape[1]), first, out)

    def _computed(self, before, now, segments: list[Segment], first: int, out):
        n = now.shape[1]
        shape, dtype = (
            ((self.form.n_outputs, n, 2), np.int16) if self.ends.int16_out else ((self.form.n_outputs, n), np.complex64)
        )
        out = self.ops.empty(shape, dtype) if out is None else out
        self.ops.count_clipped(now, self.ends, self._clipped)
        for part in self._rounds(segments):
            self._run(part, before, now, first, out)
        self.ops.end_of_run()
        return out

    def _rounds(self, segments: list[Segment]):
        """Segments in rounds that fit into the memory, longer ones in pieces."""
        most = self._most_blocks()
        step = most * self.form.step if self.form.method == "overlap-save" else max(1, self._budget)
        pieces = [
            replace(segment, begin=begin, end=min(begin + step, segment.end), layers=_from(segment, begin))
            for segment in segments
            for begin in range(segment.begin, segment.end, step)
        ]
        taken: list[Segment] = []
        for piece in pieces:
            if taken and not self._fits([*taken, piece]):
                yield self._round(taken)
                taken = []
            taken.append(piece)
        if taken:
            yield self._round(taken)

    def _most_blocks(self) -> int:
        form, tile = self.form, self.form.tile
        fixed = form.segment_bytes(0)
        each = form.segment_bytes(tile) - fixed
        return tile * max(1, (self._budget - fixed) // each)

    def _fits(self, segments: list[Segment]) -> bool:
        if len({len(segment.layers) for segment in segments}) > 1:
            return False
        if self.form.method == "direct":
            lengths = [s.end - s.begin for s in segments]
            return len(lengths) * max(lengths) <= MOST_WASTE * sum(lengths)
        if len(segments) * self.form.n_bins > MOST_PRODUCTS:
            return False
        blocks = [self.form.blocks(s.end - s.begin) for s in segments]
        total = len(blocks) * max(blocks)
        return total <= MOST_WASTE * sum(blocks) and len(blocks) * self.form.segment_bytes(max(blocks)) <= self._budget

    def _round(self, segments: list[Segment]) -> _Round:
        return _Round(segments=tuple(segments), n_blocks=max(self.form.blocks(s.end - s.begin) for s in segments))

    def _run(self, part: _Round, before, now, first, out) -> None:
        ops, form, ends = self.ops, self.form, self.ends
        n_layers = len(part.segments[0].layers)
        partial = ops.empty((form.n_outputs, now.shape[1]), np.complex64) if n_layers > 1 else None
        tables = [_table(part.segments, layer) for layer in range(n_layers)]
        if form.method == "overlap-save":
            spectra = ops.forward(before, now, tables[0], part.n_blocks, form, ends)
        for layer, table in enumerate(tables):
            end = (first, out, partial, layer == 0, layer == n_layers - 1, self._clipped)
            if form.method == "direct":
                ops.direct(before, now, *self._taps(part.segments, layer), table, form, ends, *end)
                continue
            filters, scale = self._filters(part.segments, layer)
            ops.inverse(ops.product(filters, spectra, form), scale, table, form, ends, *end)

    def _filters(self, segments, layer: int):
        """Spectra of the links; those of one segment are kept until its taps change."""
        version = segments[0].version if len(segments) == 1 and len(segments[0].layers) == 1 else None
        if self._kept is None or version is None or self._kept[0] != version:
            self._kept = None  # its memory first
            self._kept = (version, *self.ops.filters(*self._taps(segments, layer), self.form))
        return self._kept[1:]

    def _taps(self, segments, layer: int):
        layers = [segment.layers[layer] for segment in segments]
        width = max(one.gains.shape[-1] for one in layers)
        return self.ops.lend([_widened(one.delays, width) for one in layers], [_widened(one.gains, width) for one in layers])


def _from(segment: Segment, begin: int):
    """The layers of a segment as they are from `begin` on."""
    gone = begin - segment.begin
    return tuple(replace(layer, weight=layer.weight + layer.slope * gone) for layer in segment.layers)


def _table(segments, layer: int) -> np.ndarray:
    """Rows (begin, end, weight, slope) of a round's segments, float64: numbers of samples in a chunk are exact in it."""
    return np.array([[s.begin, s.end, s.layers[layer].weight, s.layers[layer].slope] for s in segments])


def _widened(table: np.ndarray, width: int) -> np.ndarray:
    return table if table.shape[-1] == width else np.pad(table, ((0, 0), (0, 0), (0, width - table.shape[-1])))
