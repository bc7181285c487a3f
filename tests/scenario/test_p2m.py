# SPDX-License-Identifier: GPL-3.0-or-later
import cast_scenario
import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario.create import p2m

FILE = """# <number of receiver points>
# <receiver point number> <number of paths for this point>
 2
1 2
1 90.0 2.0e-07 -50.0
2 -45.0 5.0e-07 -60.0
2 0
"""


def test_delays_phases_and_powers_are_those_of_the_file(tmp_path, capsys):
    path = tmp_path / "room.cir.t001_01.r002.p2m"
    path.write_text(FILE)
    (link,) = p2m.read(path, tx_power_dbm=10.0).values()
    np.testing.assert_array_equal(link.delay_s, [[2e-7, 5e-7]])
    np.testing.assert_allclose(link.gain, [[1e-3 * 1j, 10 ** (-70 / 20) * np.exp(-0.25j * np.pi)]])
    assert cast_scenario.main(["import", str(path), "--output", str(tmp_path / "room.yaml"), "--tx-power-dbm", "10"]) == 0
    made = sc.load(tmp_path / "room.yaml")
    assert made.nodes == ("t1", "r1") and set(made.links) == {("t1", "r1"), ("r1", "t1")}
    filters = sc.impulse_response(made.links["t1", "r1"])[0] * 10 ** (-made.base_loss_db / 20)
    np.testing.assert_allclose(filters[[20, 50]], link.gain[0], rtol=0.01)
    assert "room.yaml: 1 links; NMSE over 80 MHz: median -" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text, says",
    [
        ("", "end of file"),
        (FILE[:120], "damaged or truncated"),
        (FILE.replace("2.0e-07", "x"), "line 5"),
        (FILE.replace("2.0e-07", "-1"), "line 5"),
    ],
)
def test_damaged_files_are_refused_with_their_line(tmp_path, text, says):
    path = tmp_path / "room.cir.t001_01.r002.p2m"
    path.write_text(text)
    with pytest.raises(CastError, match=says):
        p2m.read(path, tx_power_dbm=0.0)
    with pytest.raises(CastError, match="name"):
        p2m.scenario([tmp_path / "room.p2m"], name="x", tx_power_dbm=0.0, bandwidth_hz=1e6)
