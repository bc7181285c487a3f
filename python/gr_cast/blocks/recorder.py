# SPDX-License-Identifier: GPL-3.0-or-later
"""A SigMF recording that is readable at any moment, with a capture at every gap that the receiver reports."""

import hashlib

import numpy as np
import pmt
from gnuradio import blocks, gr

from ..errors import CastError
from ..recording import data_path, meta_path, metadata, write_metadata

_ITEM = {"cf32_le": np.complex64, "ci16_le": np.dtype((np.int16, 2))}
_TIME, _FREQUENCY = pmt.intern("rx_time"), pmt.intern("rx_freq")


class GapMonitor(gr.sync_block):
    """Watches `rx_time` tags: one that is later than the samples say marks samples lost. Calls `on_gap(captures)`."""

    def __init__(self, item, sample_rate_hz: float, center_frequency_hz: float | None, on_gap):
        gr.sync_block.__init__(self, "gap_monitor", in_sig=[item], out_sig=None)
        self.sample_rate_hz = sample_rate_hz
        self.captures = [{"core:sample_start": 0}]
        if center_frequency_hz is not None:
            self.captures[0]["core:frequency"] = center_frequency_hz
        self._on_gap = on_gap
        self._mark = None  # (sample, whole seconds, fraction) of the newest rx_time

    def work(self, input_items, output_items):
        for tag in self.get_tags_in_window(0, 0, len(input_items[0])):
            if pmt.equal(tag.key, _TIME) and pmt.is_tuple(tag.value):
                self._time(tag.offset, pmt.to_uint64(pmt.tuple_ref(tag.value, 0)), pmt.to_double(pmt.tuple_ref(tag.value, 1)))
        return len(input_items[0])

    def _time(self, sample: int, seconds: int, fraction: float) -> None:
        if self._mark is None:
            self.captures[0]["cast:device_time_s"] = [seconds, fraction]
        else:
            marked, whole, part = self._mark
            passed = (seconds - whole) * self.sample_rate_hz + (fraction - part) * self.sample_rate_hz
            lost = round(passed) - (sample - marked)
            if lost > 0:
                entry = {"core:sample_start": sample, "cast:lost_samples": lost, "cast:device_time_s": [seconds, fraction]}
                self.captures.append(self.captures[0] | entry)
                self._on_gap(self.captures)
        self._mark = (sample, seconds, fraction)


class SigmfRecorder:
    """Connect `source` (a block's output 0) to a SigMF pair; `finish()` seals it with its SHA-512 after the run."""

    def __init__(
        self, top: gr.top_block, source, stem, *, sample_rate_hz, center_frequency_hz=None, datatype="cf32_le", fields=None, port=0
    ):
        if meta_path(stem).exists() or data_path(stem).exists():
            raise CastError(f"{stem}: a recording of that name exists; nothing is overwritten, choose another")
        item = _ITEM[datatype]
        self._about = dict(sample_rate_hz=sample_rate_hz, datatype=datatype)
        self._fields = fields or {}
        self.stem = stem
        self.monitor = GapMonitor(item, sample_rate_hz, center_frequency_hz, self._write)
        self._write(self.monitor.captures)
        self._sink = blocks.file_sink(np.dtype(item).itemsize, str(data_path(stem)))
        top.connect((source, port), self._sink)
        top.connect((source, port), self.monitor)

    def _write(self, captures, **more) -> None:
        write_metadata(self.stem, metadata(captures=captures, fields=self._fields | more, **self._about))

    def finish(self) -> None:
        """Close the data file and write the metadata with its checksum."""
        self._sink.close()
        digest = hashlib.sha512()
        with open(data_path(self.stem), "rb") as file:
            while chunk := file.read(1 << 22):
                digest.update(chunk)
        self._write(self.monitor.captures, **{"core:sha512": digest.hexdigest()})
