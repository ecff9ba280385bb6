# SPDX-License-Identifier: Apache-2.0
"""Every fault that the emulator can cause on bus, tendon, stand, stage, gauge and amplifier, over their wires.

One row a fault: what the driver must name, in which state it must be, how soon it must be safe, how it recovers. Safe
means: no drive is commanded to move on. The rows run in the emulation's own time; `make faults` runs them in real time
on pseudo-terminals and prints the times measured beside the aim. The camera's rows are in tests/faults.
"""

from dataclasses import dataclass, replace

import pytest

from softgrip_driver.dynamixel.registers import CurrentSensing
from softgrip_driver.errors import DriverError
from softgrip_driver.tendon.gripper import MoveMode, MoveRequest
from softgrip_driver.tendon.motions import DriveState, MoveOutcome

TABLES = {
    "bus": "servos: 200 Hz, 3 servos at 1 Mbaud",
    "stand": "test stand with GCL2 gauge: 20 Hz",
    "start": "before anything moves",
    "grbl": "GRBL stage with streaming amplifier (raw counts, 80 a second): 10 Hz",
    "board": "GRBL stage with an HX711 board that tares itself when it boots (80 a second): 10 Hz",
}
STAGE_DEVICES = {"stand": ("mark10", "gcl2"), "grbl": ("grbl", "raw")}
#: rows of the board alone: what its amplifier does is in the rows of "grbl"
BOARD = ("grbl", "olkal_read")
BUSY = {DriveState.MOVING, DriveState.HOMING}


@dataclass(frozen=True)
class Row:
    """A row of the matrix.

    Attributes:
        cause: the emulator's name; arguments: of it.
        fault: what the driver calls it; "" = it must ride through.
        on: "closing" from 1 N, "winding in" from 4 N, "holding" 8 N, or "opening" from there.
        reason: words its message must contain.
        opens_others: the other fingers must release.
        recovery: "self", "command", "reset", "home" (reset, then homing).
        lasts: [s] until the cause ends; 0 = when the fault has been seen.
        safe_within: [s] from the cause to the safe state; None = the cause is slow (heat), or nothing happens.
        device: of TABLES.
    """

    cause: str
    fault: str
    on: str = "closing"
    arguments: tuple = ()
    reason: str = ""
    opens_others: bool = False
    recovery: str = "self"
    lasts: float = 0.0
    safe_within: float | None = 0.1
    device: str = "bus"

    @property
    def label(self):
        return self.cause + "".join(f" {key}={value}" for key, value in self.arguments if key != "slot")

    @property
    def name(self):
        return f"{self.device}: {self.label} while {self.on}"


