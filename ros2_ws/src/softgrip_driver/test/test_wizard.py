# SPDX-License-Identifier: Apache-2.0
"""The wizard on servos as they come: the whole way, what a beginner does wrong, and going on where it was left."""

from __future__ import annotations

import os
import pty
import re
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from softgrip_description.cell_file import load_cell, node_parameters, read_shipped
from softgrip_driver.commands import wizard as command
from softgrip_driver.commands.person import TerminalPerson, WrittenAnswers, read_answers
from softgrip_driver.configuration import checked_configuration
from softgrip_driver.errors import ConfigurationError, DeviceNotFoundError, DriverError, PortLostError, WrongDeviceError
from softgrip_driver.feetech.registers import MODELS as FEETECH
from softgrip_driver.wizard import drive_setup
from softgrip_driver.wizard.direction import SpoolPull, find_direction
from softgrip_driver.wizard.sections import FoundDevices
from softgrip_driver.wizard.tensioning import TensioningPlan
from softgrip_driver.wizard.wizard import SetupWizard, WizardSettings
from softgrip_emulator.dynamixel.servo import FACTORY_BAUD, FACTORY_ID
from softgrip_emulator.plant.cell import CellPlant, ServoPlace, Supply
from softgrip_emulator.servos import load_ratings, make_chain
from softgrip_emulator.wire.usb_adapter import UsbAdapter
from softgrip_model.profile import load_directory

PROFILES = Path(__file__).parents[2] / "softgrip_bringup" / "profiles"
CONFIG = PROFILES.parent / "config"
TENDONS = ("index", "middle", "thumb")


class Hands:
    """A person who does what the wizard asks, at an emulated bench; `mistakes` are done in its stead, by key."""

    def __init__(self, plant, mistakes=None):
        self.plant, self.mistakes, self.asked, self.lines = plant, mistakes or {}, [], []
        self.questions = []

    def print_line(self, text):
        self.lines.append(text)

    def ask(self, key, text, default=""):
        self.questions.append(key)
        assert default, f"{key}: {text}"
        return default

    def confirm(self, key, text):
        self.asked.append(key)
        self.print_line(text)
        if key in self.mistakes:
            self.mistakes.pop(key)(self)
        elif key.startswith("connect."):
            self.connect(key.removeprefix("connect."))

    def try_again(self, key, problem):
        self.print_line(f"! {key}: {problem}")
        return False

    def connect(self, *tendons, connected=True):
        for tendon in tendons:
            self.plant.servos[self.plant.index(tendon)].is_connected = connected

    @property
    def text(self):
        return "\n".join(self.lines)


class FreshBench:
    """Servos in their boxes, a cable, a port."""

    def __init__(
        self, folder, world, *, model="XL330-M288", directions=(1, -1, 1), latency_s=None, supply_v=None, **place
    ):
        self.world, self.folder = world, folder
        self.drive = "feetech" if model in FEETECH else "dynamixel"
        # both as they come: e-manual, items 7 and 8; Feetech's memory table, ID (5) and baud rate (6)
        place = {"device_id": FACTORY_ID, "baud": 1_000_000 if model in FEETECH else FACTORY_BAUD} | place
        chain = [
            ServoPlace(name, model=model, spool_direction=direction, **place)
            for name, direction in zip(TENDONS, directions, strict=True)
        ]
        supply = Supply(supply_v or load_ratings(model).nominal_voltage_v)
        self.plant = CellPlant(load_directory(PROFILES), seed=3, chain=chain, supply=supply)
        self.plant.mount(TENDONS, list("abc"), ["power"] * 3)
        self.plant.now_s = world.clock.now_s()
        for servo in self.plant.servos:
            servo.is_connected = False
        bus = make_chain(self.plant.servos, self.plant.lock, self.plant.advance_to)
        self.port = world.port(folder / "servos", bus if latency_s is None else UsbAdapter(bus, latency_s))
        world.live(self.plant.advance_to)
        self.file = folder / "cell.yaml"

    def wizard(self, hands, **changes):
        settings = WizardSettings(self.file, str(self.folder / "servos"), self.drive, tendons=TENDONS, selftest_s=0.5)
        make_loop = lambda backend, controller, rate: self.world.loop(backend, controller, rate, 4096)  # noqa: E731
        return SetupWizard(replace(settings, **changes), hands, make_loop, lambda _: FoundDevices())

    def powered(self):
        return [servo.registers.get("torque_enable") for servo in self.plant.servos]


