# SPDX-License-Identifier: Apache-2.0
"""GRBL as people have it: switches, inches, work positions, boards that reset twice or not at all, grblHAL."""

from __future__ import annotations

import pytest

from softgrip_driver.commands.stage import home
from softgrip_driver.errors import CorruptReplyError, DeviceRefusedError
from softgrip_driver.rig.build import make_stage
from softgrip_driver.rig.grbl import StageStart
from softgrip_emulator.rig import EmulatedRig


@pytest.fixture
def make_stage_of(tmp_path, world):
    """Make a rig with a GRBL stage, and the driver's end of it, not open yet."""
    made = []

    def make(start: str = "refuse", **settings):
        rig = EmulatedRig(clock=world.clock, **{"stage": "grbl", **settings}).open_ports(tmp_path, world.port)
        stage = make_stage("grbl", str(tmp_path / "stand"), start=StageStart(start))
        made.extend([stage, rig])
        return rig, stage

    yield make
    for one in made:
        one.close()
    world.close()


def goes(rig, stage, world) -> None:
    """It goes 5 mm, as the plant and its own reports say."""
    stage.zero()
    before = rig.plant.travel
    stage.start(5e-3, 2e-3)
    deadline = world.now() + 20.0
    while abs(stage.travel() - 5e-3) > 2e-5:
        assert world.now() < deadline, stage.travel()
        world.breathe()
    assert rig.plant.travel - before == pytest.approx(5e-3, abs=3e-5)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"stage": "grblhal"},
        {"stage_resets": 3},
        {"stage_resets": 0},
        {"stage_resets": 0, "stage": "grblhal"},
        {"stage_settings": {13: 1.0}},
        {"stage_settings": {10: 0.0}},
        {"stage_settings": {10: 0.0, 13: 1.0}},
        {"stage_settings": {10: 511.0}, "stage": "grblhal"},
    ],
    ids=str,
)
def test_a_controller_is_opened_and_its_reports_are_understood(make_stage_of, world, settings) -> None:
    rig, stage = make_stage_of(**settings)
    rig.stand.offset_mm = 37.0
    identity = stage.open()
    assert identity.model.startswith("grblHAL 1.1" if "stage" in settings else "GRBL 1.1")
    goes(rig, stage, world)


def test_what_its_settings_mean_is_said(make_stage_of) -> None:
    _, stage = make_stage_of(stage_settings={13: 1.0, 22: 0.0, 100: 5.0})
    warnings = " ".join(stage.open().warnings)
    assert "inches" in warnings
    assert "$100=5" in warnings
    assert "$22=0" in warnings


def test_a_stage_with_switches_is_locked_and_says_what_to_set(make_stage_of) -> None:
    rig, stage = make_stage_of(stage_settings={22: 1.0})
    with pytest.raises(DeviceRefusedError, match="set stage_start to home"):
        stage.open()
    assert rig.plant.travel == 0.0


@pytest.mark.parametrize(
    ("kind", "homing", "start", "homings"),
    [("grbl", 1.0, "unlock", 0), ("grbl", 1.0, "home", 1), ("grblhal", 1.0, "unlock", 0), ("grblhal", 5.0, "home", 1)],
)
def test_a_lock_is_left_as_asked_each_time_that_it_is_opened(
    make_stage_of, world, kind, homing, start, homings
) -> None:
    rig, stage = make_stage_of(start, stage=kind, stage_settings={22: homing})
    for opened in (1, 2):
        stage.open()
        assert rig.stand.homings == opened * homings
        goes(rig, stage, world)
        stage.close()


@pytest.mark.parametrize("start", ["unlock", "home"])
def test_the_command_homes_a_stage_once_locked_or_not(make_stage_of, world, start) -> None:
    """One that was locked has been driven home as it was opened."""
    rig, stage = make_stage_of(start, stage_settings={22: 1.0})
    stage.open()
    home(stage)
    assert rig.stand.homings == 1
    assert stage.travel() == pytest.approx(0.0, abs=1e-6)
    goes(rig, stage, world)


def test_the_command_says_what_cannot_be_homed(make_stage_of, tmp_path) -> None:
    _, stage = make_stage_of("home")
    stage.open()
    with pytest.raises(DeviceRefusedError, match=r"\$22=1"):
        home(stage)
    with pytest.raises(DeviceRefusedError, match="expected --kind grbl"):
        home(make_stage("mark10", str(tmp_path / "stand")))


def test_homing_without_switches_is_refused_with_the_setting(make_stage_of) -> None:
    _, stage = make_stage_of()
    stage.open()
    with pytest.raises(DeviceRefusedError, match=r"\$22=1"):
        stage.home()


def test_a_controller_that_was_running_keeps_its_position(make_stage_of, world) -> None:
    """Without DTR opening the port resets nothing, and neither does the driver: the travel stays known."""
    rig, stage = make_stage_of(stage_resets=0)
    stage.open()
    goes(rig, stage, world)
    stage.close()
    stage.open()
    assert stage.travel() == pytest.approx(0.0, abs=1e-6)
    assert rig.plant.travel == pytest.approx(5e-3, abs=3e-5)


def test_settings_that_are_not_there_are_no_settings(make_stage_of) -> None:
    rig, stage = make_stage_of()
    rig.stand._settings = {20: 1.0, 22: 0.0}
    with pytest.raises(CorruptReplyError, match=r"\$10"):
        stage.open()


def test_a_limit_that_was_hit_is_left_by_a_reset(make_stage_of, world) -> None:
    """GRBL hears nothing else then; where its port does not reset it, nobody else does."""
    rig, stage = make_stage_of()
    stage.open()
    rig.stand.alarm = rig.stand.needs_reset = True
    stage.unlock()
    goes(rig, stage, world)


def test_what_another_process_left_moving_is_stopped_first(make_stage_of, world) -> None:
    rig, stage = make_stage_of(stage_resets=0)
    stage.open()
    stage.start(50e-3, 2e-3)
    stage._port.close()
    world.clock.advance(world.now() + 1.0)
    stage.open()
    assert rig.plant.velocity == 0.0
    goes(rig, stage, world)


def test_noise_in_its_line_buffer_spoils_no_command(make_stage_of, world) -> None:
    rig, stage = make_stage_of(stage_resets=0)
    rig.stand._buffer = b"x9"
    stage.open()
    goes(rig, stage, world)


def test_a_grblhal_that_wants_homing_is_not_unlocked(make_stage_of) -> None:
    _, stage = make_stage_of("unlock", stage="grblhal", stage_settings={22: 5.0})
    with pytest.raises(DeviceRefusedError, match="set stage_start to home"):
        stage.open()