INDEX = ("slot", "index")
ROWS = [
    Row("bytes_lost", "", arguments=(("share", 0.002),), lasts=0.6, safe_within=None),
    # Fewer: a length that was flipped upwards makes the servos wait for bytes that are of other packets.
    Row("bytes_flipped", "", arguments=(("share", 0.0005),), lasts=0.6, safe_within=None),
    Row("bytes_duplicated", "", arguments=(("share", 0.002),), lasts=0.6, safe_within=None),
    Row("bytes_delayed", "no_reply", arguments=(("delay_s", 0.1),), reason="does not answer"),
    Row("crc_error", "no_reply", reason="does not answer"),
    Row("bus_dead", "no_reply", reason="check its cable and power"),
    Row("bus_unplugged", "port_lost", reason="plug the adapter in again"),
    Row("servo_silent", "no_reply", arguments=(INDEX,), reason="nothing heard for"),
    Row("wrong_baud", "no_reply", arguments=(INDEX,), reason="nothing heard for"),
    Row("servo_unplugged", "no_reply", arguments=(INDEX,), reason="nothing heard for", recovery="home"),
    Row("alert", "electrical_shock", on="holding", arguments=(INDEX,), reason="0x10", recovery="home"),
    Row("alert", "input_voltage", on="holding", arguments=(INDEX, ("bits", 1)), reason="supply", recovery="home"),
    Row("overload", "overload", on="holding", arguments=(INDEX,), reason="lower the tension limit", recovery="home"),
    Row("overheating", "overheated", on="holding", arguments=(INDEX,), reason="cool down", recovery="home"),
    Row(
        "overheating", "over_temperature", on="holding", arguments=(INDEX, ("temperature_c", 66.0)), reason="66 degC",
        safe_within=1.0,
    ),
    Row(
        "heating", "over_temperature", on="holding", arguments=(INDEX, ("power_w", 300.0)), reason="degC",
        safe_within=None,
    ),
    Row("brown_out", "no_reply", on="holding", reason="check its cable and power", recovery="home"),
    Row("silent_reboot", "rebooted", arguments=(INDEX,), reason="check the supply", recovery="home"),
    Row("position_glitch", "", arguments=(INDEX,), lasts=0.004, safe_within=None),
    Row("position_glitch", "position_jump", on="holding", arguments=(INDEX,), reason="jumped", recovery="home"),
    Row(
        "tendon_break", "tendon_broken", on="holding", arguments=(INDEX,), reason="replace the tendon",
        opens_others=True, recovery="home",
    ),
    Row("slack", "tendon_slack", arguments=(INDEX, ("length_m", 0.02)), reason="retension", recovery="command",
        safe_within=1.5),
    Row("spool_jammed", "stalled", on="opening", arguments=(INDEX,), reason="look for a jam", recovery="command",
        safe_within=1.0),
]  # fmt: skip


STAGE_PORT, GAUGE_PORT = ("port", "stand"), ("port", "gauge")
#: [s] a cycle of the loop; two of them, and a reply that does not come
SLOW_CYCLE, SLOW = 0.1, 0.3
BOTH_STAGES = [
    Row("stand_silent", "no_reply", reason="nothing heard for", safe_within=SLOW),
    Row("stand_reply_cut", "no_reply", reason="nothing heard for", safe_within=SLOW),
    # The setpoint first gets 3 mm ahead at 3 mm/s, then nothing moves for a second. Lag, its anchor and its end are
    # each seen up to a cycle late, in a reading that is up to a cycle old.
    Row("stage_jammed", "stalled", reason="look for a jam", recovery="command", safe_within=2.0 + 4 * SLOW_CYCLE),
    Row("unplugged", "port_lost", arguments=(STAGE_PORT,), reason="plug", recovery="home", safe_within=SLOW),
    Row("gauge_silent", "gauge_lost", reason="check power", safe_within=2 * SLOW),
    Row("gauge_reply_cut", "gauge_lost", reason="expected a", safe_within=2 * SLOW),
    Row("cell_stuck", "gauge_lost", reason="it is stuck", safe_within=None),
    Row("saturated", "tension_exceeded", reason="the end of its range", recovery="reset", safe_within=SLOW),
    Row("unplugged", "port_lost", arguments=(GAUGE_PORT,), reason="plug", recovery="home", safe_within=SLOW),
    Row("tendon_break", "tendon_broken", on="holding", reason="replace the tendon", recovery="home", safe_within=0.5),
    # A cut cell and a broken tendon read the same, so both are named; a stage stops at the first reading of nothing.
    Row(
        "tendon_break", "tendon_broken", on="winding in", reason="replace the tendon", recovery="home", safe_within=0.5
    ),
    Row("cell_cut", "tendon_broken", on="winding in", reason="the load cell's cable", recovery="home", safe_within=0.5),
    Row("cell_cut", "tendon_broken", on="holding", reason="the load cell's cable", recovery="home", safe_within=0.5),
    # The more is wound in, the less it reads: 2 N below nothing come after some millimetres.
    Row("cell_reversed", "gauge_negative", reason="less than nothing", recovery="reset", safe_within=None),
    # 9 mm are wound in at 3 mm/s.
    Row("slack", "tendon_slack", reason="retension", recovery="command", safe_within=3.2),
]
ROWS += [replace(row, device=device) for device in STAGE_DEVICES for row in BOTH_STAGES] + [
    Row("auto_return", "stage_refused", device="stand", reason="PC control is off", recovery="command",
        safe_within=SLOW),
    Row("illegal_command", "gauge_lost", device="stand", reason="illegal command", safe_within=2 * SLOW),
    Row("unit_switched", "", device="stand", lasts=0.6, safe_within=None),
    Row("contaminated_stream", "", device="stand", lasts=0.6, safe_within=None),
    Row("contaminated_stream", "gauge_lost", device="grbl", reason="expected a line like", safe_within=2 * SLOW),
    Row("alarm", "stage_alarm", device="grbl", reason="home it again", recovery="home", safe_within=SLOW),
] + [
    Row("board_reset", "gauge_restarted", device="board", arguments=(("boot", boot),), on=on, reason="restarted",
        recovery="home", safe_within=SLOW)
    for boot in (0.5, 1.6, 3.0) for on in ("closing", "holding")
]  # fmt: skip
# What each device says of a force beyond its range is its own.
ROWS = [replace(row, reason="beyond its capacity") if (row.cause, row.device) == ("saturated", "stand") else row
        for row in ROWS]  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def matrix(request):
    """Hand the tables to the terminal summary."""
    request.config.fault_tables = {title: [] for title in TABLES.values()}
    return request.config.fault_tables


