# SPDX-License-Identifier: Apache-2.0
"""calibrate_tension on the wires of the emulated cell."""

import re
from pathlib import Path

import numpy as np
import pytest

from softgrip_driver.commands import calibrate_tension
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.tendon.units import TorqueModel
from softgrip_emulator.cell import EmulatedCell
from softgrip_model.profile import load_directory

PROFILES = Path(__file__).parents[3] / "softgrip_bringup" / "profiles"


@pytest.mark.slow
def test_calibration_on_the_wires_of_the_cell_betters_the_data_sheet(tmp_path, capsys):
    """As a person types it: servo and gauge on their ports, the gauge hung into the tendon of a finger."""
    cell = EmulatedCell(load_directory(PROFILES), tmp_path, seed=4, gauge_on="index")
    cell.plant.mount(["index"], ["a"], ["power"])
    with cell:
        code = calibrate_tension.main([
            "--port", str(tmp_path / "servos"), "--id", "1", "--gauge", str(tmp_path / "gauge"), "--tension", "9",
            "--travel", "0.025", "--speed", "0.006", "--rounds", "2", "--record", str(tmp_path / "samples.csv"),
            "--reply-margin", "0.1",
        ])  # fmt: skip
        printed = capsys.readouterr().out
        assert code == 0, printed
        assert cell.plant.servos[0].registers.get("torque_enable") == 0
        motor = cell.plant.motors[0]
    fitted = dict(re.findall(r"^(\w+): \[([\d.]+)\]$", printed, re.MULTILINE))
    assert set(fitted) == {"torque_per_ampere_nm_a", "friction_currents_a", "tension_stddev_share"}
    truth = motor.ratings.torque_constant_nm_per_a * 0.010 / motor.spool_radius_m
    share = float(fitted["tension_stddev_share"])
    assert float(fitted["torque_per_ampere_nm_a"]) == pytest.approx(truth, rel=max(0.12, 2.0 * share))
    # What it was measured for: tensions over a recording of its own, against the data sheet's.
    samples = [s for s in calibrate_tension.read_csv(tmp_path / "samples.csv") if s.tension > 2.0]
    sheet = MODELS["XL330-M288"]
    models = (
        TorqueModel(float(fitted["torque_per_ampere_nm_a"]), float(fitted["friction_currents_a"]), share),
        TorqueModel(sheet.torque_per_ampere, sheet.no_load_current),
    )
    errors = [
        np.sqrt(np.mean([(m.pull(s.current, s.speed, 0.010)[0] - s.tension) ** 2 for s in samples])) for m in models
    ]
    assert errors[0] < errors[1]
