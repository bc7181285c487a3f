# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator offline: N transmitted recordings become received ones, one time chunk after the other, anywhere.

A chunk depends on nothing but the files, so that chunks run in any order on any number of workers, here or on a Dask
cluster, with the same result to the last bit; what is done is kept, and a run that was killed goes on where it was.
"""

import functools
import hashlib
import os
import shutil
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ..core import tasks
from ..core.documents import json_file
from ..core.errors import CastError, Faults
from ..core.files import check_writable, locked, write_json
from ..core.units import db_from_power
from ..emulation.gpu.faults import DeviceFault
from ..emulation.reference import FixedPoint, filter_length
from ..scenario import Scenario
from ..signals import recording
from ..signals.waveform import Repeated, is_code, spec_from_text, waveform_from_spec
from ..twin.document import FASTEST_HZ, SLOWEST_HZ
from .devices import chosen
from .network import heard, scenario_kernel, usable_band

_ITEM = np.dtype(np.complex64)


@dataclass(frozen=True, kw_only=True)
class BatchJob:
    """All that a worker needs to know, whichever chunk it gets. `transmit` maps a node to its samples, on disk or a code's, and
    `waveforms` to what they are, as a recording tells it."""

    scenario: Scenario
    transmit: dict[str, recording.Stored | Repeated]
    waveforms: dict[str, dict]
    receivers: tuple[str, ...]
    folder: str
    sample_rate_hz: float
    n_samples: int
    chunk_samples: int
    noise_power: float
    seed: int
    fixed_point: FixedPoint | None
    fields: dict
    cycle: bool
    device: str
    precision: str

    @property
    def n_chunks(self) -> int:
        return -(-self.n_samples // self.chunk_samples)

    @property
    def work(self) -> Path:
        return Path(self.folder) / ".batch"

    @property
    def plan(self) -> Path:
        return self.work / "plan.json"

    def part(self, receiver: str) -> Path:
        return self.work / f"{receiver}.part"

    def mark(self, chunk: int) -> Path:
        return self.work / f"{chunk}.done"


def make_chunk(job: BatchJob, chunk: int) -> int:
    """Compute and store one chunk of every receiver; returns its number. With device auto a card that fails is done without."""
    try:
        y = _received(job, chunk, "cuda" if job.device == "auto" else job.device)
    except DeviceFault as fault:
        if job.device != "auto":
            raise
        tell_once(f"{fault}; going on with the processor")
        y = _received(job, chunk, "cpu")
    begin = chunk * job.chunk_samples
    for receiver, samples in zip(job.receivers, y, strict=True):
        with open(job.part(receiver), "r+b") as file:
            file.seek(begin * _ITEM.itemsize)
            file.write(samples.tobytes())
            file.flush()
            os.fsync(file.fileno())
    job.mark(chunk).touch()
    return chunk


def _received(job: BatchJob, chunk: int, device: str) -> np.ndarray:
    """The chunk's samples of every wanted receiver."""
    begin = chunk * job.chunk_samples
    end = min(begin + job.chunk_samples, job.n_samples)
    nodes = job.scenario.nodes
    past = filter_length(job.sample_rate_hz) - 1
    # An output for every node, wanted or not: a node's noise is the same whoever else receives.
    wanted = [nodes.index(node) for node in job.receivers]
    until_s = end / job.sample_rate_hz
    kernel = scenario_kernel(
        job.scenario, job.sample_rate_hz, until_s, seed=job.seed, receivers=wanted, cycle=job.cycle, device=device,
        precision=job.precision,
    )  # fmt: skip
    for index in wanted:
        kernel.set_noise_power(index, job.noise_power)
    if job.fixed_point:
        kernel.set_fixed_point(**asdict(job.fixed_point))
    kernel.skip_to(begin)
    x = np.zeros((len(nodes), past + end - begin), np.complex64)
    for node, stored in job.transmit.items():
        first = begin - past if isinstance(stored, Repeated) else max(0, begin - past)
        sent = stored.between(first, end) if isinstance(stored, Repeated) else stored[first:end]
        at = past - (begin - first)
        x[nodes.index(node), at : at + len(sent)] = sent
    return kernel.process(x)[wanted]


@functools.cache
def tell_once(line: str) -> None:
    """A warning, once a process."""
    print(f"warning: {line}", file=sys.stderr, flush=True)


