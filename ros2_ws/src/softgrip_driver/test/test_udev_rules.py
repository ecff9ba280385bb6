# SPDX-License-Identifier: Apache-2.0
"""The rules for a bench's ports: what they do to adapters, names that stay, and that udev itself takes them."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from softgrip_driver.commands import name_ports
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.nodes.rig_parameters import PARAMETERS
from softgrip_driver.port_names import naming_rules, usb_identity
from softgrip_testing.udev_rules import UdevDevice, apply_rules, read_rules

RULES = Path(__file__).parents[1] / "udev" / "60-softgrip.rules"
#: vendor and product of the adapters in the maker's e-manual (U2D2: FT232H) and those of FTDI's FT232R
U2D2, FT232R = ("0403", "6014"), ("0403", "6001")


def tty(usb: tuple[str, str], serial: str = "", socket: str = "1-2", interface: str = "00") -> UdevDevice:
    """Return the serial port of a USB adapter, as udev sees it."""
    adapter = UdevDevice("usb", socket, attributes={"idVendor": usb[0], "idProduct": usb[1], "serial": serial})
    port = UdevDevice("usb", f"{socket}:1.0", attributes={"bInterfaceNumber": interface})
    return UdevDevice("tty", "ttyUSB0", environment={"ID_USB_INTERFACE_NUM": interface}, parents=(port, adapter))


@pytest.fixture
def shipped() -> list:
    return read_rules(RULES.read_text(encoding="utf-8"))


def test_the_port_of_a_u2d2_belongs_to_dialout_and_nobody_else_talks_to_it(shipped: list) -> None:
    port = tty(U2D2)
    apply_rules(shipped, port)
    assert port.node == {"MODE": "0660", "GROUP": "dialout"}
    assert "uaccess" in port.tags
    assert port.environment["ID_MM_DEVICE_IGNORE"] == "1"
    assert port.environment["BRLTTY_BRAILLE_DRIVER"] == ""


@pytest.mark.parametrize("action", ["add", "change"])
def test_an_ftdi_adapter_hands_over_after_a_millisecond(shipped: list, action: str) -> None:
    adapter = UdevDevice("usb-serial", "ttyUSB0", "ftdi_sio", action, {"latency_timer": "16"})
    apply_rules(shipped, adapter)
    assert adapter.attributes["latency_timer"] == "1"
    other = UdevDevice("usb-serial", "ttyUSB0", "ch341-uart", action)
    apply_rules(shipped, other)
    assert other.attributes == {}


@pytest.mark.parametrize("device", [tty(("046d", "c52b")), UdevDevice("block", "sda")])
def test_what_is_no_port_of_a_bench_is_left_alone(shipped: list, device: UdevDevice) -> None:
    apply_rules(shipped, device)
    assert (device.node, device.tags, device.symlinks) == ({}, [], [])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('SUBSYSTEM="tty", MODE="0660"', "SUBSYSTEM: expected one of"),
        ('ATTTR{x}=="1"', "expected a key of udev"),
        ('ATTR=="1"', "expected a key of udev"),
        ('MODE="rw-rw----"', "octal"),
        ('MODE=="0660"', "MODE: expected one of"),
        ('SUBSYSTEM=="tty" MODE="0660"', "expected KEY"),
        ('SUBSYSTEM=="tty", ', "behind the last comma"),
        ("SUBSYSTEM==tty", "expected KEY"),
        ('LABEL="end"\nGOTO="end"', "further down"),
    ],
)
def test_the_reader_refuses_what_udev_refuses(text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        read_rules(text)


# --- names -----------------------------------------------------------------------------------------------------------


def plug_in(root: Path, number: int, usb: tuple[str, str], serial: str | None, socket: str) -> str:
    """Make what the kernel shows in sysfs of a USB serial port; return its device."""
    device = root / "devices" / socket
    port = device / f"{socket}:1.0" / f"ttyUSB{number}"
    (port / "tty" / f"ttyUSB{number}").mkdir(parents=True)
    (device / "idVendor").write_text(usb[0] + "\n")
    (device / "idProduct").write_text(usb[1] + "\n")
    if serial is not None:
        (device / "serial").write_text(serial + "\n")
    (port.parent / "bInterfaceNumber").write_text("00\n")
    link = root / "class" / f"ttyUSB{number}"
    link.mkdir(parents=True)
    (link / "device").symlink_to(port)
    return f"/dev/ttyUSB{number}"


def test_a_name_follows_the_serial_number_into_another_socket(tmp_path: Path) -> None:
    ports = {
        "servos": plug_in(tmp_path, 0, U2D2, "FT4THWE5", "1-2"),
        "stand": plug_in(tmp_path, 1, FT232R, "A5069RR4", "1-3.1"),
    }
    rules = read_rules(naming_rules(ports, tmp_path / "class"))
    moved = tty(FT232R, "A5069RR4", "3-1")
    apply_rules(rules, moved)
    assert moved.symlinks == ["softgrip/stand"]
    another = tty(FT232R, "A5069RR5", "1-3.1")
    apply_rules(rules, another)
    assert another.symlinks == []


@pytest.mark.parametrize("serial", [None, "", 'a"b', "FT*"])
def test_an_adapter_without_a_usable_serial_number_is_known_by_its_socket(tmp_path: Path, serial: str | None) -> None:
    port = plug_in(tmp_path, 0, ("1a86", "7523"), serial, "1-4")
    text = naming_rules({"gauge": port}, tmp_path / "class")
    assert "named by its socket" in text
    here, there = tty(("1a86", "7523"), socket="1-4"), tty(("1a86", "7523"), socket="1-5")
    for device in (here, there):
        apply_rules(read_rules(text), device)
    assert (here.symlinks, there.symlinks) == (["softgrip/gauge"], [])


def test_what_can_not_be_named_is_refused(tmp_path: Path) -> None:
    port = plug_in(tmp_path, 0, U2D2, "FT4THWE5", "1-2")
    with pytest.raises(ConfigurationError, match="expected a name of small letters"):
        naming_rules({'a", RUN+="x': port}, tmp_path / "class")
    with pytest.raises(ConfigurationError, match="expected another adapter than that of 'servos'"):
        naming_rules({"servos": port, "stand": port}, tmp_path / "class")
    with pytest.raises(ConfigurationError, match="expected the serial port of a USB adapter"):
        usb_identity("/dev/ttyS0", tmp_path / "class")


def test_the_defaults_of_the_rig_are_names_that_the_command_makes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stand, gauge = plug_in(tmp_path, 0, FT232R, "A1", "1-2"), plug_in(tmp_path, 1, ("2341", "0043"), "75", "1-3")
    monkeypatch.setattr(name_ports, "naming_rules", lambda ports: naming_rules(ports, tmp_path / "class"))
    file = tmp_path / "names.rules"
    assert name_ports.main([f"stand={stand}", f"gauge={gauge}", "--out", str(file)]) == 0
    assert "make udev" in capsys.readouterr().out
    made = []
    for device in (tty(FT232R, "A1"), tty(("2341", "0043"), "75")):
        apply_rules(read_rules(file.read_text(encoding="utf-8")), device)
        made += [f"/dev/{one}" for one in device.symlinks]
    defaults = {one.name: one.default for one in PARAMETERS.rows}
    assert made == [defaults["stage_port"], defaults["gauge_port"]]


# --- udev's own reader -----------------------------------------------------------------------------------------------


def complaints_of_udev(folder: Path) -> list[str]:
    """Return what udev says of the rules files of a folder, or skip where no udev here can be asked.

    `udevadm verify` came with systemd 254. Before, `udevadm test` reads every rules file; it does so here in a mount
    namespace of its own, where the folder stands for /etc/udev/rules.d and nothing that it does to devices lasts.
    """
    if shutil.which("udevadm") is None:
        pytest.skip("udev is not installed here")
    done = subprocess.run(["udevadm", "verify", str(folder)], capture_output=True, text=True, check=False)
    if "Unknown command" not in done.stderr:
        return [line for line in done.stderr.splitlines() if str(folder) in line] if done.returncode else []
    place = Path("/etc/udev/rules.d")
    script = (
        f"mount --bind {folder} {place} && mount -t tmpfs none /run/udev && udevadm test /sys/class/mem/null 2>&1"
        if place.is_dir() and Path("/run/udev").is_dir()
        else "exit 9"
    )
    if os.geteuid() != 0 or shutil.which("unshare") is None:
        pytest.skip("udevadm verify came with systemd 254; for udevadm test one must be root")
    done = subprocess.run(["unshare", "-m", "sh", "-c", script], capture_output=True, text=True, check=False)
    if str(place) not in done.stdout:
        pytest.skip(f"udevadm verify came with systemd 254; udevadm test cannot be tried here: {done.stderr.strip()}")
    return [line for line in done.stdout.splitlines() if str(place) in line and "Reading rules file" not in line]


def test_udev_itself_takes_the_rules(tmp_path: Path) -> None:
    rules = tmp_path / "rules.d"
    rules.mkdir()
    shutil.copy(RULES, rules)
    port = plug_in(tmp_path, 0, U2D2, "FT4THWE5", "1-2")
    (rules / name_ports.FILE).write_text(naming_rules({"servos": port}, tmp_path / "class"), encoding="utf-8")
    assert complaints_of_udev(rules) == []
    (rules / "62-wrong.rules").write_text('SUBSYSTEM="tty", ATTTR{x}=="1"\n', encoding="utf-8")
    assert complaints_of_udev(rules), "udev was not asked"