@pytest.fixture
def fresh(tmp_path, world):
    made = []

    def make(**options):
        made.append(FreshBench(tmp_path, world, **options))
        return made[-1]

    yield make
    for bench in made:
        bench.port.close()
    world.close()


def leave(_):
    """Ctrl-C."""
    raise KeyboardInterrupt


def slack_m(plant):
    """[m] that each spool winds until its tendon is taut, from where it stands: the plant's truth."""
    return plant.taken_slack_m() - plant.wound_m()


def test_from_the_boxes_to_a_chain_that_is_ready(fresh):
    bench = fresh()
    hands = Hands(bench.plant)
    assert bench.wizard(hands).run(), hands.text
    assert [servo.device_id for servo in bench.plant.servos] == [1, 2, 3]
    assert [servo.baud for servo in bench.plant.servos] == [1_000_000] * 3
    cell = load_cell(bench.file)
    assert [(one.tendon, one.model, one.servo_id, one.direction) for one in cell.servos.chain] == [
        ("index", "XL330-M288", 1, 1), ("middle", "XL330-M288", 2, -1), ("thumb", "XL330-M288", 3, 1),
    ]  # fmt: skip
    # What is stated is what is so: homing finds the taut tendon within a millimetre (docs/driver.md).
    for servo, true_m in zip(cell.servos.chain, slack_m(bench.plant), strict=True):
        assert servo.slack_m == pytest.approx(true_m, abs=1e-3)
        assert servo.slack_m == pytest.approx(0.005, abs=1e-3)
    assert bench.powered() == [0, 0, 0]
    assert "self-test: 3 servos" in hands.text
    assert hands.questions == ["cell", "hand", "out", "profiles", "camera", "stage"]
    assert cell.folders.out == bench.folder / "out"
    shipped = read_shipped(CONFIG)
    checked_configuration(shipped["tendon_driver"] | node_parameters(cell, shipped)["tendon_driver"])


def test_it_goes_on_where_it_was_left(fresh):
    bench = fresh()
    hands = Hands(bench.plant, {"tie.middle": leave})
    with pytest.raises(KeyboardInterrupt):
        bench.wizard(hands).run()
    assert bench.powered() == [0, 0, 0]
    assert [one.direction for one in load_cell(bench.file).servos.chain] == [1, None, None]
    again = Hands(bench.plant)
    assert bench.wizard(again, port="", tendons=()).run()
    assert again.asked == ["tie.middle", "tie.thumb", "straight"]
    once_more = Hands(bench.plant)
    assert bench.wizard(once_more).run()
    assert once_more.asked == []
    assert once_more.questions == ["camera", "stage"]  # what the bench has not got


@pytest.mark.long
def test_feetech_servos_are_led_the_same_way(fresh):
    bench = fresh(model="STS3215")
    hands = Hands(bench.plant)
    assert bench.wizard(hands).run(), hands.text
    cell = load_cell(bench.file)
    assert cell.servos.drive == "feetech"
    assert [(one.tendon, one.model, one.servo_id, one.direction) for one in cell.servos.chain] == [
        ("index", "STS3215", 2, 1), ("middle", "STS3215", 3, -1), ("thumb", "STS3215", 4, 1),
    ]  # fmt: skip
    for servo, true_m in zip(cell.servos.chain, slack_m(bench.plant), strict=True):
        # its gears hide some 6 N, by which a finger closes before it is felt
        assert servo.slack_m == pytest.approx(true_m, abs=3e-3)
        assert servo.slack_m == pytest.approx(0.005, abs=1e-3)
    assert bench.powered() == [0, 0, 0]
    # none has 1, with which the next new one comes at the same rate
    assert "ID is now 2, EPROM locked" in hands.text
    assert "self-test: 3 servos" in hands.text
    shipped = read_shipped(CONFIG)
    checked_configuration(shipped["tendon_driver"] | node_parameters(cell, shipped)["tendon_driver"])
    # for good: the EPROM was open while it was written, and is not any more
    for servo in bench.plant.servos:
        assert servo.registers.get("lock") == 1
        servo.lose_power(0.0)
    assert [servo.device_id for servo in bench.plant.servos] == [2, 3, 4]


def both(hands):
    hands.connect("index", "middle")


def nobody(_):
    """The supply is off."""


def others(hands):
    hands.connect("index", "middle")
    hands.plant.servos[1].registers.put("id", 9)


