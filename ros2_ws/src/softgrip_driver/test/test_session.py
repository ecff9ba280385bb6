# SPDX-License-Identifier: Apache-2.0
"""Zeros on disk and across restarts of driver and servo."""

from dataclasses import replace
from itertools import pairwise

import pytest

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.tendon.session import ZeroKeeper
from softgrip_driver.tendon.units import Spool
from softgrip_driver.tendon.zero_store import StoredZero, ZeroStore, next_mark

ZERO = StoredZero("XL330-M288/1200 id 1 fw 52", 0.01, 1, -0.0123, 3, "2026-01-01T00:00:00+00:00", 2)


def test_what_is_saved_is_loaded(tmp_path):
    store = ZeroStore(tmp_path / "deep" / "zeros.yaml")
    assert store.load() == {}
    store.save({"index": ZERO})
    assert store.load() == {"index": ZERO}
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["zeros.yaml"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text.replace("-0.0123", "-0.0423"),
        lambda text: text[: len(text) // 2],
        lambda text: text.replace("schema: 1", "schema: 2"),
        lambda _: "[]",
        lambda _: "\0",
        lambda text: text.replace("mark: 3", "marc: 3"),
    ],
)
def test_a_damaged_or_edited_file_is_refused_with_what_to_do(tmp_path, damage):
    path = tmp_path / "zeros.yaml"
    ZeroStore(path).save({"index": ZERO})
    path.write_text(damage(path.read_text()))
    with pytest.raises(ConfigurationError, match="home again"):
        ZeroStore(path).load()


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="writable"):
        ZeroStore(tmp_path / "file" / "zeros.yaml").save({})


def test_marks_are_never_zero_and_change_with_every_homing():
    marks = [next_mark(n) for n in range(40)]
    assert set(marks) == set(range(1, 16))
    assert all(a != b for a, b in pairwise(marks))


@pytest.mark.slow
@pytest.mark.parametrize("bench", [{"limits": TendonLimits(no_reply=0.3)}], indirect=True)
def test_a_zero_survives_the_driver_but_not_the_servo(bench, tmp_path):
    spools = {servo.tendon: servo.spool for servo in bench.servos}
    store = ZeroStore(tmp_path / "zeros.yaml")

    def keeper(**others):
        return ZeroKeeper(store, bench.identities, spools | others)

    first = keeper()
    assert not any(one.valid for one in first.recall(bench.loop))
    bench.loop.power(on=True)
    outcome, reason = bench.run(bench.loop.call(lambda c, now: c.home(now)), 25.0)
    assert outcome is MoveOutcome.REACHED, reason
    first.save_zeros(bench.loop, "2026-01-01T00:00:00+00:00")
    zero = bench.controller.drives["index"].zero

    # Homed against the truth: the slack of the emulated finger is taken up, as far as a motor's current can tell.
    taut = bench.plant.bank.slack_m - bench.plant.wound_m()
    position = bench.controller.drives["index"].position
    assert zero == pytest.approx(position + taut[0], abs=1e-3)

    # The driver starts again, the servos did not.
    # The marks are read back with the slow registers.
    marks = {name: stored.mark for name, stored in store.load().items()}
    drives = bench.controller.drives
    assert bench.until(lambda _: all(drives[name].session_mark == mark for name, mark in marks.items()), 5.0)
    recalled = keeper().recall(bench.loop)
    assert all(one.valid for one in recalled), [one.reason for one in recalled]
    assert bench.controller.drives["index"].zero == zero
    # Another servo, another spool, or a servo that restarted.
    others = [replace(identity, device="XL330-M288/1200 id 9 fw 52") for identity in bench.identities]
    foreign = ZeroKeeper(store, others, spools).recall(bench.loop)
    assert not any(one.valid for one in foreign)
    assert "found XL330-M288/1200 id 9" in foreign[0].reason
    assert not next(one for one in keeper(index=Spool(0.011, 1)).recall(bench.loop) if one.tendon == "index").valid
    bench.cause("silent_reboot", slot="middle")
    assert bench.until(lambda _: bench.drive("middle").fault == "rebooted", 5.0)
    recalled = {one.tendon: one for one in keeper().recall(bench.loop)}
    assert not recalled["middle"].valid
    assert "its turns are lost" in recalled["middle"].reason


def test_a_zero_that_a_fault_has_voided_is_not_recalled(bench, tmp_path):
    """The servo has not restarted, so its mark would still vouch for the zero: it is taken away with it."""
    bench.hold_taut(0.0)
    spools = {servo.tendon: servo.spool for servo in bench.servos}
    store = ZeroStore(tmp_path / "zeros.yaml")
    ZeroKeeper(store, bench.identities, spools).save_zeros(bench.loop, "2026-01-01T00:00:00+00:00")
    bench.pass_time(0.5)
    assert all(one.valid for one in ZeroKeeper(store, bench.identities, spools).recall(bench.loop))
    bench.cause("position_glitch", slot="index")
    assert bench.until(lambda _: bench.drive("index").fault == "position_jump")
    bench.clear()
    bench.pass_time(0.5)
    recalled = {one.tendon: one.valid for one in ZeroKeeper(store, bench.identities, spools).recall(bench.loop)}
    assert recalled == {"index": False, "middle": True, "thumb": True}
