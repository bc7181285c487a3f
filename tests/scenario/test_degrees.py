# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes by latitude and longitude stand where the extract's own points of the same degrees do."""

from xml.etree import ElementTree

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario.create import osm, spec

EXTRACT = """<osm version="0.6"><bounds minlat="59.99" maxlat="60.01" minlon="9.98" maxlon="10.02"/>
<node id="1" lat="60.001" lon="10.002"/></osm>"""


def text(node):
    street = (sc.examples_folder() / "street.yaml").read_text()
    return (
        street[: street.index("nodes:")].replace("street.osm", str(sc.examples_folder() / "street.osm"))
        + f"nodes: {{a: {node}}}\n"
    )


def test_a_degree_is_the_ellipsoids_arc(tmp_path):
    """WGS 84 at 60 degrees: a minute of latitude is 1857 m, one of longitude 930 m (tables of the Bowditch)."""
    (tmp_path / "x.osm").write_text(EXTRACT)
    east_m, north_m = osm.place_m(tmp_path / "x.osm", 60 + 1 / 600, 10 + 1 / 600)
    assert 10 * north_m == pytest.approx(1857.0, abs=1.0) and 10 * east_m == pytest.approx(930.0, abs=1.0)


def test_a_node_stands_on_the_corner_of_a_house_with_its_degrees(tmp_path):
    extract = sc.examples_folder() / "street.osm"
    root = ElementTree.parse(extract).getroot()
    house = next(way for way in root.iter("way") if any(tag.get("k") == "building" for tag in way.iter("tag")))
    corner = next(node for node in root.iter("node") if node.get("id") == house.find("nd").get("ref"))
    place = f"{{position_deg: [{float(corner.get('lat'))}, {float(corner.get('lon'))}, 7.0]}}"
    (tmp_path / "s.yaml").write_text(text(place).rstrip()[:-1] + ", b: {position_m: [0, 0, 30]}}\n")
    (x_m, y_m, height_m) = np.asarray(spec.read(tmp_path / "s.yaml").nodes[0].waypoints_m)[0]
    corners_m = np.concatenate([solid.vertices_m[:, :2] for solid in osm.read(extract)[0]])
    assert height_m == 7 and np.linalg.norm(corners_m - [x_m, y_m], axis=1).min() < 1e-6


def test_degrees_of_no_place_on_earth_are_refused(tmp_path):
    (tmp_path / "s.yaml").write_text(text("{position_deg: [100.0, 10.0, 7.0]}"))
    with pytest.raises(CastError, match="nodes.a.position_deg: .*degrees within 90 and 180"):
        spec.read(tmp_path / "s.yaml")