@pytest.mark.parametrize(
    ("mistake", "error", "message"),
    [
        (both, ConfigurationError, r"found several with ID 1 at 1000000 baud; leave one on the cable"),
        (nobody, DeviceNotFoundError, r"new feetech servo, found none .*supply is on .* --drive .damiao, dynamixel"),
        (others, ConfigurationError, "found ID 1 at 1000000 baud, ID 9 at 1000000 baud; leave one of them"),
    ],
)
def test_what_a_beginner_connects_wrong_is_named_of_feetech_servos_too(fresh, mistake, error, message):
    bench = fresh(model="STS3215")
    for turned, servo in enumerate(bench.plant.servos):
        servo.shaft.angle_rad += turned
        servo.fold()
    with pytest.raises(error, match=message):
        bench.wizard(Hands(bench.plant, {"connect.index": mistake})).run()
    assert not bench.file.exists()


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (
            lambda bench: bench.plant.servos[1].registers.put_kept("baud_rate", 1),
            r"middle: .* ID 3 at 500000 baud; set",
        ),
        (lambda bench: Hands(bench.plant).connect(*TENDONS, connected=False), "index: .* nobody at any baud rate"),
        (
            lambda bench: Hands(bench.plant).connect("middle", connected=False),
            "middle: .* found ID 2, 4 instead; press in",
        ),
    ],
    ids=["baud", "supply", "plug"],
)
def test_what_goes_wrong_with_a_feetech_chain_is_named(fresh, mistake, message):
    bench = fresh(model="STS3215")
    named_chain(bench)
    mistake(bench)
    with pytest.raises(DeviceNotFoundError, match=message):
        bench.wizard(Hands(bench.plant)).run()


def test_an_enter_before_the_question_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, terminal = pty.openpty()
    with os.fdopen(terminal, encoding="utf-8") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        os.write(keyboard, b"\n\n")
        asked = threading.Thread(target=TerminalPerson().confirm, args=("free", "Keep your hands away"))
        asked.start()
        asked.join(0.5)
        assert asked.is_alive()
        os.write(keyboard, b"\n")
        asked.join(10.0)
        assert not asked.is_alive()
    os.close(keyboard)


def test_a_feetech_adapter_with_its_16_ms_and_a_reversed_spool_are_named(fresh):
    bench = fresh(model="STS3215", latency_s=0.016)
    hands = Hands(bench.plant, {"straight": leave})
    with pytest.raises(KeyboardInterrupt):
        bench.wizard(hands).run()
    assert re.search(r"adapter keeps bytes back: expected replies within 3 ms, found 1\d ms; .*make udev", hands.text)
    bench.file.write_text(bench.file.read_text().replace("direction: -1", "direction: 1"))
    with pytest.raises(ConfigurationError, match="middle: expected a spool that pulls in direction 1, found -1"):
        bench.wizard(Hands(bench.plant)).run()


def test_a_feetech_supply_of_the_wrong_voltage_is_named(fresh):
    bench = fresh(model="STS3215", supply_v=12.0)
    with pytest.raises(WrongDeviceError, match=r"expected a supply of 4 to 7.4 V for a STS3215, found 12.0 V"):
        bench.wizard(Hands(bench.plant)).run()


def test_a_chain_has_servos_of_one_make(fresh):
    bench = fresh()
    named_chain(bench)
    with pytest.raises(ConfigurationError, match=r"expected that of the chain in .*, dynamixel, found feetech"):
        bench.wizard(Hands(bench.plant), drive="feetech")


def test_damiao_motors_are_said_to_be_set_with_their_makers_tool(fresh):
    bench = fresh()
    with pytest.raises(
        ConfigurationError, match=r"Damiao motors: give each its CAN ID .1 to 15. with the maker's tool"
    ):
        bench.wizard(Hands(bench.plant), drive="damiao")
    with pytest.raises(
        ConfigurationError, match=r"drive: expected a backend .* found 'grbl'; write its chain .* by hand"
    ):
        bench.wizard(Hands(bench.plant), drive="grbl")


def test_a_package_may_bring_the_set_up_of_its_own_drives(monkeypatch):
    class Entry:
        name, value = "paper", "paper_drive:make_setup"

        def load(self):
            return lambda: "its set-up"

    monkeypatch.setattr(drive_setup, "entry_points", lambda group: [Entry()] * (group == "softgrip.drive_setups"))
    assert drive_setup.drive_setup("paper") == "its set-up"
    assert "paper" in drive_setup.setup_names()
    monkeypatch.setattr(Entry, "load", lambda _: 1 / 0)
    with pytest.raises(ConfigurationError, match="expected to load paper_drive:make_setup, found ZeroDivisionError"):
        drive_setup.drive_setup("paper")


