# SPDX-License-Identifier: GPL-3.0-or-later
"""How well another single cause explains what a cause did: the margin in nats by which it is the only one of the families."""

import numpy as np
from causes import Unfit, one_of, shifted, with_media, with_node, without_object
from mirror import patches
from scipy.optimize import minimize, minimize_scalar
from slabs import C_M_PER_S, TABLE, medium
from world import excess, is_moving, position_m, response

ENOUGH = 16  # frequencies and
INSTANTS = 4  # instants are enough to compare explanations
MANY = 6  # objects, the most lit ones, are enough to be rivals
ANY = (1.3, 1.7, 2.3, 3.0, 4.0, 5.5, 8.0)  # permittivities of materials that are in no table
LIKELY = ("metal", "glass", "wood", "concrete", "ceiling_board", "brick", "marble", "medium_dry_ground")


class Judge:
    """Energy that a world leaves unexplained of a given one, on a thinned campaign, in the units of the whole one."""

    def __init__(self, truth, campaign, noise_power):
        moving = any(is_moving(truth["nodes"][n]) for link in campaign.links for n in link) or truth["person"]
        times = campaign.time_s
        chosen = np.unique(np.linspace(0, len(times) - 1, INSTANTS if moving else 1).round().astype(int))
        step = max(1, len(campaign.frequency_hz) // ENOUGH)
        self.links, self.time_s, self.f = campaign.links, times[chosen], campaign.frequency_hz[::step]
        scale = len(times) / len(chosen) * len(campaign.frequency_hz) / len(self.f)
        self.noise, self.unknown = np.asarray(noise_power) / scale, campaign.unknown
        self.data = response(truth, self.links, self.time_s, self.f)

    def of(self, model):
        return excess(model, self.data, self.noise, self.links, self.f, self.unknown, near=True)[0]

    def __call__(self, world):
        return self.of(response(world, self.links, self.time_s, self.f))


def _scalar(energy, grid):
    """Least energy over one number: a grid, then its best cell; of two bounds, what lies between them."""
    values = [energy(x) for x in grid] if len(grid) > 2 else [np.inf, np.inf]
    k = int(np.argmin(values))
    low, high = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
    return min(values[k], minimize_scalar(energy, bounds=sorted((low, high)), method="bounded", options={"maxiter": 6}).fun)


def _shift(judge, world, name):
    """Least energy over offsets of a node: Gauss-Newton by differences from a few starts."""
    best = np.inf
    wave = C_M_PER_S / world["carrier_hz"]
    node = world["nodes"][name]
    old = np.array(node.get("offset_m", (0, 0, 0)), float)
    weight = 1 / np.sqrt(judge.noise)[:, None, None]

    def fitted(offset):
        h = response(with_node(world, name, offset_m=(old + offset).tolist()), judge.links, judge.time_s, judge.f)
        energy, model = excess(h, judge.data, judge.noise, judge.links, judge.f, judge.unknown, near=True)
        return energy, ((judge.data - model) * weight).ravel()

    for start in (np.zeros(3), np.array([0.7, 0.4, 0]) * wave):
        at, (energy, rest) = start, fitted(start)
        for _ in range(3):
            slopes = np.stack([(fitted(at + d)[1] - rest) / (wave / 200) for d in np.eye(3) * wave / 200], 1)
            a, b = np.vstack([slopes.real, slopes.imag]), np.concatenate([rest.real, rest.imag])
            step = -np.linalg.lstsq(a, b, rcond=1e-6)[0]
            step *= min(1, wave / max(np.linalg.norm(step), 1e-12))
            new, left = fitted(at + step)
            if new > energy * 0.999:
                break
            at, energy, rest = at + step, new, left
        best = min(best, energy)
    return best


def runners_up(judge, without, cause, lit, least, spared=(), quick=False):
    """[(energy left, family, owner)] of single causes other than the true one, best first, each with its parameters fitted.

    Unfit as soon as one leaves less than `least`. Families `spared` are no rivals. `quick`: those alone that need no new paths.
    """
    out = []
    plain = response(without, judge.links, judge.time_s, judge.f)

    def add(family, owner, energy):
        if (
            family not in spared
            and (family, owner) != (cause.family, cause.name)
            and not (family == cause.family and owner in cause.owners)
        ):
            out.append((float(energy), family, owner))
            if energy < least:
                raise Unfit(f"{cause.family}: {family} of {owner} explains it")

    add("nothing", "", judge.of(plain))
    nodes = sorted({n for link in judge.links for n in link})
    decibels = (-15, 15)
    for n in nodes:
        mine = np.array([n in link for link in judge.links])[:, None, None]
        add("node_gain", n, _scalar(lambda x, m=mine: judge.of(plain * 10 ** (x / 20 * m)), decibels))
        grid = np.array([-6, -2, -0.7, -0.2, 0, 0.2, 0.7, 2, 6]) * 1e-9
        add("node_delay", n, _scalar(lambda x, m=mine: judge.of(plain * np.exp(-2j * np.pi * judge.f * x * m)), grid))
    for k, link in enumerate(judge.links):
        mine = (np.arange(len(judge.links)) == k)[:, None, None]
        if "node_gain:link" not in cause.same_as or ">".join(link) != cause.name:
            add("excess_loss", ">".join(link), _scalar(lambda x, m=mine: judge.of(plain * 10 ** (x / 20 * m)), decibels))
    far = _distances(without, judge)
    add("excess_loss", "place", _scalar(lambda x: judge.of(plain * far ** (-x / 2)), (-1.5, 1.5)))
    if quick:
        return sorted(out)
    for n in nodes:
        for antenna in ("iso", "dipole", "hw_dipole", "tr38901"):
            if antenna != without["nodes"][n]["antenna"]:
                add("antenna_pattern", n, judge(with_node(without, n, antenna=antenna)))
        if without["nodes"][n]["antenna"] == "tr38901":
            turn = np.array(without["nodes"][n]["orientation_rad"])

            def yawed(x, n=n, turn=turn):
                return judge(with_node(without, n, orientation_rad=(turn + [x, 0, 0]).tolist()))

            add("antenna_orientation", n, _scalar(yawed, np.linspace(-1.5, 1.5, 9)))
        if is_moving(without["nodes"][n]):
            add(
                "track_timing",
                n,
                _scalar(lambda x, n=n: judge(with_node(without, n, speed_factor=x)), np.linspace(0.85, 1.15, 7)),
            )
            add(
                "track_timing",
                n,
                _scalar(lambda x, n=n: judge(with_node(without, n, time_offset_s=x)), np.linspace(-0.5, 0.5, 7)),
            )
        add("node_position", n, _shift(judge, without, n))
    for key, family in (("refraction", "missing_transmission"), ("diffraction", "missing_diffraction")):
        if not without[key]:
            add(family, "place", judge(one_of(without, **{key: True})))
    if without["max_depth"] < 2:
        add("missing_reflections", "place", judge(one_of(without, max_depth=without["max_depth"] + 1)))
    add(
        "carrier",
        "place",
        _scalar(lambda x: judge(one_of(without, carrier_hz=without["carrier_hz"] * x)), np.linspace(0.97, 1.03, 9)),
    )
    for k, o in enumerate(lit):
        if o in without["objects"] and (k < MANY or o == cause.name):
            _of_object(judge, without, o, add)
    return sorted(out)


def _distances(world, judge):
    at = {n: position_m(world["nodes"][n], judge.time_s) for n in {x for link in judge.links for x in link}}
    return np.array([np.linalg.norm(at[a] - at[b], axis=1) for a, b in judge.links])[:, :, None]


def _made(judge, world, o):
    """Least energy over what an object is made of: materials of the table, and any numbers from the best of these on."""
    fc = world["carrier_hz"]

    def energy(logs):
        permittivity, conductivity = np.exp(logs)
        return judge(with_media(world, o, permittivity=max(permittivity, 1.0), conductivity=conductivity))

    known = [np.log(np.maximum(medium(m, fc), 1e-6)) for m in LIKELY if TABLE[m][4] <= fc / 1e9 <= TABLE[m][5]]
    known += [np.log([permittivity, conductivity]) for permittivity in ANY for conductivity in (0.01, 0.1)]
    best = sorted(known, key=energy)[:2]
    return min(minimize(energy, one, method="Nelder-Mead", options={"maxfev": 25}).fun for one in best)


def _of_object(judge, world, o, add):
    fc = world["carrier_hz"]
    add("extra_object", o, judge(without_object(world, o)))
    add("material", o, _made(judge, world, o))
    depths = np.sqrt(np.array([0.05, 0.4, 2]) / 8) * C_M_PER_S / fc / np.pi
    add("roughness", o, _scalar(lambda x: judge(with_media(world, o, height_rms_m=x)), depths))
    normals = patches({o: world["objects"][o]["tris"]}).normal
    for n in {tuple(np.round(x * np.sign(x[np.argmax(np.abs(x))]), 6)) for x in normals}:
        if abs(n[2]) < 0.5 or len(normals) == 1:
            grid = [-0.4, -0.1, -0.02, 0.02, 0.1, 0.4]
            add("object_moved", o, _scalar(lambda x, n=n: judge(shifted(world, o, x * np.array(n))), grid))
