# SPDX-License-Identifier: Apache-2.0
"""Nobody makes the recorder read or write elsewhere than it was told at its start."""

from __future__ import annotations

import grp
import os
import pwd
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import pytest

from softgrip_bag.context import parameter_files, restore
from softgrip_bag.errors import BagError
from softgrip_bag.mcap_file import Attachment
from softgrip_bag.places import MAX_FILE_BYTES, MAX_FILES, bag_folder, read_below, yaml_files_below
from softgrip_bag.snapshot import snapshot_seconds
from softgrip_bag.writer import BagWriter


@pytest.fixture
def root(tmp_path: Path) -> Path:
    made = tmp_path / "root"
    made.mkdir()
    (made / "file.yaml").write_text("a: 1\n")
    (tmp_path / "secret.yaml").write_text("secret\n")
    return made


def test_a_bag_goes_below_the_root(root: Path) -> None:
    assert bag_folder(root, "mine") == root / "mine"
    assert bag_folder(root, "today/mine") == root / "today" / "mine"
    assert bag_folder(root, str(root / "mine")) == root / "mine"
    assert bag_folder(root, "a/../b") == root / "b"


@pytest.mark.parametrize("path", ["", ".", "..", "../x", "a/../../x", "/tmp", "/", "a\0b", "x" * 3000, "link/x"])
def test_a_bag_anywhere_else_is_refused_with_what_to_do(root: Path, path: str) -> None:
    (root / "link").symlink_to(root.parent)
    with pytest.raises(BagError, match=r"expected a folder below .* found .*; name"):
        bag_folder(root, path)


def test_a_file_below_a_root_and_a_root_that_is_a_file_are_read(root: Path) -> None:
    assert read_below([root], root / "file.yaml") == b"a: 1\n"
    assert read_below([root / "file.yaml"], root / "file.yaml") == b"a: 1\n"
    (root / "link.yaml").symlink_to(root / "file.yaml")
    assert read_below([root], root / "link.yaml") == b"a: 1\n"
    assert yaml_files_below([root], root) == [root / "file.yaml", root / "link.yaml"]


def test_the_links_of_an_installation_are_followed_when_only_its_owner_can_have_made_them(root: Path) -> None:
    """As colcon's --symlink-install lays them: from share to build, and from there to the sources, here by `..`."""
    build, sources = root.parent / "build", root.parent / "src"
    for folder in (build, sources):
        folder.mkdir()
    (sources / "power.yaml").write_text("b: 2\n")
    (build / "power.yaml").symlink_to(Path("..") / "src" / "power.yaml")
    (root / "power.yaml").symlink_to(build / "power.yaml")
    carried = {each.name: each.data for each in parameter_files([root], "/n", "profiles_directory", root)}
    assert carried["parameter_files/n/profiles_directory/power.yaml"] == b"b: 2\n"


def link_that_anybody_may_have_made(root: Path, path: Path) -> None:
    path.symlink_to(root.parent / "secret.yaml")
    root.chmod(0o777)


def link_of_a_stranger(root: Path, path: Path) -> None:
    path.symlink_to(root.parent / "secret.yaml")
    root.chmod(0o1777)
    os.lchown(path, 65534, 65534)


def link_through_a_folder_of_anybody(root: Path, path: Path) -> None:
    elsewhere = root.parent / "open"
    elsewhere.mkdir()
    elsewhere.chmod(0o777)
    (elsewhere / "link.yaml").symlink_to(root.parent / "secret.yaml")
    path.symlink_to(elsewhere / "link.yaml")


def link_that_a_group_may_have_made(root: Path, path: Path) -> None:
    path.symlink_to(root.parent / "secret.yaml")
    os.chown(root, -1, 65534)
    root.chmod(0o775)


def link_to_a_circle(root: Path, path: Path) -> None:
    (root.parent / "circle").symlink_to(root.parent / "circle")
    path.symlink_to(root.parent / "circle")


def link_that_an_unknown_group_may_have_made(root: Path, path: Path) -> None:
    path.symlink_to(root.parent / "secret.yaml")
    os.chown(root, -1, 54321)  # in no /etc/group
    root.chmod(0o775)


LINKS = {
    "link that an unknown group may have made": link_that_an_unknown_group_may_have_made,
    "link that anybody may have made": link_that_anybody_may_have_made,
    "link of a stranger": link_of_a_stranger,
    "link through a folder of anybody": link_through_a_folder_of_anybody,
    "link that a group may have made": link_that_a_group_may_have_made,
    "link to a circle": link_to_a_circle,
}


