# SPDX-License-Identifier: Apache-2.0
"""/diagnostics of tendon_driver: the bus as one component, each tendon as another."""

from __future__ import annotations

from softgrip_driver.faults import FAULTS, Reaction
from softgrip_driver.tendon.backend import Counters
from softgrip_driver.tendon.loop import LoopSnapshot
from softgrip_driver.tendon.status import DriveSnapshot
from softgrip_nodekit import Diagnostics, Health

#: share of the nominal rate below which the bus is unwell
SLOW = 0.9


def report_health(diagnostics: Diagnostics, snapshot: LoopSnapshot, counters: Counters, nominal_rate: float) -> None:
    """Set the health of the bus and of every tendon."""
    values = {
        "rate [Hz]": f"{snapshot.rate:.1f}",
        "jitter p99 [ms]": f"{snapshot.jitter_p99 * 1e3:.2f}",
        "missed cycles": snapshot.missed_cycles,
        "transactions": counters.transactions,
        "lost replies": counters.lost,
        "damaged replies": counters.corrupt,
        "refusals": counters.refused,
        "port reopened": counters.reopened,
    }
    if snapshot.port_lost:
        diagnostics.set("bus", Health.ERROR, snapshot.port_lost, values)
    elif 0.0 < snapshot.rate < SLOW * nominal_rate:
        text = f"{snapshot.rate:.0f} of {nominal_rate:.0f} Hz; run `ros2 run softgrip_driver selftest` for the cause"
        diagnostics.set("bus", Health.WARN, text, values)
    else:
        diagnostics.set("bus", Health.OK, "running", values)
    for drive in snapshot.drives:
        diagnostics.set(drive.tendon, *_tendon_health(drive), _tendon_values(drive))


def _tendon_health(drive: DriveSnapshot) -> tuple[Health, str]:
    if drive.fault:
        level = Health.WARN if FAULTS[drive.fault].reaction is Reaction.REPORT else Health.ERROR
        return level, f"{drive.fault}: {drive.fault_reason}"
    if drive.warnings:
        return Health.WARN, "; ".join(drive.warnings)
    return Health.OK, drive.state.name.lower() + ("" if drive.homed else ", not homed")


def _tendon_values(drive: DriveSnapshot) -> dict[str, object]:
    return {
        "pulled length [mm]": f"{drive.length * 1e3:.2f}",
        "tension [N]": f"{drive.tension:.2f} +- {drive.tension_stddev:.2f}",
        "current [A]": f"{drive.current:.3f}",
        "temperature [degC]": f"{drive.temperature:.0f}",
        "voltage [V]": f"{drive.voltage:.1f}",
        "lost replies": drive.lost_replies,
        "hardware error": f"0x{drive.hardware_error:02x}",
    }
