# SPDX-License-Identifier: GPL-3.0-or-later
"""How the page of a place looks, on screens and on paper."""

PLACE_STYLE = """
.view{width:100%;border:1px solid #d5dce3;border-radius:.3rem;margin:.4rem 0;touch-action:none;background:#fff}
.view text{font:12px system-ui,sans-serif;fill:#1b2733}.axes text{fill:#5b6b7a;font-size:11px}.tick{stroke:#8a99a8}
.object{fill:#c9b79c;stroke:#94805f;stroke-width:1.6;stroke-linecap:round}.object.shading{fill:#ebe3d5;stroke:#c9bda6}
.object.dark{fill:#dde0e3;stroke:#b9bec4}.object.floor{fill:#f6f3ee}.object.floor.dark{fill:#eef0f1}
.object.fill{stroke:none;fill-opacity:.75}.object.edge{fill:none}.object.fill.beyond{fill-opacity:.12}
.object.edge.beyond{stroke-opacity:.35;stroke-width:1}.object.cut{fill:none;stroke-width:4}
.object.blamed{fill:#ffb347}.object.blamed.edge,
.object.blamed.cut{fill:none;stroke:#b3541e;stroke-width:3;stroke-opacity:1}.object.blamed.floor{fill-opacity:.3}.object.blamed.fill.beyond{fill-opacity:.5}
.link{stroke-width:2.2;stroke-opacity:.85;cursor:pointer}.link.vault{stroke-dasharray:6 4;stroke-width:1.5}
.link.blamed{stroke-width:5}.link:hover,.link.shown{stroke-width:6;stroke-opacity:1}
.track{fill:none;stroke:#5b6b7a;stroke-dasharray:3 3}.node circle{fill:#1b2733;stroke:#fff;stroke-width:1.5}
.node .ring{fill:none;stroke:#7a1fa2;stroke-width:3}.node text{paint-order:stroke;stroke:#fff;stroke-width:3px;font-weight:600}
.plane{fill:#7a1fa2;fill-opacity:.25;stroke:#7a1fa2;stroke-width:4;stroke-linejoin:round}
.plane.level{fill-opacity:.08;stroke-width:2.5}
.unsure{fill:#7a1fa2;fill-opacity:.14;stroke:#7a1fa2;stroke-opacity:.5;stroke-dasharray:2 3}
.arrow{fill:none;stroke:#7a1fa2;stroke-width:3}.head{fill:#7a1fa2}.was .arrow{stroke:#8a99a8}.was .head{fill:#8a99a8}
.view text.times{fill:#7a1fa2;font-weight:600;paint-order:stroke;stroke:#fff;stroke-width:3px}
circle.number{fill:#7a1fa2;stroke:#fff;stroke-width:1.5}.view text.number{fill:#fff;text-anchor:middle;font-weight:700}
.mark.flash{animation:flash .5s 4 alternate}@keyframes flash{to{opacity:.15}}
.target path,.target circle{fill:none;stroke:#0b6fb8;stroke-width:2.5}.view .target text{fill:#0b6fb8;font-weight:600;
paint-order:stroke;stroke:#fff;stroke-width:3px}
.number-of{background:#7a1fa2}.cause{cursor:default}
.toggle input{position:absolute;opacity:0}.toggle label{display:inline-block;padding:.25rem .9rem;border:1px solid #8a99a8;
cursor:pointer;user-select:none}.toggle input:checked+label{background:#1b2733;color:#fff}
.toggle input:focus-visible+label{outline:2px solid #0b6fb8}
#show-before:checked~.views .after,#show-after:checked~.views .before{display:none}
.scale{margin-left:1.2rem;font-size:.9rem}.ramp{display:inline-block;height:.8em;width:9em;vertical-align:middle;margin:0 .4em}
.bar{display:flex;align-items:center;gap:.6rem;margin:.2rem 0}.bar span{width:8rem}.bar i{height:1.1rem;min-width:2px}
i.was{background:#b3541e}i.is{background:#3b7a57}i.floor{background:#8a99a8}
#chart svg{width:100%;max-width:48rem}#chart text{font:12px system-ui,sans-serif;fill:#1b2733}#chart polyline{fill:none;
stroke-width:1.8}#chart .was{stroke:#b3541e}#chart .is{stroke:#3b7a57}#chart circle{fill:#1b2733}#chart .axis{stroke:#8a99a8}
#chart text.was{fill:#b3541e;stroke:none}#chart text.is{fill:#3b7a57;stroke:none}
@media print{.view.before,.view.after{display:block!important;break-inside:avoid}.toggle label,.live,#chart{display:none}
.view.before::before{content:"twin"}.cause,img{break-inside:avoid}body{margin:0;max-width:none}}
"""