@pytest.fixture
def bench(row, benches, tmp_path, world):
    """What a row happens to."""
    servos, stage = benches
    devices = STAGE_DEVICES | {"board": BOARD}
    one = servos(tmp_path, world) if row.device == "bus" else stage(tmp_path, world, *devices[row.device])
    try:
        yield one.open()
    finally:
        one.close()


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_fault(bench, row, matrix):
    # Little enough that its loss is no broken tendon (3 N), as the gears' friction reads too much.
    bench.hold_taut({"closing": 1.0, "winding in": 4.0}.get(row.on, 8.0))
    ticket = None
    if row.on in {"closing", "winding in"}:
        on_bus = row.device == "bus"
        request = MoveRequest([], MoveMode.LENGTH, [0.030 if on_bus else 0.013], 0.008 if on_bus else 0.003, 20.0)
        ticket = bench.loop.call(lambda c, now: c.move(request, now))
        assert bench.until(lambda seen: all(drive.state is DriveState.MOVING for drive in seen.drives))
    else:
        since = bench.loop.snapshot.time
        assert bench.until(lambda seen: seen.time - since > 0.3)
    before = bench.loop.snapshot.sequence
    began = bench.cause(row.cause, **dict(row.arguments))
    if row.on == "opening":
        ticket = bench.loop.call(lambda c, now: c.move(MoveRequest([], MoveMode.LENGTH, [0.0], 0.015, 20.0), now))
    seen = named(bench, row, before, began, ticket) if row.fault else rode_through(bench, row, began)
    bench.clear()
    if row.cause in {"heating", "overheating"}:
        cool(bench)
    if row.cause == "board_reset":
        start_again_without_load(bench)
    recovered = recover(bench, row)
    aim = "-" if row.safe_within is None else f"{row.safe_within * 1e3:.0f} ms"
    matrix[TABLES[row.device]].append((row.label, row.on, row.fault or "rides through", seen, aim, recovered))


class Said(list):
    """What a person is told at start."""

    def note(self, matrix, cause, reason, seen="nothing moves", ends="by hand"):
        matrix[TABLES["start"]].append((cause, "start", reason, seen, "-", ends))
        assert any(reason in text for text in self), self


def test_two_servos_with_one_id(benches, tmp_path, world, matrix):
    bench, said = benches[0](tmp_path, world), Said()
    for servo in bench.plant.servos[:2]:
        servo.registers.put("id", 1)
    bench.plant.servos[0].shaft.angle_rad += 1.0
    try:
        bench.open()
    except DriverError as error:
        said.append(str(error))
    bench.close()
    said.note(matrix, "duplicate_id", "several servos with ID 1")
    assert all(servo.shaft.duty == 0.0 for servo in bench.plant.servos)


