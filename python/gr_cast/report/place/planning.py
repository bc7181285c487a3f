# SPDX-License-Identifier: GPL-3.0-or-later
"""What a plan of soundings says: a table, a document, and the place from above."""

import numpy as np
from matplotlib.figure import Figure

from ...twin.places.planning import DOUBT, KNOWN, Number, Plan
from ...twin.places.world import World
from ..plot import new_figure
from .outline import edges

UNITS = {"reflection_db": "dB", "place_m": "m"}
LIT, NEWLY, UNSEEN = "#30343a", "#2f8f4e", "#c2402e"


def unseen(plan: Plan, stage: int) -> tuple[list[str], list[str]]:
    """Objects that no path is reflected by: those that stand in the way of one, and those of which nothing is known."""
    sight = plan.sights[stage]
    dark = [name for name in plan.objects if name not in sight.lit]
    return [name for name in dark if name in sight.shading], [name for name in dark if name not in sight.shading]


def words(number: Number) -> str:
    """`rack_1: place along (1, 0, 0)`."""
    if number.axis is None:
        return f"{number.name}: reflection"
    return f"{number.name}: place along ({', '.join(f'{x:.3g}' for x in np.round(number.axis, 3) + 0.0)})"


def table(plan: Plan, has_campaign: bool) -> list[str]:
    """Lines: the positions, what each adds; what becomes known; what stays dark."""
    last = len(plan.gains_nats)
    lines = [f"{'':4s}{'x':>8s} {'y':>8s} {'z':>8s} {'adds':>9s}  {'known of ' + str(len(plan.numbers)):>12s}  first lit here"]
    if has_campaign:
        lines.append(f"{'campaign':30s} {'':9s}{int(plan.known(0).sum()):>12d}")
    for stage, (place, nats) in enumerate(zip(plan.positions_m, plan.gains_nats, strict=True), 1):
        news = sorted(plan.sights[stage].lit - plan.sights[stage - 1].lit)
        shown = f"all but {_dark(plan, stage)}" if len(news) > 12 else ", ".join(news) or "-"
        cells = " ".join(f"{x:8.2f}" for x in place)
        lines.append(f"{stage:<4d}{cells} {nats:5.0f} nats  {int(plan.known(stage).sum()):>12d}  {shown}")
    lines.append("")
    for stage, who in ((0, "the campaign"), (last, "campaign and positions" if has_campaign else "these positions")):
        if stage == 0 and not has_campaign:
            continue
        shaded, dark = unseen(plan, stage)
        lines += [f"no path of {who} is reflected by: {', '.join(shaded + dark) or 'no object is left out'}"]
        if dark and shaded:
            lines += [f"    of these nothing shows, not even by a shadow: {', '.join(dark)}"]
    never = [name for name in plan.objects if name not in plan.everywhere | plan.sights[0].lit]
    if never:
        lines.append(f"no position of the region lights: {', '.join(never)}")
    left = [
        f"{words(number)}: {deviation:.2g} {UNITS[number.what]}"
        for number, deviation, known in zip(plan.numbers, plan.deviations(last), plan.known(last), strict=True)
        if not known
    ]
    limits = ", ".join(f"{KNOWN[what]:g} {unit}" for what, unit in UNITS.items())
    if plan.numbers and not left:
        return [*lines, f"all {len(plan.numbers)} numbers are known to {limits}"]
    lines.append(f"not known to {limits} ({len(left)} of {len(plan.numbers)}), standard deviation that stays:")
    return [*lines, *(f"    {line}" for line in left)]


def _dark(plan: Plan, stage: int) -> str:
    return ", ".join(name for name in plan.objects if name not in plan.sights[stage].lit) or "none"


