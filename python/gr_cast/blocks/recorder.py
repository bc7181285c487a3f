# SPDX-License-Identifier: GPL-3.0-or-later
"""A SigMF recording that is readable at any moment, with a capture at every gap that the receiver reports."""

import numpy as np
from gnuradio import gr

from ..core.errors import CastError
from ..signals.recording import data_path, meta_path, metadata, sha512_of, write_metadata
from .finite import FiniteSamples
from .radio_events import Gaps, times

_ITEM = {"cf32_le": np.complex64, "ci16_le": np.dtype((np.int16, 2))}
_DONE = -1  # what work() returns at the end of its stream


class _Writer(gr.sync_block):
    """Writes samples first, the captures among them after: no reader meets a capture beyond the data.

    An `rx_time` tag later than the count of samples says marks a loss: a capture starts there. A peer's NaN and infinities are
    no samples: they are counted and written as 0.
    """

    def __init__(self, item, path, captures: list[dict], sample_rate_hz: float, on_gap):
        gr.sync_block.__init__(self, "sigmf_writer", in_sig=[item], out_sig=None)
        self.failure, self.samples = None, 0
        self.file = open(path, "wb", buffering=0)  # what is written survives a kill
        self._item_bytes = np.dtype(item).itemsize
        self._captures = captures
        self._on_gap = on_gap
        self.finite = FiniteSamples()
        self.gaps = Gaps(sample_rate_hz)

    def work(self, input_items, output_items):
        samples = input_items[0]
        if samples.dtype.kind == "c":
            samples = self.finite.of(samples, self.nitems_read(0))
        try:
            left = samples.reshape(-1).view(np.uint8).data
            while left:
                left = left[self.file.write(left) :]
            known = len(self._captures)
            for sample, seconds, fraction in times(self.get_tags_in_window(0, 0, len(samples))):
                self._time(sample, seconds, fraction)
            if len(self._captures) > known:
                self._on_gap()
            self.samples += len(samples)
        except OSError as failure:  # a full disk ends the recording, not the program
            self.failure = failure
            self.file.truncate(self.nitems_read(0) * self._item_bytes)
            return _DONE
        return len(samples)

    def _time(self, sample: int, seconds: int, fraction: float) -> None:
        time_s = [seconds, fraction]
        lost = self.gaps.before(sample, seconds, fraction)
        if lost:
            gap = {"core:sample_start": sample, "cast:lost_samples": lost, "cast:device_time_s": time_s}
            self._captures.append(self._captures[0] | gap)
        else:
            self._captures[0].setdefault("cast:device_time_s", time_s)


class SigmfRecorder:
    """Records output `port` of `source` as a SigMF pair; `finish()` seals it with its SHA-512."""

    def __init__(
        self,
        top: gr.top_block,
        source,
        stem,
        *,
        sample_rate_hz,
        center_frequency_hz=None,
        datatype="cf32_le",
        fields=None,
        port=0,
    ):
        if meta_path(stem).exists() or data_path(stem).exists():
            raise CastError(f"{stem}: a recording of that name exists; nothing is overwritten, choose another")
        self._about = dict(sample_rate_hz=sample_rate_hz, datatype=datatype)
        self._fields = fields or {}
        self.stem = stem
        self.captures = [{"core:sample_start": 0}]
        if center_frequency_hz is not None:
            self.captures[0]["core:frequency"] = center_frequency_hz
        self._write()
        self._writer = _Writer(_ITEM[datatype], data_path(stem), self.captures, sample_rate_hz, self._write)
        top.connect((source, port), self._writer)

    @property
    def samples(self) -> int:
        """How many came so far; any thread may ask, at any time, which GNU Radio's own count does not bear."""
        return self._writer.samples

    @property
    def not_finite(self) -> int:
        """How many were NaN or infinite, and are 0 in the recording."""
        return self._writer.finite.count

    @property
    def gaps(self) -> Gaps:
        """What the receiver lost so far."""
        return self._writer.gaps

    def _write(self, **more) -> None:
        write_metadata(self.stem, metadata(captures=self.captures, fields=self._fields | more, **self._about))

    def finish(self, fields: dict | None = None) -> None:
        """Close the data and write the metadata with its checksum and what is known by now (`fields`), or remove a recording
        without a sample; OSError where the disk refused samples."""
        self._writer.file.close()
        if not self.samples and not self._writer.failure:  # nothing came: the name stays free
            meta_path(self.stem).unlink(missing_ok=True)
            data_path(self.stem).unlink(missing_ok=True)
            return
        more = {"core:sha512": sha512_of(data_path(self.stem))} | (fields or {})
        if self.not_finite:
            more |= {"cast:not_finite_samples": self.not_finite, "cast:first_not_finite": self._writer.finite.first}
        self._write(**more)
        if self._writer.failure:
            self._writer.failure.filename = str(data_path(self.stem))
            raise self._writer.failure