def run_batch(
    scenario: Scenario,
    transmit: dict[str, str],
    folder: Path,
    *,
    rate_hz: float | None = None,
    duration_s: float | None = None,
    receivers: list[str] | None = None,
    chunk_samples: int = 1 << 20,
    noise_power: float = 0.0,
    seed: int = 0,
    fixed_point: FixedPoint | None = None,
    dask: str | None = None,
    workers: int = 1,
    fields: dict | None = None,
    cycle: bool = False,
    device: str = "cpu",
    precision: str = "fp32",
    report=lambda line: None,
    progress=lambda done, total: None,
) -> None:
    """Write `folder`/NODE, a SigMF recording, for every receiver; `fields` go into its metadata.

    `device` is cpu, cuda (with `precision` tf32 or fp32), or auto: cuda, and the processor for what a card cannot do; `report`
    gets a line that says how the network is computed. `transmit` maps a node to the stem of its recording, or to a code, which
    was on the air before and stays, at `rate_hz` (else that of the recordings) for `duration_s` (else as long as the longest
    recording). Raises CastError, all faults at once, before any work.
    """
    transmitted = _transmitted(transmit, rate_hz, duration_s)
    job = _job(
        scenario, transmitted, folder, receivers, chunk_samples, noise_power, seed, fixed_point, fields or {}, cycle,
        device, precision,
    )  # fmt: skip
    if chosen(device, scenario, job.sample_rate_hz, precision, workers, report) == "cpu":
        job = replace(job, device="cpu")
    Path(job.folder).mkdir(parents=True, exist_ok=True)
    with locked(Path(job.folder)):
        todo = _prepare(job)
        done = job.n_chunks - len(todo)
        report(_announced(job, done))
        progress(done, job.n_chunks)
        try:
            for _ in tasks.run(make_chunk, job, todo, dask=dask, processes=workers):
                done += 1
                progress(done, job.n_chunks)
        except BaseException:
            report(f"{done} of {job.n_chunks} chunks are kept in {job.work}: the same command goes on there")
            raise
        for receiver in job.receivers:
            _seal(job, receiver)
        for path in job.work.glob("*.done"):
            path.unlink()
        job.plan.unlink()  # last: what a killed run leaves is told by it
        job.work.rmdir()


@dataclass(frozen=True, kw_only=True)
class _Transmitted:
    """What every node sends, and what it is; `faults` are those of reading it."""

    samples: dict[str, recording.Stored | Repeated]
    waveforms: dict[str, dict]
    rate_hz: float
    faults: Faults


def _transmitted(transmit: dict[str, str], rate_hz: float | None, duration_s: float | None) -> _Transmitted:
    faults = Faults("batch")
    rates, samples, waveforms, codes = {}, {}, {}, {}
    for node, text in transmit.items():
        try:  # once for all chunks: the whole file is held against its checksum
            if is_code(text) and not recording.meta_path(text).exists():
                waveforms[node] = spec_from_text(text)
                codes[node] = waveform_from_spec(waveforms[node]).samples
                continue
            stem = Path(text).resolve()
            taken = recording.read(stem, longest=0)
            rates[node], samples[node] = taken.sample_rate_hz, taken.samples
            waveforms[node] = {"file": str(recording.stem_of(stem)), "repeat": False}
        except CastError as error:
            for line in error.faults:
                faults.add(f"node {node}", line)
    if rate_hz is not None:
        rates["--rate"] = rate_hz
    if len(set(rates.values())) > 1:
        faults.add(
            "sample rates",
            ", ".join(f"{node} {rate} Hz" for node, rate in rates.items()) + ": needs one for all",
        )
    if rate_hz is not None and not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        faults.add("--rate", f"got {rate_hz:g} Hz, needs {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz")
    rate = next(iter(rates.values()), None)
    count = max(map(len, samples.values()), default=0)
    if codes and rate is None:
        faults.add("--rate", f"missing: {', '.join(codes)} sends a code, which has no rate of its own, such as --rate 20M")
    if codes and duration_s is None and not samples:
        faults.add("--duration", f"missing: {', '.join(codes)} sends a code, which has no end, such as --duration 0.01")
    if duration_s is not None and rate is not None and SLOWEST_HZ <= rate <= FASTEST_HZ:
        if 0 < duration_s * rate < 1e12:
            count = max(1, round(duration_s * rate))
        else:
            faults.add("--duration", f"got {duration_s} s of {rate:g} Hz, needs more than 0 s and less than 1e12 samples")
    samples |= {node: Repeated(period=period, count=count) for node, period in codes.items()}
    return _Transmitted(samples=samples, waveforms=waveforms, rate_hz=rate, faults=faults)


def _job(
    scenario, transmitted, folder, receivers, chunk_samples, noise_power, seed, fixed_point, fields, cycle, device, precision
) -> BatchJob:
    faults = transmitted.faults
    for node in [*transmitted.waveforms, *(receivers or ())]:
        if node not in scenario.nodes:
            faults.add(f"node {node}", f"the scenario has {', '.join(scenario.nodes)}")
    try:
        check_writable(folder)
    except CastError as error:
        faults.add("--output", error.faults[0])
    if chunk_samples < 1:
        faults.add("chunk", f"got {chunk_samples} samples, needs 1 or more")
    faults.raise_if_any()
    return BatchJob(
        scenario=scenario,
        transmit=transmitted.samples,
        waveforms=transmitted.waveforms,
        receivers=tuple(receivers or scenario.nodes),
        folder=str(folder.resolve()),  # workers of a cluster stand elsewhere
        sample_rate_hz=transmitted.rate_hz,
        n_samples=max(map(len, transmitted.samples.values())),
        chunk_samples=chunk_samples,
        noise_power=noise_power,
        seed=seed,
        fixed_point=fixed_point,
        fields=fields,
        cycle=cycle,
        device=device,
        precision=precision,
    )


