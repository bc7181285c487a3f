# SPDX-License-Identifier: GPL-3.0-or-later
"""Which form of a network is fastest on a device: measured once on the machine, held against the definition, and kept."""

import json
import os
import platform
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ...core.documents import json_file
from ...core.errors import CastError
from ...core.files import written_aside
from .arrays import ArrayOps
from .faults import DeviceFault, told
from .form import BINS, DELAY_TYPE, Form
from .links import Table
from .network import DeviceNetwork

# What a user asks for: the forms of spectra that reach it, and the error that a candidate must stay below, dB.
CLASSES = {"tf32": (("fp16", "tf32"), -65.0), "fp32": (("fp32", "split"), -95.0)}
_MOST_THREADS = 1024
_TURNS = 3
_CHECKED = 64  # samples that a candidate's error is taken over
_MOST_DIRECT = 1 << 16  # paths of all links, above which nobody tries the direct form


@dataclass(frozen=True, kw_only=True)
class Task:
    """A network to be planned for: taps of a link that are not zero, samples that they last, and what samples are."""

    n_inputs: int
    n_outputs: int
    n_taps: int
    taps_per_link: int = 4
    life_samples: int = 100_000
    precision: str = "fp32"
    int16: bool = False

    def __post_init__(self):
        if self.precision not in CLASSES:
            raise CastError(f"precision: got {self.precision!r}, needs one of {', '.join(CLASSES)}")


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A form, the seconds that a sample of all nodes takes in it, its error in dB, and how many were tried."""

    form: Form
    seconds: float
    error_db: float
    tried: int

    def words(self) -> str:
        return f"{self.form.words()}: {1e-6 / self.seconds:.3g} MS/s per node, best of {self.tried} measured"


def candidates(task: Task, tiles=(4,)) -> list[Form]:
    """Forms that may be fastest."""
    shape = dict(n_inputs=task.n_inputs, n_outputs=task.n_outputs, n_taps=task.n_taps)
    forms = []
    if task.n_inputs * task.n_outputs * task.taps_per_link <= _MOST_DIRECT:
        forms.append(Form(method="direct", **shape))
    for precision in CLASSES[task.precision][0]:
        if precision == "fp16" and not task.int16:
            continue  # halves hold integers of full scale; floats may be of any size
        for n_bins in BINS:
            if n_bins < 2 * task.n_taps and n_bins < BINS[-1]:
                continue
            forms += [
                Form(precision=precision, n_bins=n_bins, tile=tile, **shape)
                for tile in tiles
                if n_bins > task.n_taps and tile * n_bins // 16 <= _MOST_THREADS
            ]
    return forms


def measure(ops: ArrayOps, form: Form, task: Task) -> tuple[float, float]:
    """Seconds that a sample of all nodes takes in this form, and its error in dB against the definition."""
    rng = np.random.default_rng(1)
    network = DeviceNetwork(ops, form)
    n = int(np.clip(task.life_samples, 2 * form.n_bins, 1 << 17))
    links = (form.n_outputs, form.n_inputs, task.taps_per_link)
    delays, gains = ops.pinned(links, DELAY_TYPE), ops.pinned(links, np.complex64)
    delays[...] = rng.integers(0, form.n_taps, links)
    gains[...] = rng.standard_normal(links) + 1j * rng.standard_normal(links)
    past = form.n_taps - 1
    x = rng.standard_normal((form.n_inputs, past + n, 2)).astype(np.float32) * 0.1
    if task.int16:
        x = np.rint(np.clip(x, -1, 0.999) * 32768).astype(np.int16)
        network.set_samples(int16_in=True, int16_out=False)
    samples = x if task.int16 else x.view(np.complex64)[..., 0]
    on_device = ops.upload(samples)
    table = Table(delays=delays, gains=gains)
    changes = task.life_samples <= n
    took = []
    out = None
    for _ in range(_TURNS + 1):
        ops.synchronize()
        begin = time.perf_counter()
        for _ in range(ops.runs_at_once):
            if out is None or changes:
                network.set_network(None, table)
            out = network.run(on_device[:, :past], on_device[:, past:], out)
        ops.synchronize()
        took.append(time.perf_counter() - begin)
    return min(took[1:]) / (n * ops.runs_at_once), error_db(ops.download(out), samples, past, delays, gains)


def error_db(
    out: np.ndarray, samples: np.ndarray, past: int, delays: np.ndarray, gains: np.ndarray, seed: int | None = 2
) -> float:
    """Error of `out` (receivers, n) in dB of its power, at some samples of some receivers, by the definition in double precision.

    `samples` are (transmitters, past + n), integers of full scale 1 or complex.
    """
    rng = np.random.default_rng(seed)
    receivers = rng.integers(0, out.shape[0], _CHECKED)
    at = rng.integers(0, out.shape[1], _CHECKED)
    at[:2] = 0, out.shape[1] - 1
    wanted = np.empty(_CHECKED, complex)
    nodes = np.arange(samples.shape[0])[:, None]
    for k, (receiver, n) in enumerate(zip(receivers, at, strict=True)):
        taken = samples[nodes, past + n - delays[receiver].astype(int)]
        if samples.dtype == np.int16:
            taken = (taken[..., 0] + 1j * taken[..., 1].astype(float)) / 32768
        wanted[k] = np.sum(taken * gains[receiver].astype(complex))
    got = out[receivers, at]
    if not np.isfinite(got).all():
        return np.inf
    return float(10 * np.log10(max(np.mean(np.abs(got - wanted) ** 2), 1e-300) / np.mean(np.abs(wanted) ** 2)))


def choose(
    ops: ArrayOps, task: Task, report=lambda line: None, *, remember: bool = True, forms: list[Form] | None = None
) -> Choice:
    """The fastest form that is right, of `forms` or all; from what was measured on this machine before, or by measuring."""
    if remember and (kept := _kept(ops, task)):
        return kept
    limit_db = CLASSES[task.precision][1]
    best, tried, faults = None, 0, []
    for form in forms or candidates(task, ops.tiles):
        try:
            with told():
                seconds, db = measure(ops, form, task)
        except DeviceFault as fault:
            faults.append(f"{form.words()}, tile {form.tile}: {fault}")
            report(f"{faults[-1]}: left out")
            continue
        tried += 1
        report(f"{form.words()}, tile {form.tile}: {1e-6 / seconds:.4g} MS/s per node, error {db:.1f} dB")
        if db > limit_db:
            faults.append(f"{form.words()}, tile {form.tile}: error {db:.1f} dB, limit {limit_db:g} dB: left out")
            report(faults[-1])
        elif best is None or seconds < best[0]:
            best = seconds, db, form
    if best is None:
        raise DeviceFault(*(faults or ["--device: no form of this network"]))
    choice = Choice(form=best[2], seconds=best[0], error_db=best[1], tried=tried)
    _keep(_key(ops, task), asdict(choice))
    return choice


def wisdom_path() -> Path:
    """Where what was measured is kept, per user."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gr_cast" / "wisdom.json"


def remembered(what: list, measure) -> float:
    """What `measure()` gave on this machine for `what` (names, numbers, a Task); measured now if nobody has."""
    key = json.dumps([asdict(part) if isinstance(part, Task) else part for part in [platform.node(), *what]])
    kept = _read().get(key)
    if isinstance(kept, int | float) and 0 < kept < np.inf:
        return kept
    measured = measure()
    _keep(key, measured)
    return measured


def _key(ops: ArrayOps, task: Task) -> str:
    return json.dumps([ops.identity(), *asdict(task).values()])


def _read() -> dict:
    try:
        return json_file(wisdom_path()).document or {}
    except CastError:
        return {}


def _kept(ops: ArrayOps, task: Task) -> Choice | None:
    try:
        entry = _read()[_key(ops, task)]
        return Choice(form=Form(**entry["form"]), **{name: entry[name] for name in ("seconds", "error_db", "tried")})
    except (KeyError, TypeError, CastError):
        return None


def _keep(key: str, value) -> None:
    path = wisdom_path()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_aside(path) as aside:
            aside.write_text(json.dumps(_read() | {key: value}, indent=1) + "\n")
    except OSError:
        return  # measured again next time
