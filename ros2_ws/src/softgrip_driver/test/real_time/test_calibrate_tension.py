# SPDX-License-Identifier: Apache-2.0
"""calibrate_tension on the wires of the emulated cell."""

import re
from pathlib import Path

import numpy as np
import pytest

from softgrip_driver.commands import calibrate_tension, tension_recording
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.tendon.units import TorqueModel
from softgrip_driver.tendon.winding import Winding
from softgrip_emulator.cell import TIME_SOCKET, EmulatedCell
from softgrip_model.profile import load_directory

PROFILES = Path(__file__).parents[3] / "softgrip_bringup" / "profiles"


@pytest.mark.slow
def test_calibration_on_the_wires_of_the_cell_betters_the_data_sheet(tmp_path, capsys):
    """As a person types it: servo and gauge on their ports, the gauge hung into the tendon of a finger."""
    cell = EmulatedCell(load_directory(PROFILES), tmp_path, seed=4, gauge_on="index", speed=0.0)
    cell.plant.mount(["index"], ["a"], ["power"])
    with cell:
        code = calibrate_tension.main([
            "--port", str(tmp_path / "servos"), "--id", "1", "--gauge", str(tmp_path / "gauge"), "--tension", "9",
            "--travel", "0.025", "--speed", "0.015", "--rounds", "2", "--record", str(tmp_path / "samples.csv"),
            "--lockstep", str(tmp_path / TIME_SOCKET),
        ])  # fmt: skip
        printed = capsys.readouterr().out
        assert code == 0, printed
        assert cell.plant.servos[0].registers.get("torque_enable") == 0
        motor = cell.plant.motors[0]
    fitted = {name: float(value) for name, value in re.findall(r"^(\w+): \[([\d.]+)\]$", printed, re.MULTILINE)}
    assert "limited_currents: [supply]" in printed
    truth = motor.ratings.torque_constant_nm_per_a * 0.010 / motor.spool_radius_m
    share = fitted["tension_stddev_share"]
    assert fitted["torque_per_ampere_nm_a"] == pytest.approx(truth, rel=max(0.12, 2.0 * share))
    assert fitted["winding_resistances_ohm"] == pytest.approx(motor.resistance_ohm(25.0), rel=0.1)
    # What it was measured for: tensions over a recording of its own, against the data sheet's.
    samples = [s for s in tension_recording.read_csv(tmp_path / "samples.csv") if s.tension_n > 2.0]
    sheet = MODELS["XL330-M288"]
    measured = TorqueModel(
        fitted["torque_per_ampere_nm_a"], fitted["friction_currents_a"], share, "measured",
        fitted["friction_slopes_a_s_m"], fitted["gear_load_shares"],
    )  # fmt: skip
    models = (
        (Winding(fitted["winding_resistances_ohm"], fitted["back_emfs_v_s"]), measured),
        (Winding(sheet.resistance, sheet.back_emf), TorqueModel(sheet.torque_per_ampere, sheet.no_load_current)),
    )
    errors = [
        np.sqrt(np.mean([
            (torque.pull(winding.current(s.motor(0.010))[0], s.speed_m_s, 0.010)[0] - s.tension_n) ** 2 for s in samples
        ]))
        for winding, torque in models
    ]  # fmt: skip
    assert errors[0] < errors[1]