def test_an_adapter_that_keeps_bytes_back(benches, tmp_path, world, matrix):
    said = Said()
    bench = benches[0](tmp_path, world, latency=0.016, report=said.append)
    try:
        bench.open()
        bench.loop.power(on=True)
        outcome, reason = bench.run(bench.loop.call(lambda c, now: c.home(now)), 30.0)
        assert outcome is MoveOutcome.REACHED, reason
        seen = bench.pass_time(2.0)
    finally:
        bench.close()
    rate = len(seen) / (seen[-1].time - seen[0].time)
    assert rate > 25.0  # feeds a bus watchdog of 80 ms twice
    said.note(matrix, "latency 16 ms", "the USB adapter keeps bytes back", f"homes, at {rate:.0f} Hz", "-")


@pytest.mark.parametrize("limits", [CurrentSensing.SUPPLY, CurrentSensing.WINDING])
def test_a_limit_on_either_side_of_the_supply_homes_gently(benches, tmp_path, world, matrix, limits):
    bench = benches[0](tmp_path, world, limits_current=limits).open()
    try:
        bench.loop.power(on=True)
        ticket = bench.loop.call(lambda c, now: c.home(now))
        pulled = 0.0
        while bench.result(ticket)[0] is None:
            bench.pass_time(0.05)
            pulled = max(pulled, float(bench.plant.bank.tension_n.max()))
        assert bench.result(ticket)[0] is MoveOutcome.REACHED, bench.result(ticket)
    finally:
        bench.close()
    matrix[TABLES["start"]].append(
        (f"limit of the {limits.value}", "homing", "-", f"pulls {pulled:.1f} N", "4 N", "by itself")
    )
    assert pulled < 4.0


@pytest.mark.parametrize("settings", [{13: 1.0}, {10: 0.0, 13: 1.0}], ids=["inches", "inches, work position"])
def test_a_stage_that_reports_inches_pulls_millimetres(benches, tmp_path, world, matrix, settings):
    bench, said = benches[1](tmp_path, world, "grbl", "raw", stage_settings=settings), Said()
    try:
        bench.open()
        said.extend(text for identity in bench.identities for text in identity.warnings)
        bench.hold_taut(1.0)
        before, said_before = bench.plant.travel, bench.drive("pull").pulled_length_m
        outcome, reason = bench.run(bench.move([said_before + 0.004], 0.003))
        assert outcome is MoveOutcome.REACHED, reason
        bench.pass_time(1.0)
        went = bench.plant.travel - before
        assert went == pytest.approx(0.004, abs=3e-4)
        assert bench.drive("pull").pulled_length_m - said_before == pytest.approx(went, abs=5e-5)
        assert bench.drive("pull").tension == pytest.approx(bench.plant.force, rel=0.02, abs=0.05)
    finally:
        bench.close()
    cause = " ".join(f"${number}={value:g}" for number, value in settings.items())
    said.note(matrix, cause, "inches; they are converted", "goes as asked", "-")


@pytest.mark.parametrize(("cause", "fault"), [("cell_cut", "gauge_unproven"), ("cell_reversed", "gauge_reversed")])
def test_a_cell_that_does_not_feel_the_tendon(benches, tmp_path, world, matrix, cause, fault):
    bench = benches[1](tmp_path, world, "grbl", "raw", 2.0)
    bench.rig.inject(cause)
    try:
        bench.open()
        bench.loop.power(on=True)
        for force in (0.0, 5.0, 0.0):
            bench.plant.pull_by_hand(force)
            bench.pass_time(1.0)
        assert bench.until(lambda seen: seen.drives[0].fault == fault, 3.0), bench.drive("pull")
        ticket = bench.loop.call(lambda c, now: c.home(now))
        bench.pass_time(3.0)
        assert bench.result(ticket)[0] is not MoveOutcome.REACHED
        assert bench.plant.force == 0.0
    finally:
        bench.close()
    matrix[TABLES["start"]].append((cause, "start", fault, "nothing is wound in", "-", "by hand"))


