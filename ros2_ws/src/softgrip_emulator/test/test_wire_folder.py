# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import stat

import pytest

from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.wire.folder import default_wire_folder, open_wire_folder


def test_a_new_folder_is_open_to_its_user_alone(tmp_path):
    open_wire_folder(tmp_path / "below" / "wires")
    assert stat.S_IMODE((tmp_path / "below" / "wires").stat().st_mode) == 0o700


def test_a_folder_that_is_there_is_used(tmp_path):
    open_wire_folder(tmp_path / "wires")
    open_wire_folder(tmp_path / "wires")


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o720])
def test_a_folder_that_others_can_write_to_is_refused(tmp_path, mode):
    (tmp_path / "wires").mkdir()
    (tmp_path / "wires").chmod(mode)
    with pytest.raises(EmulatorError, match="only user"):
        open_wire_folder(tmp_path / "wires")


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder away")
def test_the_folder_of_somebody_else_is_refused(tmp_path):
    (tmp_path / "wires").mkdir(mode=0o700)
    os.chown(tmp_path / "wires", 12345, 12345)
    with pytest.raises(EmulatorError, match="found user 12345"):
        open_wire_folder(tmp_path / "wires")


def test_the_default_is_below_the_users_own_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert default_wire_folder() == tmp_path / "softgrip"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert default_wire_folder() == tmp_path / "home" / ".cache" / "softgrip"
