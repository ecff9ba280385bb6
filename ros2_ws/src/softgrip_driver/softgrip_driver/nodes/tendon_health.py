# SPDX-License-Identifier: Apache-2.0
"""/diagnostics of tendon_driver: the bus as one component, each tendon as another."""

from __future__ import annotations

from dataclasses import replace

from softgrip_driver.faults import FAULTS, Reaction
from softgrip_driver.tendon.backend import Counters
from softgrip_driver.tendon.loop import LoopSnapshot
from softgrip_driver.tendon.status import DriveSnapshot
from softgrip_nodekit import Diagnostics, Health

#: share of the nominal rate below which the bus is unwell
SLOW = 0.9
#: share of lost or damaged replies since the last look above which it is unwell, too
BAD = 0.01


class HealthReport:
    """Tells /diagnostics about the bus and every tendon.

    Args:
        diagnostics: of the node.
    """

    def __init__(self, diagnostics: Diagnostics) -> None:
        self._diagnostics = diagnostics
        self._before = Counters()

    def report_health(self, snapshot: LoopSnapshot, counters: Counters) -> None:
        """Set the health of all."""
        self._diagnostics.set("bus", *self._bus_health(snapshot, counters), _bus_values(snapshot, counters))
        for drive in snapshot.drives:
            self._diagnostics.set(drive.tendon, *_tendon_health(drive), _tendon_values(drive))

    def _bus_health(self, snapshot: LoopSnapshot, counters: Counters) -> tuple[Health, str]:
        asked = counters.transactions - self._before.transactions
        bad = counters.lost + counters.corrupt - self._before.lost - self._before.corrupt
        self._before = replace(counters)
        if snapshot.port_lost:
            return Health.ERROR, snapshot.port_lost
        advice = "run `ros2 run softgrip_driver selftest` for the cause"
        if 0.0 < snapshot.rate < SLOW * snapshot.asked_rate:
            return Health.WARN, f"{snapshot.rate:.0f} of {snapshot.asked_rate:.0f} Hz; {advice}"
        if bad > BAD * asked:
            return Health.WARN, f"{bad} of {asked} replies lost or damaged; {advice}"
        return Health.OK, "at rest" if snapshot.is_resting else "running"


def _bus_values(snapshot: LoopSnapshot, counters: Counters) -> dict[str, object]:
    return {
        "rate [Hz]": f"{snapshot.rate:.1f}",
        "jitter p99 [ms]": f"{snapshot.jitter_p99 * 1e3:.2f}",
        "missed cycles": snapshot.missed_cycles,
        "transactions": counters.transactions,
        "lost replies": counters.lost,
        "damaged replies": counters.corrupt,
        "refusals": counters.refused,
        "port reopened": counters.reopened,
    }


def _tendon_health(drive: DriveSnapshot) -> tuple[Health, str]:
    if drive.fault:
        level = Health.WARN if FAULTS[drive.fault].reaction is Reaction.REPORT else Health.ERROR
        return level, f"{drive.fault}: {drive.fault_reason}"
    if drive.warnings:
        return Health.WARN, "; ".join(drive.warnings)
    return Health.OK, drive.state.name.lower() + ("" if drive.homed else ", not homed")


def _tendon_values(drive: DriveSnapshot) -> dict[str, object]:
    return {
        "pulled length [mm]": f"{drive.pulled_length_m * 1e3:.2f}",
        "zero [mm]": f"{drive.zero * 1e3:.3f}",
        "tension [N]": f"{drive.tension:.2f} +- {drive.tension_stddev:.2f}",
        "current [A]": f"{drive.current:.3f}",
        "temperature [degC]": f"{drive.temperature:.0f}",
        "voltage [V]": f"{drive.voltage:.1f}",
        "lost replies": drive.lost_replies,
        "hardware error": f"0x{drive.hardware_error:02x}",
    }