def named(bench, row, before, began, ticket):
    """The fault is named in time with its reason; nothing moves on. Returns the time to safe in words.

    ``before`` is the number of a cycle before the cause.
    """
    snapshot = bench.until(lambda now: any(d.fault == row.fault for d in now.drives), 5.0)
    states = [(d.tendon, d.state.name, d.fault) for d in bench.loop.snapshot.drives]
    assert snapshot is not None, f"{row.fault} was not named; {states}"
    drive = next(d for d in snapshot.drives if d.fault == row.fault)
    assert row.reason in drive.fault_reason
    # Safe may come before the final name: a servo that reboots is silent first.
    safe = next(
        seen.time for seen in bench.loop.since(before, 0.0)
        if any(d.fault for d in seen.drives) and all(d.state not in BUSY for d in seen.drives)
    )  # fmt: skip
    # A cycle's time is that of its beginning, which may be just before the cause.
    after = max(0.0, safe - began)
    assert row.safe_within is None or after <= row.safe_within
    if ticket is not None:
        assert bench.result(ticket)[0] is MoveOutcome.FAULT
    if row.opens_others:
        assert bench.until(
            lambda now: all(d.state is DriveState.RELEASING for d in now.drives if d.tendon != drive.tendon)
        )
    return f"{drive.state.name.lower()} after {after * 1e3:.0f} ms"


def rode_through(bench, row, began):
    while bench.now() - began < row.lasts:
        bench.loop.since(bench.loop.snapshot.sequence, 0.1)
    bench.clear()
    faults = [drive.fault_reason for drive in bench.loop.snapshot.drives if drive.fault]
    assert not faults
    return "-"


def recover(bench, row):
    """It recovers the way the table of faults says, and moves again."""
    ended = bench.loop.snapshot.sequence
    assert bench.until(lambda now: now.sequence > ended + 3), "what a cycle has seen before the end is told in the next"
    if row.recovery in {"reset", "home"}:
        assert bench.until(lambda now: all(d.state is not DriveState.DISCONNECTED for d in now.drives), 6.0)
        bench.loop.reset(power=True)
    assert bench.until(
        lambda now: (
            all(not d.fault or row.recovery == "command" for d in now.drives)
            and all(d.state in {DriveState.HOLDING, DriveState.RELEASING} or d.fault for d in now.drives)
        ),
        8.0,
    ), [(d.tendon, d.state.name, d.fault, d.fault_reason) for d in bench.loop.snapshot.drives]
    if row.recovery == "home":
        unhomed = [d.tendon for d in bench.loop.snapshot.drives if not d.homed]
        assert unhomed, "a fault that voids the zero must demand homing"
        assert homed(bench, unhomed)
    ticket = bench.loop.call(lambda c, now: c.move(MoveRequest([], MoveMode.LENGTH, [0.004], 0.015, 20.0), now))
    outcome, reason = bench.run(ticket)
    assert outcome is MoveOutcome.REACHED, reason
    return {"self": "by itself", "command": "next command", "home": "reset, home"}.get(row.recovery, row.recovery)


def homed(bench, tendons):
    """Home as a person would: once more where a busy machine has spoilt it."""
    for _ in range(3):
        outcome, reason = bench.run(bench.loop.call(lambda c, now: c.home(now, tendons)), 25.0)
        if outcome is MoveOutcome.REACHED:
            return True
    return pytest.fail(reason)


def start_again_without_load(bench):
    """Do what the fault asks for: nothing on the cell, the board's button, the tendon back on the cell."""
    bench.plant.loosen(0.02)
    bench.pass_time(6.0)
    bench.cause("board_reset")
    bench.pass_time(6.0)
    bench.plant.loosen(-0.02)


def cool(bench):
    with bench.plant.lock:
        for servo in bench.plant.servos:
            servo.shaft.temperature_c = 30.0