@pytest.mark.parametrize(
    ("mistake", "error", "message"),
    [
        (both, ConfigurationError, r"expected one new servo, found several with ID 1 at 57600 baud; leave one"),
        (nobody, DeviceNotFoundError, "check that the servos' supply is on .a U2D2 feeds no servo.*LED"),
        (others, ConfigurationError, "expected one new servo, found ID 1 at 57600 baud, ID 9 at 57600 baud; leave one"),
    ],
)
def test_what_a_beginner_connects_wrong_is_named(fresh, mistake, error, message):
    bench = fresh()
    for turned, servo in enumerate(bench.plant.servos):
        servo.shaft.angle_rad += turned
    with pytest.raises(error, match=message):
        bench.wizard(Hands(bench.plant, {"connect.index": mistake})).run()
    assert not bench.file.exists()


def test_a_servo_of_another_bench_with_an_id_of_the_chain_is_named(fresh):
    bench = fresh()

    def used(hands):
        bench.plant.servos[1].registers.put("baud_rate", 3)
        hands.connect("middle")

    with pytest.raises(ConfigurationError, match="several with ID 1 at 1000000 baud, one of them in the chain"):
        bench.wizard(Hands(bench.plant, {"connect.middle": used})).run()


def named_chain(bench):
    """Let the wizard name the chain and end it before the first tendon is tied."""
    with pytest.raises(KeyboardInterrupt):
        bench.wizard(Hands(bench.plant, {"tie.index": leave})).run()


def test_a_servo_of_the_chain_at_another_baud_rate_is_named(fresh):
    bench = fresh()
    named_chain(bench)
    bench.plant.servos[1].registers.put("baud_rate", 1)
    with pytest.raises(DeviceNotFoundError, match=r"middle: .* ID 2 at 57600 baud .as new.; set each with .* setup"):
        bench.wizard(Hands(bench.plant)).run()


def test_a_chain_that_is_no_longer_fed_is_named(fresh):
    bench = fresh()
    named_chain(bench)
    Hands(bench.plant).connect(*TENDONS, connected=False)
    with pytest.raises(
        DeviceNotFoundError, match=r"index: .* found nobody at any baud rate; check that .* supply is on"
    ):
        bench.wizard(Hands(bench.plant)).run()


def test_a_tendon_that_was_wound_the_other_way_round_since_is_named_before_anything_is_paid_out(fresh):
    bench = fresh()
    with pytest.raises(KeyboardInterrupt):
        bench.wizard(Hands(bench.plant, {"straight": leave})).run()
    text = bench.file.read_text()
    assert text.count("direction: -1") == 1  # middle, as it is wound
    bench.file.write_text(text.replace("direction: -1", "direction: 1"))
    wound_m = bench.plant.wound_m().copy()
    with pytest.raises(
        ConfigurationError, match=r"middle: expected a spool that pulls in direction 1, found -1; .*again"
    ):
        bench.wizard(Hands(bench.plant)).run()
    assert bench.powered() == [0, 0, 0]
    assert bench.plant.wound_m() == pytest.approx(wound_m, abs=1e-3)


def test_a_servo_that_was_used_before_is_said_to_be_and_set_up(fresh):
    bench = fresh(device_id=77, baud=3_000_000)
    hands = Hands(bench.plant, {"tie.index": leave})
    with pytest.raises(KeyboardInterrupt):
        bench.wizard(hands).run()
    assert "expected ID 1 at 57600 baud, found ID 77 at 3000000" in hands.text
    assert [servo.device_id for servo in bench.plant.servos] == [1, 2, 3]


def test_a_supply_of_the_wrong_voltage_is_named(fresh):
    bench = fresh(supply_v=7.4)
    with pytest.raises(WrongDeviceError, match=r"expected a supply of 3.7 to 6 V for a XL330-M288, found 7.4 V"):
        bench.wizard(Hands(bench.plant)).run()


def test_an_adapter_with_its_16_ms_is_named(fresh):
    bench = fresh(latency_s=0.016)
    hands = Hands(bench.plant)
    assert not bench.wizard(hands).run()
    assert re.search(r"adapter keeps bytes back: expected replies within 3 ms, found 1\d ms; .*make udev", hands.text)
    assert "not good" in hands.text


def test_a_tendon_that_is_not_tied_is_named_and_nothing_pulls(fresh):
    bench = fresh()
    bench.plant.disturbances.broken_tendons.add("index")
    with pytest.raises(ConfigurationError, match="holds the spool within 20 mm of one direction, found none"):
        bench.wizard(Hands(bench.plant)).run()
    assert bench.powered() == [0, 0, 0]


