# SPDX-License-Identifier: Apache-2.0
"""Tension of an XL330 from what it measures: the current of its supply, its duty cycle, its voltage.

An emulated servo (ratings of the data sheet, copper that warms, gears with friction) is calibrated by
`calibrate_tension` with six weights, cool, at 5 V and its own speeds. Then it lifts and lets down 0.5 to 25 N at three
speeds and five supply voltages, with a winding that is cool or 45 K warmer (and its sensor 20 K): the driver's estimate
beside the weight. The peer takes Present Current for the winding's, calibrated from the same weights.

Homing: emulated fingers, data sheet values only, a servo that limits its supply's current and one that limits its
winding's; the zero beside the length at which the tendon of the plant becomes taut.
"""

from __future__ import annotations

import contextlib
import io
import math
import statistics
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from _weight_stand import RADIUS_M, WeightStand

from softgrip_driver.commands.calibrate_tension import (
    WEIGHT_PACES,
    TorqueCalibration,
    Weight,
    calibrate,
    measure,
)
from softgrip_driver.commands.tension_recording import TensionSample
from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration
from softgrip_driver.dynamixel.registers import MODELS, CurrentSensing
from softgrip_driver.tendon.backend import Setpoint
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.units import Spool, TorqueModel, fit_torque_model
from softgrip_testing.benchmark_claim import claim, no_options
from softgrip_testing.virtual_cell import SLOTS, VirtualCell

MODEL = "XL330-M288"
MASSES_KG = (0.1, 0.3, 0.6, 1.0, 1.6, 2.4)
TENSIONS_N = (0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0)
SPEEDS_M_S = (0.003, 0.01, 0.03)
SUPPLIES_V = (3.7, 4.4, 5.0, 5.5, 6.0)
#: winding and sensor [degC]
WARMTHS_C = {"cool": (24.0, 24.0), "warm": (69.0, 44.0)}
COPIES = (1, 2, 3)
HOMED_CELLS = (1, 2, 3)
#: [s] of a steady lift that is looked at, after [s] and [m] of getting up to speed: position control lifts a weight
#: once its goal is some millimetres away
SEEN_S, RUN_UP_S, RUN_UP_M = 0.2, 0.3, 0.004
#: share by which the speed of a steady lift may be off
STEADY = 0.2


@dataclass(frozen=True)
class Point:
    """One steady lift: the weight, and what was estimated of it [N]."""

    true: float
    estimated: float
    stddev: float
    peer: float
    warmth: str
    speed: float
    supply_v: float

    @property
    def error(self) -> float:
        """What was estimated too much [N]."""
        return self.estimated - self.true


def servo_of(found: TorqueCalibration | None = None) -> ServoConfiguration:
    """Return the configuration of the servo, calibrated or by the data sheet."""
    model = MODELS[MODEL]
    torque = found.torque if found else TorqueModel(model.torque_per_ampere, model.no_load_current)
    return ServoConfiguration("t", 1, model, Spool(RADIUS_M, 1), torque, winding=found.winding if found else None)


def recorded(stand: WeightStand) -> list[TensionSample]:
    """Return what calibrate_tension sees of six weights, each with a cool motor."""
    backend = stand.backend(servo_of())
    samples: list[TensionSample] = []
    for mass in MASSES_KG:
        stand.warm(*WARMTHS_C["cool"])
        weight = Weight(mass)
        stand.pull_n = weight.tension()
        samples += measure(backend, weight, 2.0 * weight.tension() + 10.0, 0.02, 0.006, 4, WEIGHT_PACES)
    return samples


def lifts(stand: WeightStand, servo: ServoConfiguration, peer: TorqueModel) -> Iterator[Point]:
    """Yield every steady lift and descent that the supply is strong enough for."""
    backend = stand.backend(servo)
    for supply_v in SUPPLIES_V:
        stand.supply_v = supply_v
        for _ in range(20):
            backend.read()
        for warmth, temperatures in WARMTHS_C.items():
            for tension in TENSIONS_N:
                for speed in (sign * speed for speed in SPEEDS_M_S for sign in (1.0, -1.0)):
                    stand.pull_n = tension
                    backend.power("t", True)
                    stand.warm(*temperatures)
                    yield from lift(stand, backend, backend.read()["t"].position, speed, peer, warmth)
                    backend.power("t", False)


