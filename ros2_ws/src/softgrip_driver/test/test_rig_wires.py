# SPDX-License-Identifier: Apache-2.0
"""The guided measurement over the wires of stage and gauge, byte by byte."""

import pytest

from softgrip_driver.errors import PortLostError
from softgrip_driver.rig.build import StreamSettings, make_gauge, make_stage
from softgrip_driver.rig.journal import PlanJournal, Request
from softgrip_driver.rig.procedure import PlanFailedError, Procedure, RigSettings
from softgrip_emulator.rig import EmulatedRig
from softgrip_model.friction.laws import GRAVITY
from softgrip_testing.virtual_rig import RigHands

NINE = Request("9", cable="PE braid", surface="TPU")


@pytest.fixture
def wired(tmp_path, world):
    """Make a rig behind ports, with its procedure."""
    rigs = []

    def make(stage="mark10", gauge="gcl2", stream=None, **settings):
        rig = EmulatedRig(seed=5, clock=world.clock, stage=stage, gauge=gauge).open_ports(tmp_path, world.port)
        rigs.append(rig)
        stream = stream or StreamSettings(line=gauge)
        devices = (
            make_stage(stage, str(tmp_path / "stand")),
            make_gauge("gcl2" if gauge == "gcl2" else "stream", str(tmp_path / "gauge"), stream),
        )
        for device in devices:
            device.open()
        hands = RigHands(rig)
        return hands, Procedure(*devices, hands, world.rig_time(), RigSettings(**settings), tmp_path / "plans")

    yield make
    for rig in rigs:
        rig.close()


@pytest.fixture
def until_stands(world):
    def wait(rig):
        deadline = world.now() + 100.0
        while rig.plant.velocity:
            assert world.now() < deadline, "the stage still moves"
            world.breathe()
            rig.plant.advance(rig.clock.now_s())

    return wait


@pytest.mark.parametrize(("stage", "gauge"), [("mark10", "gcl2"), ("grbl", "grams"), ("grbl", "scale")])
def test_it_goes_as_well_over_wires(wired, until_stands, stage, gauge):
    hands, procedure = wired(stage, gauge)
    outcome = procedure.run(NINE)
    assert outcome.calibration.model.points == 9
    assert len(hands.accepted()) == 9
    until_stands(hands.rig)


@pytest.mark.parametrize(
    ("waits_s", "text"), [(0.0, "expected a line"), (20.0, "the load cell is cut")], ids=["still boots", "has booted"]
)
def test_a_board_that_boots_in_a_pull_and_tares_itself_spoils_no_point(wired, world, waits_s, text):
    stream = StreamSettings(line="hx711_adc", counts_per_newton=1e3 / GRAVITY)
    hands, procedure = wired("grbl", "olkal_read", stream)
    hands.rig.gauge._rate_hz = 80.0

    def boot(_):
        if hands.samples == 1300:
            hands.rig.inject("board_reset")

    def wait(step):
        if step.instruction.startswith("Again"):
            world.clock.advance(world.now() + waits_s)

    hands.on_sample, hands.before = boot, wait
    with pytest.raises(PlanFailedError, match=text):
        procedure.run(NINE)
    before = len(hands.accepted())
    assert 0 < before < 9
    world.clock.advance(world.now() + 20.0)  # in which a person reads what it says
    outcome = procedure.run(NINE, resume=True)
    assert len(hands.accepted()) == 9
    assert outcome.calibration.model.points == 9
    truth = hands.rig.truth.friction
    for point in outcome.points:
        ratio = point.tension_high / point.tension_low
        assert ratio == pytest.approx(float(truth.ratio(point.angle, point.tension_low)), rel=0.06)


@pytest.mark.parametrize("port", ["stand", "gauge"])
def test_an_unplugged_device_ends_the_plan(wired, until_stands, tmp_path, port):
    hands, procedure = wired()

    def unplug(_):
        if hands.samples == 40:
            hands.rig.inject("unplugged", port=port)

    hands.on_sample = unplug
    with pytest.raises(PortLostError, match="plug it in") as caught:
        procedure.run(NINE)
    assert not hands.accepted()
    until_stands(hands.rig)
    assert hands.rig.plant.travel < 12.01e-3
    if port == "stand":
        assert "runs to its own limit" in caught.value.__notes__[0]
    (path,) = (tmp_path / "plans").glob("*.jsonl")
    assert PlanJournal.read(path).points == {}
