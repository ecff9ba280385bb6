# SPDX-License-Identifier: Apache-2.0
"""The driver's tension on a motor that nobody here wrote: the XL330 that Rhoban identified on real ones.

Motor, gears and their friction are Rhoban/bam's simulator with its published parameters (bam/params/xl330: m4, m6).
The servo's firmware, the weights and what is looked at are those of benchmarks/driver/x330_tension.py. Its copper warms
by IEC 60028; bam's own is at one temperature. With --cell three such motors move the emulated cell, and the row of
benchmarks/driver/servo_facts.py is printed for them.

    git clone https://github.com/Rhoban/bam && pip install colorama
    python tools/peers/bam_motor.py bam m4
    python tools/peers/bam_motor.py bam m6 --cell
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from softgrip_testing.scripts import load_script

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks/driver"
sys.path.append(str(BENCHMARKS))
x330_tension = load_script(BENCHMARKS / "x330_tension.py")
servo_facts = load_script(BENCHMARKS / "servo_facts.py")

#: copper, a kelvin, from the temperature at which bam's resistance is taken to be
COPPER_PER_K, IDENTIFIED_C = 0.00393, 24.0


class IdentifiedMotor:
    """bam's simulator of a motor, in the place of softgrip_emulator's.

    Args:
        simulator: bam's, with a model of its own.
        shaft: shared with the servo.
        spool_radius_m: [m]
    """

    #: what faults do to an emulated motor; nobody does it here
    jammed, extra_heat_w = False, 0.0

    def __init__(self, simulator: Any, shaft: Any, spool_radius_m: float) -> None:
        self.spool_radius_m = spool_radius_m
        self._simulator, self._shaft, self._spool_radius_m = simulator, shaft, spool_radius_m
        self._model, self._pull_n = simulator.model, 0.0
        self._cool_ohm = self._model.R.value
        self._model.actuator.testbench = self

    def compute_mass(self, q: float, dq: float) -> float:
        """Return the inertia [kg m^2] beside the motor's own: a pull has none."""
        del q, dq
        return 0.0

    def compute_bias(self, q: float, dq: float) -> float:
        """Return the torque [N m] of the tendon."""
        del q, dq
        return -self._pull_n * self._spool_radius_m

    def step(self, drive: Any, tension_n: float, supply_v: float, dt_s: float) -> None:
        """Advance the shaft by one step; as `softgrip_emulator.plant.motor.Motor.step`, without heat."""
        shaft, model = self._shaft, self._model
        model.R.value = self._cool_ohm * (1.0 + COPPER_PER_K * (shaft.winding_c - IDENTIFIED_C))
        is_on = drive.current_limit_a > 0.0 and drive.duty != 0.0
        lowest, highest = (self._duty_at(sign * drive.current_limit_a, supply_v) for sign in (-1.0, 1.0))
        duty = min(max(drive.duty, lowest), highest) if is_on else 0.0
        self._pull_n = tension_n
        self._simulator.q, self._simulator.dq = shaft.angle_rad, shaft.velocity_rad_s
        shaft.current_a = (duty * supply_v - model.kt.value * shaft.velocity_rad_s) / model.R.value if is_on else 0.0
        self._simulator.step(duty * supply_v, is_on, dt_s)
        shaft.angle_rad, shaft.velocity_rad_s = float(self._simulator.q), float(self._simulator.dq)
        shaft.duty, shaft.supply_v = duty, supply_v

    def _duty_at(self, supply_a: float, supply_v: float) -> float:
        """Return the duty cycle at which so much comes from the supply: bam's XL330CurrentActuator.compute_torque."""
        emf_v = self._model.kt.value * self._shaft.velocity_rad_s
        root_v = (emf_v**2 + 4.0 * supply_v * self._model.R.value * abs(supply_a)) ** 0.5
        return max(-1.0, min(1.0, (emf_v + (root_v if supply_a > 0.0 else -root_v)) / (2.0 * supply_v)))


def main() -> None:
    """Print what was found."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("bam", help="folder of bam's source")
    arguments.add_argument("model", choices=("m1", "m2", "m3", "m4", "m5", "m6"), help="of its friction")
    arguments.add_argument("--cell", action="store_true", help="move the emulated cell with three of them")
    options = arguments.parse_args()
    sys.path.insert(0, options.bam)
    from bam.model import load_model  # noqa: PLC0415  where it is, is known now
    from bam.simulate import Simulator  # noqa: PLC0415

    def identified(shaft: Any, spool_radius_m: float) -> IdentifiedMotor:
        simulator = Simulator(load_model(motor_name="xl330", model=options.model))
        return IdentifiedMotor(simulator, shaft, spool_radius_m)

    def exchange(cell: Any) -> None:
        cell.plant.motors = [identified(one.shaft, one.spool_radius_m) for one in cell.plant.motors]

    if options.cell:
        row = servo_facts.Row(f"motor and gears as Rhoban/bam identified ({options.model}), driver as now")
        print(f"| {row.fact} | {' | '.join(servo_facts.measured(row, exchange))} |")
        return
    stand = x330_tension.WeightStand(x330_tension.MODEL, 1)
    stand.motor = identified(stand.servo.shaft, x330_tension.RADIUS_M)
    points = x330_tension.tension_points([stand])
    error_n = x330_tension.rms([point.error for point in points])
    print(f"xl330/{options.model}: {error_n:.2f} N in {len(points)} lifts; {x330_tension.summary(points)}")


if __name__ == "__main__":
    main()