def document(plan: Plan, links, anchors) -> dict:
    """The plan for programs."""
    last = len(plan.gains_nats)
    before, campaign, after = np.array([DOUBT[n.what] for n in plan.numbers]), plan.deviations(0), plan.deviations(last)
    return {
        "cast_plan": 1,
        "campaign": {"links": [">".join(link) for link in links], **_seen(plan, 0)},
        "anchors": list(anchors),
        "noise_power": plan.noise_power,
        "positions": [
            {
                "position_m": np.round(place, 4).tolist(),
                "gain_nats": nats,
                "lights": sorted(plan.sights[stage].lit - plan.sights[stage - 1].lit),
                "known": int(plan.known(stage).sum()),
            }
            for stage, (place, nats) in enumerate(zip(plan.positions_m, plan.gains_nats, strict=True), 1)
        ],
        "with_positions": _seen(plan, last),
        "unreachable": [name for name in plan.objects if name not in plan.everywhere | plan.sights[0].lit],
        "numbers": [
            {
                "level": n.level,
                "name": n.name,
                "what": n.what,
                "axis": n.axis,
                "std_before": float(before[k]),
                "std_campaign": float(campaign[k]),
                "std_after": float(after[k]),
                "known": bool(plan.known(last)[k]),
            }
            for k, n in enumerate(plan.numbers)
        ],
    }


def _seen(plan: Plan, stage: int) -> dict:
    shaded, dark = unseen(plan, stage)
    return {"unlit": [*shaded, *dark], "unseen": dark}


def figure(plan: Plan, world: World, links, anchors, title: str) -> Figure:
    """The place from above: what a first position would add, the chosen ones, objects by what lights them."""
    low, high = (bound(np.concatenate([s.vertices_m for s in world.mesh.solids]), axis=0) for bound in (np.min, np.max))
    nodes = {name: radio.node for name, radio in world.radios.items()}
    width, depth = np.maximum((high - low)[:2], 1.0)
    picture = new_figure(9.5, float(np.clip(9.5 * depth / width, 4, 11)))
    axes = picture.subplots()
    spots = axes.scatter(*plan.grid_m[:, :2].T, c=plan.first_nats, s=28, marker="s", cmap="YlGnBu", linewidths=0, zorder=1)
    picture.colorbar(spots, ax=axes, label="a first position adds, nats", shrink=0.7)
    for one, other in links:
        ends = np.array([nodes[name].waypoints_m[0][:2] for name in (one, other)])
        axes.plot(*ends.T, color="#888888", linewidth=0.6, zorder=2)
    lit, after = plan.sights[0].lit, plan.sights[-1].lit
    drawn = {}
    for solid in world.mesh.solids:
        kind = (LIT, "lit by the campaign") if solid.name in lit else (NEWLY, "lit by a chosen position")
        kind = kind if solid.name in after else (UNSEEN, "lit by none")
        for a, b in edges(solid.vertices_m[solid.faces]):
            (line,) = axes.plot(
                [a[0], b[0]], [a[1], b[1]], color=kind[0], linewidth=1.4, linestyle="--" if kind[0] == UNSEEN else "-",
                zorder=4 if kind[0] == UNSEEN else 3,
            )  # fmt: skip
            drawn.setdefault(kind[1], line)
    for name, node in nodes.items():
        way = node.waypoints_m
        used = name in anchors or any(name in link for link in links)
        axes.plot(
            way[:, 0], way[:, 1], color="#30343a", marker="o", markersize=4, linewidth=1, alpha=1 if used else 0.35, zorder=5
        )
        if len(nodes) <= 60:
            axes.annotate(name, way[0][:2], xytext=(3, 3), textcoords="offset points", fontsize=7, zorder=6)
    for number, place in enumerate(plan.positions_m, 1):
        axes.plot(*place[:2], marker="o", markersize=15, color="#d1701f", markeredgecolor="white", zorder=7)
        axes.annotate(str(number), place[:2], ha="center", va="center", color="white", fontsize=9, weight="bold", zorder=8)
    axes.set_aspect("equal")
    margin = 0.03 * max(width, depth)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_title(title, loc="left", fontsize=11)
    axes.legend(drawn.values(), drawn.keys(), loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False, fontsize=8)
    return picture
