# SPDX-License-Identifier: Apache-2.0
"""Random faults for a long time: no leak, no thread left, no missed safe state. `make soak` runs it for ten minutes."""

import gc
import os
import random
import threading
import time
import tracemalloc

import pytest

from softgrip_driver.tendon.gripper import MoveMode, MoveRequest
from softgrip_driver.tendon.motions import DriveState

SECONDS = float(os.environ.get("SOFTGRIP_SOAK_SECONDS", "30"))
SEED = int(os.environ.get("SOFTGRIP_SOAK_SEED", "1"))
FAULTS = (
    "bytes_lost", "bytes_flipped", "bytes_duplicated", "bytes_delayed", "crc_error", "bus_dead", "bus_unplugged",
    "servo_silent", "wrong_baud", "silent_reboot", "brown_out", "position_glitch", "alert", "overload",
)  # fmt: skip
WITHOUT_SLOT = {name for name in FAULTS if name.startswith(("bytes", "crc", "bus", "brown"))}
MOVING = {DriveState.MOVING, DriveState.HOMING}
#: [bytes] that caches may grow by while nothing leaks: bounded histories, pytest's own records
GROWTH = 3_000_000


def open_files():
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208  Path.iterdir would open one more


def recovered(bench):
    """Bring every drive back the way a person would: reset, home what lost its zero."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        bench.until(lambda now: all(d.state is not DriveState.DISCONNECTED for d in now.drives), 5.0)
        bench.loop.reset(power=True)
        if bench.until(lambda now: all(d.state is DriveState.HOLDING and not d.fault for d in now.drives), 5.0):
            unhomed = [d.tendon for d in bench.loop.snapshot.drives if not d.homed]
            if not unhomed or bench.run(bench.loop.call(lambda c, now: c.home(now, unhomed)), 20.0)[0] == 0:  # noqa: B023
                return True
    return False


@pytest.mark.slow
@pytest.mark.timeout(SECONDS + 120)
@pytest.mark.parametrize("bench", [{"history": 256}], indirect=True)
def test_soak(bench):
    rng = random.Random(SEED)
    bench.hold_taut(0.0)
    threads, files = threading.active_count(), open_files()
    tracemalloc.start()
    gc.collect()
    memory = tracemalloc.get_traced_memory()[0]
    end, seen = time.monotonic() + SECONDS, []
    while time.monotonic() < end:
        bench.loop.call(lambda c, now: c.move(MoveRequest([], MoveMode.LENGTH, [rng.uniform(0.002, 0.012)], 0.01), now))
        fault = rng.choice(FAULTS)
        arguments = {} if fault in WITHOUT_SLOT else {"slot": rng.choice(["index", "middle", "thumb"])}
        began = bench.cause(fault, **arguments)
        lasts = rng.uniform(0.02, 1.0)
        bench.until(lambda now: now.time - began > lasts, 2.0)  # noqa: B023  used before the next turn
        faulty = [drive for drive in bench.loop.snapshot.drives if drive.fault]
        assert not [drive for drive in faulty if drive.state in MOVING], "a drive with a fault moves on"
        bench.clear()
        seen.append(fault)
        assert recovered(bench), [(d.tendon, d.state.name, d.fault_reason) for d in bench.loop.snapshot.drives]
        assert bench.loop.failure is None
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - memory
    tracemalloc.stop()
    assert len(seen) > SECONDS / 20.0
    assert threading.active_count() <= threads
    assert open_files() <= files + 1
    assert grown < GROWTH, f"{grown} bytes more after {len(seen)} faults"
    bench.loop.stop()
    assert all(servo.registers.get("torque_enable") == 0 for servo in bench.plant.servos)