def _fingerprint(job: BatchJob) -> dict:
    """What a half-done run must share with this one to be gone on with."""
    files = {
        node: [waveform, len(job.transmit[node]), *_written_at(job.transmit[node])] for node, waveform in job.waveforms.items()
    }
    plan = scenario_digest(job.scenario)
    fixed = job.fixed_point and asdict(job.fixed_point)
    return {
        "transmit": files,
        "receivers": list(job.receivers),
        "scenario": plan,
        "chunk_samples": job.chunk_samples,
        "noise_power": job.noise_power,
        "seed": job.seed,
        "fixed_point": fixed,
        "cycle": job.cycle,
        "device": [job.device, job.precision],
    }


def _written_at(sent: recording.Stored | Repeated) -> list[int]:
    return [] if isinstance(sent, Repeated) else [sent.path.stat().st_mtime_ns]


def scenario_digest(scenario: Scenario) -> str:
    """SHA-256 over everything of a scenario that is heard."""
    digest = hashlib.sha256(repr((scenario.nodes, scenario.interpolation, scenario.base_loss_db)).encode())
    digest.update(repr(sorted(scenario.link_base_loss_db.items())).encode())
    digest.update(scenario.time_s.tobytes())
    for key, taps in sorted(scenario.links.items()):
        digest.update(repr((key, taps.gain.shape)).encode() + taps.delay_s.tobytes() + taps.gain.tobytes())
    return digest.hexdigest()


def _prepare(job: BatchJob) -> list[int]:
    """Make or take up the folder of parts; the chunks that are still to do."""
    goes_on = job.plan.exists()
    if goes_on and json_file(job.plan).document != _fingerprint(job):
        raise CastError(f"{job.work}: holds a run with other inputs; remove it, or choose another folder")
    if not goes_on:
        shutil.rmtree(job.work, ignore_errors=True)  # without a plan nobody knows of what run its marks are
    for receiver in job.receivers:
        stem = Path(job.folder) / receiver
        is_own = goes_on and not job.part(receiver).exists()
        if not is_own and (recording.meta_path(stem).exists() or recording.data_path(stem).exists()):
            raise CastError(f"{stem}: a recording of that name exists; nothing is overwritten")
    if not goes_on:
        _check_room(job)
        job.work.mkdir()
        for receiver in job.receivers:
            with open(job.part(receiver), "wb") as file:
                file.truncate(job.n_samples * _ITEM.itemsize)
        write_json(job.plan, _fingerprint(job))
    if not all(job.part(receiver).exists() for receiver in job.receivers):
        return []  # it was being sealed, so all of it is done
    return [chunk for chunk in range(job.n_chunks) if not job.mark(chunk).exists()]


def _size(count: float) -> str:
    return f"{count / 1e9:.3g} GB" if count >= 1e8 else f"{count / 1e6:.3g} MB"


def _announced(job: BatchJob, done: int) -> str:
    """What is being made, and how large it is."""
    each = job.n_samples * _ITEM.itemsize
    what = f"{len(job.receivers)} recordings of {job.n_samples} samples, {_size(len(job.receivers) * each)}, in {job.folder}"
    return what + (f"; {done} of {job.n_chunks} chunks are there" if done else "")


def _check_room(job: BatchJob) -> None:
    needs, free = len(job.receivers) * job.n_samples * _ITEM.itemsize, shutil.disk_usage(job.folder).free
    if needs > free:
        raise CastError(
            f"{job.folder}: {len(job.receivers)} recordings of {job.n_samples} samples need {_size(needs)}, {_size(free)} free: "
            "take a shorter --duration, or fewer --receivers"
        )


def _seal(job: BatchJob, receiver: str) -> None:
    """The part of a receiver as a recording; again where a killed run had got no further than half of it."""
    stem = Path(job.folder) / receiver
    if job.part(receiver).exists():
        os.replace(job.part(receiver), recording.data_path(stem))
    if recording.meta_path(stem).exists():
        return
    checksum = recording.sha512_of(recording.data_path(stem))
    fields = {
        "core:sha512": checksum,
        **job.fields,
        **heard(job.scenario, receiver, job.waveforms),
        **usable_band(job.scenario, job.sample_rate_hz),
        "cast:noise_power_db": float(db_from_power(job.noise_power)) if job.noise_power else None,
        "cast:seed": job.seed,
    }
    about = recording.metadata(
        sample_rate_hz=job.sample_rate_hz, center_frequency_hz=job.scenario.center_frequency_hz, fields=fields
    )
    recording.write_metadata(stem, about)