def lift(
    stand: WeightStand, backend: DynamixelBackend, start: float, speed: float, peer: TorqueModel, warmth: str
) -> Iterator[Point]:
    """Yield the mean of one steady motion; nothing where there is none, or the duty cycle has reached its end."""
    began = stand.now_s
    run_up_s = max(RUN_UP_S, RUN_UP_M / abs(speed))
    seen = []
    while stand.now_s - began < run_up_s + SEEN_S:
        backend.write({"t": Setpoint(start + speed * (stand.now_s - began), 45.0)})
        reading = backend.read()["t"]
        motor = backend.motor("t")
        if stand.now_s - began > run_up_s:
            seen.append((reading, peer.pull(motor.current, reading.velocity, RADIUS_M)[0], abs(motor.duty)))
    goes = statistics.fmean(reading.velocity for reading, *_ in seen)
    if abs(goes - speed) < STEADY * abs(speed) and max(duty for *_, duty in seen) < 0.95:
        pulls = [reading.pull for reading, *_ in seen]
        stddevs = [reading.tension_stddev for reading, *_ in seen]
        peer_pull = statistics.fmean(pull for _, pull, _ in seen)
        yield Point(stand.pull_n, statistics.fmean(pulls), statistics.fmean(stddevs), peer_pull, warmth, abs(speed),
                    stand.supply_v)  # fmt: skip


def rms(values: list[float]) -> float:
    """Return the root mean square."""
    return math.sqrt(statistics.fmean(value * value for value in values))


def tension_points(stands: Iterable[WeightStand]) -> list[Point]:
    """Return all lifts on some stands, each calibrated first."""
    points: list[Point] = []
    for stand in stands:
        with contextlib.redirect_stdout(io.StringIO()):
            samples = recorded(stand)
        found = calibrate(samples, MODELS[MODEL], RADIUS_M, "weights")
        currents, speeds, tensions = zip(*((s.current_a, s.speed_m_s, s.tension_n) for s in samples), strict=True)
        peer = fit_torque_model(currents, speeds, tensions, RADIUS_M, "weights")
        points += lifts(stand, servo_of(found), peer)
    return points


def row(points: list[Point]) -> str:
    """Return the error of some lifts beside the deviation that the driver states [N]."""
    return f"{rms([p.error for p in points]):.2f} ({statistics.fmean(p.stddev for p in points):.2f})"


def rows(points: list[Point]) -> Iterator[str]:
    """Yield errors with the stated deviation: of each tension with each winding, of each speed, of each supply."""
    for tension in TENSIONS_N:
        here = [p for p in points if p.true == tension]
        yield f"{tension:g} N: " + ", ".join(
            f"{row([p for p in here if p.warmth == kind])} {kind}" for kind in WARMTHS_C
        )
    for speed in SPEEDS_M_S:
        yield f"{1e3 * speed:g} mm/s: {row([p for p in points if p.speed == speed])}"
    for supply_v in SUPPLIES_V:
        yield f"{supply_v:g} V: {row([p for p in points if p.supply_v == supply_v])}"


def summary(points: list[Point]) -> str:
    """Return what is found, in words."""
    each = ", ".join(f"{kind} {row([p for p in points if p.warmth == kind])} N" for kind in WARMTHS_C)
    within = statistics.fmean(abs(p.error) <= 2.0 * p.stddev for p in points)
    return (
        f"root mean square (stated deviation); {each}; {100.0 * within:.1f} % within twice the stated deviation; "
        f"{'; '.join(rows(points))}"
    )


def claim_tension() -> None:
    """Print the claim of the lifts."""
    points = tension_points(WeightStand(MODEL, copy) for copy in COPIES)
    claim(
        "tension error", rms([p.error for p in points]), "N", better="lower", goal=0.5, runs=len(points),
        peer="Present Current taken for the winding's, calibrated with the same weights",
        peer_value=rms([p.peer - p.true for p in points]), note=summary(points),
    )  # fmt: skip


def homed(seed: int, limits: CurrentSensing) -> tuple[float, float]:
    """Home a cell; return the largest error of a zero [m], and the largest tension meanwhile [N]."""
    cell = VirtualCell(seed, "power", limits=limits)
    highest = 0.0
    ticket = cell.controller.home(cell.plant.now_s)
    while cell.controller.result(ticket)[0] is None:
        cell.observe()
        highest = max(highest, float(np.max(cell.plant.bank.tension_n)))
    taut = cell.plant.wound_m() - cell.plant.bank.slack_m
    zeros = [cell.controller.drives[slot].snapshot().pulled_length_m for slot in SLOTS]
    return max(abs(float(a) - b) for a, b in zip(taut, zeros, strict=True)), highest


def claim_homing() -> None:
    """Print the claim of the homings."""
    found = {
        kind: [homed(seed, kind) for seed in HOMED_CELLS] for kind in (CurrentSensing.SUPPLY, CurrentSensing.WINDING)
    }
    errors = [1e3 * error for pairs in found.values() for error, _ in pairs]
    pulls = {kind.value: max(highest for _, highest in pairs) for kind, pairs in found.items()}
    claim(
        "homing error", max(errors), "mm", better="lower", goal=0.5, runs=len(errors) * len(SLOTS),
        note=f"largest of all zeros; highest tension at a homing tension of {TendonLimits().homing_tension:g} N: "
        f"{', '.join(f'{pull:.1f} N where it limits {kind} current' for kind, pull in pulls.items())}",
    )  # fmt: skip


def main() -> None:
    """Print the claims."""
    no_options(__doc__)
    claim_tension()
    claim_homing()


if __name__ == "__main__":
    main()
