# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import errno
import os
import re
from pathlib import Path

import pytest

from softgrip_model.durable import make_folder_durably, replacing_durably, write_durably


@pytest.mark.parametrize("old", [None, b"old"])
def test_a_power_cut_at_any_moment_leaves_the_old_file_or_the_new_one(tmp_path, volatile_disk, old):
    path = tmp_path / "state"
    if old is not None:
        path.write_bytes(old)
    disk = volatile_disk()
    write_durably(path, b"new")
    assert len(disk.moments) >= 6  # fsync of the file, rename, fsync of the folder
    for outcomes in disk.moments:
        assert {found.get("state") for found in outcomes} <= {old, b"new"}
    assert [found["state"] for found in disk.after_power_cut()] == [b"new", b"new"]


def test_the_model_of_the_disk_finds_a_missing_fsync_of_the_file_and_of_the_folder(tmp_path, volatile_disk):
    path = tmp_path / "state"
    path.write_bytes(b"old")
    disk = volatile_disk()
    (tmp_path / "fresh").write_bytes(b"new")
    os.replace(tmp_path / "fresh", path)  # noqa: PTH105  the call that is watched
    assert [found["state"] for found in disk.after_power_cut()] == [b"old", b""]


def test_folders_that_are_missing_are_made_and_kept(tmp_path, volatile_disk):
    volatile_disk()
    synced: list[str] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        synced.append(os.readlink(f"/proc/self/fd/{descriptor}"))  # noqa: PTH115
        real(descriptor)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", fsync)
        make_folder_durably(tmp_path / "a" / "b")
        make_folder_durably(tmp_path / "a" / "b")
    assert synced == [str(tmp_path), str(tmp_path / "a")]


@pytest.mark.parametrize("call", ["open", "fsync", "replace"])
@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EROFS])
def test_a_disk_that_refuses_is_an_error_and_leaves_no_half_file(tmp_path, monkeypatch, call, code):
    path = tmp_path / "state"
    path.write_bytes(b"old")

    def refuse(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patch:
        patch.setattr(os, call, refuse)
        with pytest.raises(OSError, match=re.escape(os.strerror(code))) as caught:
            write_durably(path, b"new")
    assert caught.value.errno == code
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("state", b"old")]


def test_a_block_that_fails_changes_nothing(tmp_path):
    def fail(path: Path) -> None:
        with replacing_durably(path) as stream:
            stream.write(b"half")
            raise ValueError("on purpose")

    path = tmp_path / "state"
    write_durably(path, b"old")
    with pytest.raises(ValueError, match="on purpose"):
        fail(path)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("state", b"old")]


def test_a_secret_is_readable_by_its_owner_alone(tmp_path):
    write_durably(tmp_path / "token", b"t", mode=0o600)
    assert (tmp_path / "token").stat().st_mode & 0o777 == 0o600
