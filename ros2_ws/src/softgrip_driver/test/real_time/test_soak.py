# SPDX-License-Identifier: Apache-2.0
"""Random faults for a long time: no leak, no thread left, no missed safe state. `make soak` runs it for ten minutes."""

import gc
import os
import random
import threading
import time
from itertools import pairwise

import pytest

from softgrip_driver.faults import FAULTS, Reaction
from softgrip_driver.tendon.gripper import MoveMode, MoveRequest
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveState

SECONDS = float(os.environ.get("SOFTGRIP_SOAK_SECONDS", "15"))
SEED = int(os.environ.get("SOFTGRIP_SOAK_SEED", "1"))
CAUSES = (
    "bytes_lost", "bytes_flipped", "bytes_duplicated", "bytes_delayed", "crc_error", "bus_dead", "bus_unplugged",
    "servo_silent", "wrong_baud", "silent_reboot", "brown_out", "position_glitch", "alert", "overload",
)  # fmt: skip
WITHOUT_SLOT = {name for name in CAUSES if name.startswith(("bytes", "crc", "bus", "brown"))}
MOVING = {DriveState.MOVING, DriveState.HOMING}
#: On a machine that others use too a reply, or a homing, takes as long as the machine lets it.
QUIET = os.environ.get("SOFTGRIP_QUIET_MACHINE") == "1"
LIMITS = TendonLimits(no_reply=0.05) if QUIET else TendonLimits(no_reply=0.3, homing_timeout=60.0)
#: [s] in which a person has brought everything back
RECOVERS_S = 30.0 if QUIET else 300.0
#: share of the run that warms up: caches, histories, the allocator's arenas
WARM_UP = 0.3
#: [bytes] that the process may grow by afterwards while nothing leaks, whatever the length of the run
GROWTH = 8_000_000
PAGE = os.sysconf("SC_PAGE_SIZE")


def open_files():
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208  Path.iterdir would open one more


def resident():
    """[bytes] of memory that the process takes."""
    gc.collect()
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123
        return int(file.read().split()[1]) * PAGE


def recovered(bench):
    """Bring every drive back the way a person would: reset, home what lost its zero."""
    deadline = time.monotonic() + RECOVERS_S
    while time.monotonic() < deadline:
        bench.until(lambda now: all(d.state is not DriveState.DISCONNECTED for d in now.drives), 5.0)
        bench.loop.reset(power=True)
        if bench.until(lambda now: all(d.state is DriveState.HOLDING and not d.fault for d in now.drives), 5.0):
            unhomed = [d.tendon for d in bench.loop.snapshot.drives if not d.homed]
            if not unhomed or bench.run(bench.loop.call(lambda c, now: c.home(now, unhomed)), 70.0)[0] == 0:  # noqa: B023
                return True
    return False


def unsafe(snapshots):
    """Every drive of every cycle that moves on with a fault of its own, or with a dead drive of its gripper."""
    found = []
    for before, now in pairwise(snapshots):
        stopped = {d.tendon for d in before.drives if d.fault and FAULTS[d.fault].reaction is not Reaction.REPORT}
        found += [(now.sequence, d.tendon, d.state.name, d.fault) for d in now.drives if stopped and d.state in MOVING]
    return found


@pytest.mark.slow
@pytest.mark.timeout(SECONDS + 2.0 * RECOVERS_S + 120)
@pytest.mark.parametrize("bench", [{"history": 2048, "limits": LIMITS}], indirect=True)
def test_soak(bench, request):
    rng = random.Random(SEED)
    bench.hold_taut(0.0)
    threads, files = threading.active_count(), open_files()
    began_at = time.monotonic()
    warm, seen, cycles = None, {}, 0
    while (elapsed := time.monotonic() - began_at) < SECONDS:
        if warm is None and elapsed > WARM_UP * SECONDS:
            warm = resident()
        target = rng.uniform(0.002, 0.012)
        bench.loop.call(lambda c, now: c.move(MoveRequest([], MoveMode.LENGTH, [target], 0.01, 20.0), now))  # noqa: B023
        fault = rng.choice(CAUSES)
        arguments = {} if fault in WITHOUT_SLOT else {"slot": rng.choice(["index", "middle", "thumb"])}
        first = bench.loop.snapshot.sequence
        began = bench.cause(fault, **arguments)
        lasts = rng.uniform(0.02, 1.0)
        bench.until(lambda now: now.time - began > lasts, 5.0)  # noqa: B023  used before the next turn
        during = bench.loop.since(first, 0.0)
        assert not unsafe(during), f"moves on although {fault} was noticed"
        bench.clear()
        seen[fault] = seen.get(fault, 0) + 1
        assert recovered(bench), [(d.tendon, d.state.name, d.fault_reason) for d in bench.loop.snapshot.drives]
        assert bench.loop.failure is None
        cycles = bench.loop.snapshot.sequence
    grown = resident() - warm
    assert sum(seen.values()) > SECONDS / 30.0
    assert threading.active_count() <= threads
    assert open_files() <= files + 1
    assert grown < GROWTH, f"{grown} bytes more after {seen}"
    bench.loop.stop()
    assert all(servo.registers.get("torque_enable") == 0 for servo in bench.plant.servos)
    request.config.soak_report = (
        f"{SECONDS:.0f} s, seed {SEED}, {cycles} cycles, {sum(seen.values())} faults {dict(sorted(seen.items()))}; "
        f"memory {grown / 1e6:+.1f} MB after the first {WARM_UP:.0%}, open files {open_files() - files:+d}, "
        f"threads {threading.active_count() - threads:+d}; no drive moved on with a fault"
    )
