# SPDX-License-Identifier: GPL-3.0-or-later
"""`pipeline.yaml` of a stack's repository: how it is built, tried and measured, wherever that is done."""

from dataclasses import asdict, dataclass
from pathlib import Path

from ..core.documents import Reader, short, yaml_file
from ..core.errors import CastError
from ..core.files import is_file
from ..experiments.traffic import flows
from ..scenario import Scenario, link_name, load

VERSION = 1
FILE = "pipeline.yaml"
MOST_REPEATS = 1000
LONGEST_SAMPLES = 1 << 26  # of one repeat, half a gigabyte
SLOWEST_HZ, FASTEST_HZ = 1e3, 1e10
LONGEST_S = 86400
BETTER = ("lower", "higher", "neither")
RESIDUAL = "residual_db"  # what the scenario does not explain of a recording, the one metric that every pipeline has
GAIN = "gain_db"  # with which a recording holds what the scenario says; a pipeline may give it a tolerance
_TOP = {
    "cast_pipeline",
    "name",
    "environment",
    "build",
    "test",
    "image",
    "sample_rate_hz",
    "experiments",
    "metrics",
    "sites",
    "limits",
}
_EXPERIMENT = {"name", "scenario", "nodes", "traffic", "duration_s", "repeats", "seed"}


@dataclass(frozen=True, kw_only=True)
class Environment:
    """What a machine must have before it builds: Debian's name of the system, packages, the compiler's command."""

    system: str
    packages: tuple[str, ...]
    compiler: str


@dataclass(frozen=True, kw_only=True)
class Node:
    """Commands of a node, run in the image's folder; None where it has no such part."""

    transmit: str | None = None
    receive: str | None = None


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One thing that is tried `repeats` times: nodes over a scenario. `scenario` and `traffic` are as the file has them."""

    name: str
    scenario: str
    nodes: dict[str, Node]
    traffic: str | None
    duration_s: float
    repeats: int
    seed: int


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A figure that nodes tell, in `unit`; changes up to `tolerance` do not matter. `neither` is compared between sites alone."""

    name: str
    tolerance: float
    better: str
    unit: str = ""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Seconds that each may take: a command of a node beside its experiment's duration, one of `build` or `test`, a site's
    `program`. What is stopped by one says nothing about a commit."""

    command_s: float = 60.0
    build_s: float = 3600.0
    program_s: float = 3600.0

    def times(self, factor: float) -> "Limits":
        return Limits(**{key: factor * value for key, value in asdict(self).items()})


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """A stack's pipeline. The first of `sites` is the twin, the others are held against it."""

    name: str
    environment: Environment
    build: tuple[str, ...]
    test: tuple[str, ...]
    image: tuple[str, ...]
    sample_rate_hz: float
    experiments: tuple[Experiment, ...]
    metrics: dict[str, Metric]
    sites: tuple[str, ...]
    limits: Limits = Limits()

    @property
    def recipe(self) -> dict:
        """All that the image depends on beside the sources."""
        return {"environment": asdict(self.environment), "build": self.build, "image": self.image}


def scenario_of(experiment: Experiment, folder: Path) -> Scenario:
    """The scenario of an experiment: a file of the repository, or a name of the catalogue."""
    path = folder / experiment.scenario
    return load(path if is_file(path) else experiment.scenario)


def read(path: str | Path) -> Pipeline:
    """Read a pipeline. Raises CastError with every fault at once, each with its place."""
    path = Path(path)
    path = path / FILE if path.is_dir() else path
    get = yaml_file(path, missing=f" (a stack's repository has a {FILE})")
    document = get.document
    get.keys(document, "", _TOP, _TOP - {"test", "image", "limits"})
    get.version("cast_pipeline", VERSION)
    rate_hz = get.number(document.get("sample_rate_hz"), "sample_rate_hz", "Hz", SLOWEST_HZ, FASTEST_HZ)
    experiments = [
        _experiment(get, entry, f"experiments[{k}]", path.parent, rate_hz)
        for k, entry in enumerate(_some(get, document.get("experiments"), "experiments"))
    ]
    _once(get, [one.name for one in experiments], "experiments")
    metrics = {RESIDUAL: Metric(name=RESIDUAL, tolerance=1.0, better="neither", unit="dB")}
    metrics |= {name: _metric(get, name, entry) for name, entry in get.mapping(document.get("metrics"), "metrics").items()}
    sites = tuple(get.name(one, f"sites[{k}]") for k, one in enumerate(_some(get, document.get("sites"), "sites")))
    _once(get, sites, "sites")
    parts = enumerate(get.sequence(document.get("image", []), "image"))
    made = dict(
        name=get.name(document.get("name"), "name"),
        environment=_environment(get, document.get("environment")),
        build=_commands(get, document.get("build"), "build"),
        test=_commands(get, document.get("test", []), "test"),
        image=tuple(get.path_inside(one, f"image[{k}]") for k, one in parts),
        limits=_limits(get, document.get("limits", {})),
    )
    get.faults.raise_if_any()
    return Pipeline(sample_rate_hz=rate_hz, experiments=tuple(experiments), metrics=metrics, sites=sites, **made)


def _some(get: Reader, value, place: str) -> list:
    entries = get.sequence(value, place)
    if value == []:
        get.faults.add(place, "is empty, needs one or more")
    return entries