def test_a_jammed_spool_is_named(fresh):
    bench = fresh()
    bench.plant.disturbances.jammed.add("index")
    with pytest.raises(ConfigurationError, match=r"free in one direction, found it held after .* is it jammed"):
        bench.wizard(Hands(bench.plant)).run()


def test_the_small_pull_is_small(fresh):
    bench = fresh()
    peak_n = [0.0]

    def watch(_):
        peak_n[0] = max(peak_n[0], float(bench.plant.bank.tension_n.max()))

    bench.world.live(watch)
    with pytest.raises(KeyboardInterrupt):
        bench.wizard(Hands(bench.plant, {"tie.middle": leave})).run()
    assert 0.5 < peak_n[0] < 3.5


@pytest.mark.parametrize(
    ("model", "homing_n", "mode"), [("XM430-W350", 5.0, None), ("XL430-W250", 3.0, 4), ("XC430-W240", 3.0, 4)]
)
def test_a_model_that_needs_other_limits_gets_them(fresh, model, homing_n, mode):
    bench = fresh(model=model)
    hands = Hands(bench.plant)
    assert bench.wizard(hands, tendons=("index",)).run(), hands.text
    cell = load_cell(bench.file)
    shipped = read_shipped(CONFIG)
    values = shipped["tendon_driver"] | node_parameters(cell, shipped)["tendon_driver"]
    assert cell.parameters["tendon_driver"]["homing_tension_n"] == homing_n
    assert cell.parameters["tendon_driver"].get("operating_mode") == mode
    checked_configuration(values)


def test_a_servo_whose_plug_came_off_is_named_by_the_plug_first(fresh):
    bench = fresh()
    named_chain(bench)
    Hands(bench.plant).connect("middle", connected=False)
    with pytest.raises(DeviceNotFoundError, match=r"middle: .* found ID 1, 3 instead; press in the plugs .* its `id`"):
        bench.wizard(Hands(bench.plant)).run()


def test_a_port_that_can_not_be_opened_is_named_before_anybody_is_asked_for_a_servo(fresh, tmp_path):
    bench = fresh()
    hands = Hands(bench.plant)
    with pytest.raises(PortLostError, match="expected a free serial port"):
        bench.wizard(hands, port=str(tmp_path / "none")).run()
    assert hands.asked == []
    assert "! port: " in hands.text


def test_the_command_over_its_options_says_what_is_missing(tmp_path, capsys):
    assert command.main(["--file", str(tmp_path / "cell.yaml"), "--yes", "--port", "/dev/none"]) == 1
    assert "give --port and --tendons" in capsys.readouterr().err
    (tmp_path / "cell.yaml").write_text("schema: 2\n")
    assert command.main(["--file", str(tmp_path / "cell.yaml"), "--yes"]) == 1
    assert "cell.yaml:1: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("ends", "direction"),
    [({1: 0.004, -1: None}, 1), ({1: None, -1: 0.004}, -1), ({1: 0.004, -1: 0.018}, 1), ({1: 0.015, -1: 0.003}, -1)],
)
def test_the_direction_is_that_in_which_the_tendon_holds_first(ends, direction):
    assert find_direction(ends.__getitem__, SpoolPull().reach_m) == direction


def test_answers_may_be_written_down(tmp_path, capsys):
    (tmp_path / "answers.yaml").write_text("port: /dev/x\ncount: 3\n")
    answers = WrittenAnswers(read_answers(tmp_path / "answers.yaml"), takes_defaults=False)
    assert (answers.ask("port", "Which port"), answers.ask("count", "How many")) == ("/dev/x", "3")
    with pytest.raises(ConfigurationError, match=r"expected one to 'other' \(Why\), found none; write `other: "):
        answers.ask("other", "Why", "default")
    assert WrittenAnswers({}, takes_defaults=True).ask("other", "Why", "default") == "default"
    (tmp_path / "answers.yaml").write_text("[1]\n")
    with pytest.raises(ConfigurationError, match="expected answers as `key: answer`, found list"):
        read_answers(tmp_path / "answers.yaml")
    capsys.readouterr()


def test_a_terminal_without_anybody_is_named(monkeypatch):
    def closed(_):
        raise EOFError

    monkeypatch.setattr("builtins.input", closed)
    with pytest.raises(ConfigurationError, match="give --answers FILE, or --yes"):
        TerminalPerson().confirm("connect.index", "Connect it")
    monkeypatch.setattr("builtins.input", lambda _: "no")
    assert not TerminalPerson().try_again("connect.index", "no answer")
    assert isinstance(TensioningPlan().tension_n, float)
    assert issubclass(DeviceNotFoundError, DriverError)