def refused(root: Path, name: str) -> Path:
    """Make what a stranger might name."""
    path = root / f"{name}.yaml"
    if name in LINKS:
        LINKS[name](root, path)
    elif name == "pipe":
        os.mkfifo(path)
    elif name == "folder":
        path.mkdir()
    elif name == "large":
        path.write_bytes(bytes(MAX_FILE_BYTES + 1))
    elif name == "outside":
        return root.parent / "secret.yaml"
    elif name == "dots":
        return root / ".." / "secret.yaml"
    elif name == "zero byte":
        return Path("a\0b")
    elif name == "device":
        return Path("/dev/zero")
    return path


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", [*LINKS, "pipe", "folder", "large", "outside", "dots", "zero byte", "device"])
def test_what_is_no_small_plain_file_below_a_root_is_refused_at_once(root: Path, name: str) -> None:
    if ("stranger" in name or "group" in name) and os.geteuid() != 0:
        pytest.skip("only root can give something away")
    roots = [root, Path("/dev")] if name == "device" else [root]
    with pytest.raises(BagError, match="expected"):
        read_below(roots, refused(root, name))


def test_a_file_that_becomes_a_link_between_the_look_and_the_read_is_not_followed(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = root / "file.yaml"
    real = os.path.realpath

    def look_then_swap(place: Path) -> str:
        found = real(place)
        if Path(place) == path:
            path.unlink()
            path.symlink_to(root.parent / "secret.yaml")
        return found

    monkeypatch.setattr(os.path, "realpath", look_then_swap)
    with pytest.raises(OSError, match="symbolic links"):
        read_below([root], path)


@pytest.mark.parametrize(
    ("name", "members", "followed"),
    [("ada", [], True), ("ada", ["ada"], True), ("ada", ["eve"], False), ("lab", [], False)],
)
def test_the_group_that_a_user_has_alone_is_no_other(
    root: Path, monkeypatch: pytest.MonkeyPatch, name: str, members: list[str], followed: bool
) -> None:
    """As useradd makes it on Debian and Ubuntu (USERGROUPS_ENAB in login.defs(5))."""
    if os.geteuid() != 0:
        pytest.skip("only root can give something away")
    path = root / "link.yaml"
    path.symlink_to(root.parent / "secret.yaml")
    os.chown(root, -1, 54321)
    root.chmod(0o775)
    monkeypatch.setattr(pwd, "getpwuid", lambda _: SimpleNamespace(pw_name="ada"))
    monkeypatch.setattr(grp, "getgrgid", lambda _: SimpleNamespace(gr_name=name, gr_mem=members))
    if followed:
        assert read_below([root], path) == b"secret\n"
    else:
        with pytest.raises(BagError, match="others may change"):
            read_below([root], path)


def test_the_largest_file_is_read_and_a_larger_one_does_not_fill_the_memory(root: Path) -> None:
    largest, huge = root / "largest", root / "huge"
    largest.write_bytes(bytes(MAX_FILE_BYTES))
    assert len(read_below([root], largest)) == MAX_FILE_BYTES
    with huge.open("wb") as stream:
        stream.truncate(200 * MAX_FILE_BYTES)  # sparse: no room on the disk
    tracemalloc.start()
    try:
        with pytest.raises(BagError, match="at most"):
            read_below([root], huge)
        assert tracemalloc.get_traced_memory()[1] < 10 * MAX_FILE_BYTES
    finally:
        tracemalloc.stop()


def test_a_folder_with_too_many_files_is_refused(root: Path) -> None:
    for number in range(MAX_FILES):
        (root / f"{number}.yaml").touch()
    with pytest.raises(BagError, match=f"at most {MAX_FILES}"):
        parameter_files([root], "/n", "profiles_directory", root)


@pytest.mark.parametrize("seconds", [float("nan"), float("inf"), -1.0])
def test_a_snapshot_of_no_length_is_refused(seconds: float) -> None:
    with pytest.raises(BagError, match="expected 0"):
        snapshot_seconds(seconds)
    assert snapshot_seconds(0.0) == 0.0


@pytest.mark.parametrize(
    "name", ["../evil.yaml", "../../evil.yaml", "a/../../evil.yaml", "/evil.yaml", "..", "", "a/b.yaml"]
)
def test_a_bag_restores_no_file_outside_the_folder_it_is_given(tmp_path: Path, name: str) -> None:
    """What would be overwritten is there, so that a file written elsewhere is seen."""
    victim = tmp_path / "evil.yaml"
    victim.write_text("mine")
    bag = BagWriter(tmp_path / "bag")
    text = b"/n:\n  ros__parameters:\n    profiles_directory: /somewhere\n"
    bag.attach(Attachment("parameters/n.yaml", "application/yaml", text))
    bag.attach(Attachment(f"parameter_files/n/profiles_directory/{name}", "application/yaml", b"theirs"))
    bag.close()
    folder = tmp_path / "restored"
    folder.mkdir()
    with pytest.raises(BagError, match="expected a plain file name"):
        restore(tmp_path / "bag", "/n", folder)
    assert victim.read_text() == "mine"
    assert [path.read_bytes() for path in tmp_path.rglob("*evil.yaml")] == [b"mine"]
