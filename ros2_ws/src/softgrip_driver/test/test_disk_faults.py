# SPDX-License-Identifier: Apache-2.0
"""A disk that takes no zeros changes nothing at the drives."""

import errno
import os

import pytest

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.session import ZeroKeeper
from softgrip_driver.tendon.zero_store import ZeroStore

CALLS = ("open", "fsync", "replace")


def refuse(patch, name, code):
    def fail(*_, **__):
        raise OSError(code, os.strerror(code))

    patch.setattr(f"softgrip_model.durable.{'Path' if name == 'replace' else 'os'}.{name}", fail)


@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EROFS], ids=errno.errorcode.get)
def test_a_disk_that_refuses_zeros_leaves_every_drive_as_it_was(bench, tmp_path, code):
    bench.hold_taut(5.0)
    bench.pass_time(0.5)
    spools = {servo.tendon: servo.spool for servo in bench.servos}
    keeper = ZeroKeeper(ZeroStore(tmp_path / "zeros.yaml"), bench.identities, spools)
    for name in CALLS:
        before = {drive: (bench.drive(drive).state, bench.drive(drive).fault) for drive in spools}
        held = bench.plant.bank.tension_n.copy()
        with pytest.MonkeyPatch.context() as patch:
            refuse(patch, name, code)
            with pytest.raises(ConfigurationError, match="expected a writable file"):
                keeper.save_zeros(bench.loop, "2026-01-01T00:00:00+00:00")
        bench.pass_time(0.5)
        assert {drive: (bench.drive(drive).state, bench.drive(drive).fault) for drive in spools} == before
        # strips and cable relax by up to 8 % of it in half a second (docs/emulator.md)
        assert bench.plant.bank.tension_n == pytest.approx(held, rel=0.12)
        assert min(held) > 3.0
    keeper.save_zeros(bench.loop, "2026-01-01T00:00:00+00:00")
    assert set(ZeroStore(tmp_path / "zeros.yaml").load()) == set(spools)