def _once(get: Reader, names, place: str) -> None:
    for name in sorted({name for name in names if name and list(names).count(name) > 1}):
        get.faults.add(place, f"two are named {short(name)}")


def _commands(get: Reader, value, place: str) -> tuple[str, ...]:
    return tuple(get.text(one, f"{place}[{k}]") for k, one in enumerate(get.sequence(value, place)))


def _environment(get: Reader, value) -> Environment:
    entry = get.keys(value, "environment", {"system", "packages", "compiler"}, ("system", "packages", "compiler"))
    packages = get.sequence(entry.get("packages", []), "environment.packages")
    return Environment(
        system=get.name(entry.get("system", "none"), "environment.system"),
        packages=tuple(sorted(get.name(one, f"environment.packages[{k}]") for k, one in enumerate(packages))),
        compiler=get.name(entry.get("compiler", "none"), "environment.compiler"),
    )


def _limits(get: Reader, value) -> Limits:
    known = asdict(Limits())
    entry = get.keys(value, "limits", {*known})
    return Limits(
        **{key: get.number(entry.get(key, usual), f"limits.{key}", "s", 1e-3, LONGEST_S) for key, usual in known.items()}
    )


def _metric(get: Reader, name, entry) -> Metric:
    place = f"metrics.{get.name(name, 'metrics')}"
    entry = get.keys(entry, place, {"tolerance", "better", "unit"}, ("tolerance", "better"))
    return Metric(
        name=str(name),
        tolerance=get.number(entry.get("tolerance", 0.0), f"{place}.tolerance", low=0.0),
        better=get.choice(entry.get("better", "neither"), f"{place}.better", BETTER),
        unit=get.text(entry["unit"], f"{place}.unit") if "unit" in entry else "",
    )


def _experiment(get: Reader, entry, place: str, folder: Path, rate_hz: float) -> Experiment:
    entry = get.keys(entry, place, _EXPERIMENT, _EXPERIMENT - {"traffic", "seed"})
    duration_s = get.number(entry.get("duration_s", 1.0), f"{place}.duration_s", "s", 1e-6, LONGEST_S)
    if duration_s * rate_hz > LONGEST_SAMPLES:
        get.faults.add(place, f"duration_s: got {duration_s:g} s, {duration_s * rate_hz:g} samples, limit {LONGEST_SAMPLES}")
    nodes = {
        get.name(name, f"{place}.nodes"): _node(get, node, f"{place}.nodes.{short(name)[1:-1]}")
        for name, node in get.mapping(entry.get("nodes", {}), f"{place}.nodes").items()
    }
    for part in ("transmit", "receive"):
        if nodes and not any(getattr(node, part) for node in nodes.values()):
            get.faults.add(f"{place}.nodes", f"none has {part}")
    made = Experiment(
        name=get.name(entry.get("name", "none"), f"{place}.name"),
        scenario=get.text(entry.get("scenario", "none"), f"{place}.scenario"),
        nodes=nodes,
        traffic=get.path_inside(entry["traffic"], f"{place}.traffic") if "traffic" in entry else None,
        duration_s=duration_s,
        repeats=get.whole(entry.get("repeats", 2), f"{place}.repeats", "repeats", 2, MOST_REPEATS),
        seed=get.whole(entry.get("seed", 0), f"{place}.seed", "seed", 0, 1 << 31),
    )
    if "scenario" in entry and made.scenario:
        _scenario_holds(get, made, place, folder)
    if made.traffic:
        _traffic_holds(get, made, place, folder)
    return made


def _node(get: Reader, entry, place: str) -> Node:
    entry = get.keys(entry, place, {"transmit", "receive"})
    if entry == {}:
        get.faults.add(place, "needs transmit, receive or both: commands")
    return Node(**{part: get.text(entry[part], f"{place}.{part}") for part in ("transmit", "receive") if part in entry})


def _scenario_holds(get: Reader, experiment: Experiment, place: str, folder: Path) -> None:
    """The scenario is there, and so are its nodes and the links that they need."""
    try:
        scenario = scenario_of(experiment, folder)
    except CastError as error:
        for fault in error.faults:
            get.faults.add(f"{place}.scenario", fault)
        return
    known = [name for name in experiment.nodes if name in scenario.nodes]
    for name in experiment.nodes:
        if name not in known:
            get.faults.add(f"{place}.nodes", f"got {short(name)}, the scenario has {', '.join(scenario.nodes[:20])}")
    senders = [name for name in known if experiment.nodes[name].transmit]
    for rx in (name for name in known if experiment.nodes[name].receive):
        if senders and not any((tx, rx) in scenario.links for tx in senders):
            links = ", ".join(link_name((tx, rx)) for tx in senders if tx != rx) or "any link"
            get.faults.add(f"{place}.nodes.{rx}", f"receives from nobody: the scenario has no {links}")


def _traffic_holds(get: Reader, experiment: Experiment, place: str, folder: Path) -> None:
    try:
        traffic = flows.read(folder / experiment.traffic)
    except CastError as error:
        for fault in error.faults:
            get.faults.add(f"{place}.traffic", fault)
        return
    for node in traffic.nodes:
        if node not in experiment.nodes:
            get.faults.add(f"{place}.traffic", f"has a node {node}, the experiment has {', '.join(experiment.nodes)}")
