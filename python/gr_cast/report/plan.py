# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a place as one page that needs no other file: objects from above, nodes and their tracks, path loss from a node
that is clicked on."""

import json
from html import escape

import numpy as np

from ..core.errors import CastError
from ..scenario import Scenario, band_hz, path_gain_over_time_db
from .plot import colour_scale

MOST_INSTANTS = 400  # of a track: the slider's steps
MOST_LOSSES = 200_000  # of all links at all of them: a page of a megabyte
WIDTH = 900.0  # of the drawing, in its own units

_STYLE = """body{font:15px/1.4 sans-serif;margin:1.5em;max-width:70em}svg{width:100%;max-height:78vh;border:1px solid #bbb}
.object{fill:#b9b1a4;stroke:#b9b1a4;stroke-width:2;stroke-linejoin:round}.floor{fill:#f4f2ee;stroke:none}
.track{fill:none;stroke:#777;stroke-dasharray:5 4}.link{stroke-width:2.5}.node circle{stroke:#222;stroke-width:1.2;cursor:pointer}
.node text{font-size:13px;pointer-events:none;paint-order:stroke;stroke:#fff;stroke-width:3px}.sent circle{stroke-width:4}
.bar{height:.8em;width:16em;display:inline-block;vertical-align:middle;margin:0 .6em}label{margin-right:2em}"""

# The colours of the picture's scale from the least loss to the most; a node that is not heard is white.
_SCRIPT = """
const scale=[[253,231,37],[94,201,98],[33,145,140],[59,82,139],[68,1,84]];
function colour(loss){if(loss===null)return'#fff';const x=Math.min(1,Math.max(0,(loss-P.low)/Math.max(P.high-P.low,1e-9)))*4,
i=Math.min(3,Math.floor(x));return'rgb('+scale[i].map((c,k)=>Math.round(c+(scale[i+1][k]-c)*(x-i)))+')'}
let sender=0;const nodes=[...document.querySelectorAll('.node')],links=document.querySelector('#links'),
slider=document.querySelector('#time');
function draw(){const t=slider?+slider.value:0,L=P.loss_db[Math.min(t,P.loss_db.length-1)],
at=k=>P.tracks[k][Math.min(t,P.tracks[k].length-1)];links.innerHTML='';
document.querySelector('#from').textContent=P.names[sender];
if(slider)document.querySelector('#now').textContent=P.time_s[t].toFixed(2)+' s';
nodes.forEach((node,k)=>{const p=at(k),loss=L[sender][k];node.setAttribute('transform','translate('+p+')');
node.classList.toggle('sent',k===sender);node.firstChild.setAttribute('fill',k===sender?'#e33':colour(loss));
node.querySelector('title').textContent=P.names[k]+(k===sender?' sends':loss===null?': not heard':': '+loss.toFixed(1)+' dB');
if(k!==sender&&loss!==null){const line=document.createElementNS('http://www.w3.org/2000/svg','line'),q=at(sender);
line.setAttribute('class','link');line.setAttribute('stroke',colour(loss));
[['x1',q[0]],['y1',q[1]],['x2',p[0]],['y2',p[1]]].forEach(a=>line.setAttribute(...a));links.append(line)}})}
nodes.forEach((node,k)=>node.addEventListener('click',()=>{sender=k;draw()}));if(slider)slider.addEventListener('input',draw);draw();
"""


def page(scenario: Scenario, outlines: list[dict], bandwidth_hz: float | None = None) -> str:
    """The page: `outlines` are objects as `name`, `faces` ([[x, y], …] in metres each) and `floor`, true of the ground; losses
    are those over a band, the scenario's own unless another is given, at every step of the slider. Raises CastError where the
    scenario does not say where its nodes are."""
    missing = [node for node in scenario.nodes if node not in scenario.position_m]
    if missing:
        raise CastError(f"{scenario.name}: plan: no position of {', '.join(missing[:8])}{', …' if len(missing) > 8 else ''}")
    most = max(1, min(len(scenario.time_s), MOST_INSTANTS, MOST_LOSSES // len(scenario.nodes) ** 2))
    chosen = np.unique(np.linspace(0, len(scenario.time_s) - 1, most).astype(int))
    tracks = [np.asarray(scenario.position_m[node]) for node in scenario.nodes]
    tracks = [track if len(track) == 1 or np.ptp(track, axis=0).max() > 0 else track[:1] for track in tracks]
    tracks_m = [track[:, :2] if len(track) == 1 else track[chosen, :2] for track in tracks]
    corners = np.concatenate([*tracks_m, *(np.array(face) for outline in outlines for face in outline["faces"])])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.05 * max(*(high - low), 1.0)
    low, high = low - margin, high + margin
    per_m = WIDTH / max(high - low)

    def place(points) -> list[list[float]]:
        return np.round((np.atleast_2d(points) - low) * [1, -1] * per_m + [0, (high - low)[1] * per_m], 1).tolist()

    width_hz = bandwidth_hz or band_hz(scenario)
    loss_db = -path_gain_over_time_db(scenario, chosen[:1] if scenario.is_static else chosen, width_hz)
    ends = colour_scale(loss_db)
    data = {
        "names": scenario.nodes,
        "tracks": [place(track) for track in tracks_m],
        "time_s": scenario.time_s[chosen].tolist(),
        "loss_db": [[[float(round(v, 1)) if np.isfinite(v) else None for v in row] for row in rows] for rows in loss_db],
        "low": ends.get("vmin", 0.0),
        "high": ends.get("vmax", 1.0),
    }
    width, height = ((high - low) * per_m).round(1)
    slider = (
        f'<label>time <input id="time" type="range" min="0" max="{len(chosen) - 1}" value="0"> <span id="now"></span></label>'
        if any(len(track) > 1 for track in tracks_m) or not scenario.is_static
        else ""
    )
    ruler_m = float(10 ** np.floor(np.log10(0.4 * (high - low)[0])))
    ruler = (
        f'<path d="M12 {height - 12}h{ruler_m * per_m:.1f}" stroke="#222" stroke-width="3"/>'
        f'<text x="12" y="{height - 18}" font-size="13">{ruler_m:g} m</text>'
    )
    title = escape(scenario.name)
    return f"""<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>{title}: plan</title><style>{_STYLE}</style>
<h1>{title}</h1><p>Click on a node: path loss from <b id="from"></b> to the others in {width_hz / 1e6:g} MHz, at the time chosen.
{data["low"]:.1f} dB <span class="bar" style="background:linear-gradient(90deg,rgb(253,231,37),rgb(94,201,98),rgb(33,145,140),
rgb(59,82,139),rgb(68,1,84))"></span> {data["high"]:.1f} dB; white is not heard. {slider}</p>
<svg viewBox="0 0 {width} {height}">{_objects(outlines, place)}{_tracks(data["tracks"])}
<g id="links"></g>{_nodes(scenario)}{ruler}</svg>
<script>const P={json.dumps(data).replace("<", chr(92) + "u003c")};{_SCRIPT}</script></html>
"""


def _objects(outlines: list[dict], place) -> str:
    shapes = []
    for outline in sorted(outlines, key=lambda one: not one["floor"]):
        way = "".join("M" + "L".join(f"{x} {y}" for x, y in place(face)) + "Z" for face in outline["faces"])
        kind = "floor" if outline["floor"] else "object"
        shapes.append(f'<path class="{kind}" d="{way}"><title>{escape(outline["name"])}</title></path>')
    return "".join(shapes)


def _tracks(tracks: list) -> str:
    ways = (" ".join(f"{x},{y}" for x, y in track) for track in tracks if len(track) > 1)
    return "".join(f'<polyline class="track" points="{way}"/>' for way in ways)


def _nodes(scenario: Scenario) -> str:
    return "".join(
        f'<g class="node"><circle r="7"/><title></title><text x="9" y="-7">{escape(node)}</text></g>' for node in scenario.nodes
    )
