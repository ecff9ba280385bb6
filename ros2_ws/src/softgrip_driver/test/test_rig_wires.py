# SPDX-License-Identifier: Apache-2.0
"""The guided measurement over the wires of stage and gauge, byte by byte."""

import pytest

from softgrip_driver.errors import PortLostError
from softgrip_driver.rig.build import StreamSettings, make_gauge, make_stage
from softgrip_driver.rig.journal import PlanJournal, Request
from softgrip_driver.rig.procedure import Procedure, RigSettings
from softgrip_emulator.rig import EmulatedRig
from softgrip_testing.virtual_rig import RigHands

NINE = Request("9", cable="PE braid", surface="TPU")


@pytest.fixture
def wired(tmp_path, world):
    """Make a rig behind ports, with its procedure."""
    rigs = []

    def make(stage="mark10", gauge="gcl2", **settings):
        rig = EmulatedRig(seed=5, clock=world.clock, stage=stage, gauge=gauge).open_ports(tmp_path, world.port)
        rigs.append(rig)
        devices = (
            make_stage(stage, str(tmp_path / "stand")),
            make_gauge("gcl2" if gauge == "gcl2" else "stream", str(tmp_path / "gauge"), StreamSettings(line=gauge)),
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
