# SPDX-License-Identifier: Apache-2.0
"""The driver's loop behind a USB adapter that keeps bytes back: FTDI latency timers of 1 to 16 ms, 3 to 9 servos.

Emulated servos and fingers behind an emulated adapter, 1 Mbaud, in virtual time: the driver's own code waits for its
replies, and every byte and time limit is that of the real thing (softgrip_driver/test/worlds.py), so that the figures
are the same on any machine. The adapter refuses the request for low latency, which is the worst case. The loop wants
100 Hz; home, and a closing of 15 mm at 50 mm/s, have to succeed. The peer is a group read alone, one each latency: what
a driver could reach that did nothing but read. With `--drive` the servos are Feetech STS or Damiao motors, whose loop
wants 200 Hz, and which close at 20 mm/s.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from softgrip_driver.errors import DriverError
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.scripts import load_script

SERVOS = range(3, 10)
LATENCIES_S = (0.001, 0.002, 0.004, 0.008, 0.016)
#: model, rate of its loop [Hz], speed of a closing [m/s]
DRIVES = {
    "dynamixel": ("XL330-M288", 100.0, 0.05),
    "feetech": ("STS3215", 200.0, 0.02),
    "damiao": ("DM-J4310-2EC", 200.0, 0.02),
}
SECONDS = 2.0
BENCHES = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_driver/test/conftest.py"


def load_benches() -> ModuleType:
    """Return the benches of the driver's tests: emulated servos on a wire, with the driver's loop at its other end."""
    return load_script(BENCHES)


def driven(benches: Any, drive: str, servos: int, latency_s: float) -> tuple[float, str]:
    """Run the driver as it starts; return its rate [Hz] (0 where it does not work) and what there is to say of it."""
    tendons = (*benches.TENDONS, *(f"spare{i}" for i in range(servos - len(benches.TENDONS))))
    said: list[str] = []
    model, rate_hz, speed_m_s = DRIVES[drive]
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        world = benches.worlds.OwnWorld(patch)
        bench = benches.Bench(
            Path(folder), world, model=model, rate=rate_hz, latency=latency_s, tendons=tendons, report=said.append
        )
        try:
            bench.open()
            bench.loop.power(on=True)
            periods = [b.time - a.time for a, b in pairwise(bench.pass_time(SECONDS))]
            ends = [bench.run(bench.loop.call(lambda c, now: c.home(now, benches.TENDONS)), 30.0)]
            ends.append(bench.run(bench.move([0.015], speed_m_s, tendons=benches.TENDONS)))
        except DriverError as error:
            return 0.0, f"does not start: {error}"
        finally:
            bench.close()
    rate = 1.0 / statistics.fmean(periods)
    worst = max(abs(period - statistics.median(periods)) for period in periods)
    failed = [reason for outcome, reason in ends if outcome is not MoveOutcome.REACHED]
    named = any("keeps bytes back" in text for text in said)
    lost = bench.backend.counters.lost
    return (
        rate,
        f"{rate:.0f} Hz +-{worst * 1e3:.0f} ms{f', {lost} lost' * bool(lost)}{' named' * named}{''.join(failed)}",
    )


def main() -> None:
    """Print the claim."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drive", choices=DRIVES, default="dynamixel", help="make of the servos, default %(default)s")
    drive = parser.parse_args().drive
    benches = load_benches()
    found = {(servos, late): driven(benches, drive, servos, late) for late in LATENCIES_S for servos in SERVOS}
    rows = [
        f"{late * 1e3:.0f} ms: {', '.join(f'{servos} {found[servos, late][1]}' for servos in SERVOS)}"
        for late in LATENCIES_S
    ]
    slowest = max(LATENCIES_S)
    claim(
        "cycle rate at 16 ms", found[min(SERVOS), slowest][0], "Hz", better="higher", goal=30.0, runs=len(found),
        peer="a group read alone, one each latency", peer_value=1.0 / slowest,
        note="three servos; latency: servos, rate +- longest deviation of a period, whether the adapter was named as "
        f"the cause; {'; '.join(rows)}",
    )  # fmt: skip


if __name__ == "__main__":
    main()
