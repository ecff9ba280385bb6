# SPDX-License-Identifier: Apache-2.0
"""Keys, checked by openssl."""

from __future__ import annotations

import datetime as dt
import json
import os
import stat
import subprocess

import pytest

from softgrip_security.certificates import make_authority, make_certificate, sign_document
from softgrip_security.commands import keys as keys_command
from softgrip_security.errors import SecurityError
from softgrip_security.keystore import Keystore, exposure
from softgrip_security.policy import Policy, read_policy

NOW = dt.datetime.now(dt.UTC)


@pytest.fixture(scope="module")
def policy():
    """Three of the shipped identities: each key takes its time."""
    return Policy(tuple(one for one in read_policy().identities if one.name in {"camera", "tendon_driver", "look"}))


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "keys"


def openssl(*arguments):
    return subprocess.run(["openssl", *map(str, arguments)], capture_output=True, text=True, check=False)


def snapshot(folder):
    return {path: path.read_bytes() for path in folder.rglob("*.pem") if not path.is_symlink()}


def test_a_keystore_holds_a_certificate_of_the_cells_authority_for_each_identity(folder, policy):
    report = Keystore(folder, policy).make()
    assert set(report.made) == {"authority", "router", *(one.name for one in policy.identities)}
    assert report.warnings == ()
    for one in policy.identities:
        certificate = folder / "enclaves" / "softgrip" / one.name / "cert.pem"
        assert openssl("verify", "-CAfile", folder / "public/identity_ca.cert.pem", certificate).returncode == 0
        subject = openssl("x509", "-in", certificate, "-noout", "-subject", "-nameopt", "RFC2253").stdout
        assert subject.strip() == f"subject=CN=/softgrip/{one.name}"


def test_a_certificate_names_the_hosts_it_may_be_met_at(folder, policy):
    Keystore(folder, policy, ["cell-pc.local", "10.0.0.5"]).make()
    text = openssl("x509", "-in", folder / "enclaves/softgrip/camera/cert.pem", "-noout", "-text").stdout
    for name in ("DNS:localhost", "IP Address:127.0.0.1", "DNS:cell-pc.local", "IP Address:10.0.0.5", "CA:FALSE"):
        assert name in text
    session = json.loads((folder / "zenoh/camera.json5").read_text())
    assert session["connect"]["endpoints"] == ["tls/cell-pc.local:7447"]


def test_nobody_else_can_read_any_of_it(folder, policy):
    previous = os.umask(0)
    try:
        Keystore(folder, policy).make()
    finally:
        os.umask(previous)
    for path in [folder, *folder.rglob("*")]:
        if not path.is_symlink():
            assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_making_keys_twice_replaces_none(folder, policy):
    Keystore(folder, policy).make()
    before = snapshot(folder)
    report = Keystore(folder, policy).make()
    assert report.made == report.written == ()
    assert snapshot(folder) == before


def test_rotation_replaces_every_key_and_keeps_the_authority(folder, policy):
    Keystore(folder, policy).make()
    before = snapshot(folder)
    Keystore(folder, policy).rotate()
    after = snapshot(folder)
    same = {path.relative_to(folder).as_posix() for path in before if before[path] == after[path]}
    assert same == {"public/ca.cert.pem", "private/ca.key.pem"}


def test_a_new_authority_replaces_everything_and_accepts_no_old_certificate(folder, policy, tmp_path):
    Keystore(folder, policy).make()
    old = tmp_path / "old.pem"
    old.write_bytes((folder / "enclaves/softgrip/camera/cert.pem").read_bytes())
    before = snapshot(folder)
    Keystore(folder, policy).rotate(authority=True)
    after = snapshot(folder)
    assert all(before[path] != after[path] for path in before)
    assert openssl("verify", "-CAfile", folder / "public/ca.cert.pem", old).returncode != 0
    signed = folder / "enclaves/softgrip/camera/permissions.p7s"
    assert openssl("smime", "-verify", "-in", signed, "-CAfile", folder / "public/ca.cert.pem").returncode == 0


def test_a_keystore_whose_authority_is_kept_elsewhere_is_not_given_another_one(folder, policy):
    Keystore(folder, policy).make()
    (folder / "private/ca.key.pem").unlink()
    with pytest.raises(SecurityError, match="bring"):
        Keystore(folder, policy).make()
    (folder / "public/ca.cert.pem").unlink()
    with pytest.raises(SecurityError, match="authority that signed"):
        Keystore(folder, policy).make()


def test_a_folder_with_something_else_is_left_alone(folder, policy):
    folder.mkdir(mode=0o700)
    (folder / "thesis.txt").write_text("mine")
    with pytest.raises(SecurityError, match="other files"):
        Keystore(folder, policy).make()
    assert [path.name for path in folder.iterdir()] == ["thesis.txt"]


def test_a_folder_that_others_may_enter_is_refused(folder, policy):
    folder.mkdir(mode=0o755)
    with pytest.raises(SecurityError, match="0755"):
        Keystore(folder, policy).make()
    assert not any(folder.iterdir())


def test_an_open_key_is_reported(folder, policy):
    Keystore(folder, policy).make()
    key = folder / "enclaves/softgrip/camera/key.pem"
    key.chmod(0o640)
    assert [text for text in Keystore(folder, policy).warnings() if str(key) in text and "0640" in text]


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file away")
def test_the_key_of_somebody_else_is_reported(folder, policy):
    Keystore(folder, policy).make()
    key = folder / "enclaves/softgrip/camera/key.pem"
    os.chown(key, 12345, 12345)
    assert "found user 12345" in str(exposure(key))


@pytest.mark.parametrize(("days_later", "reported"), [(0, False), (366, False), (368, True), (400, True)])
def test_certificates_are_reported_a_month_before_their_end(folder, policy, days_later, reported):
    Keystore(folder, policy, now=NOW).make(days=397)
    later = Keystore(folder, policy, now=NOW + dt.timedelta(days=days_later)).warnings()
    assert any(text.startswith("camera: the certificate ends") for text in later) is reported


def test_keys_of_nobody_in_the_policy_are_reported(folder, policy):
    Keystore(folder, policy).make()
    (folder / "enclaves/softgrip/stranger").mkdir()
    assert any(text.startswith("stranger:") for text in Keystore(folder, policy).warnings())


def test_signed_permissions_verify_and_changed_ones_do_not(folder, policy):
    Keystore(folder, policy).make()
    signed, authority = folder / "enclaves/softgrip/camera/permissions.p7s", folder / "public/permissions_ca.cert.pem"
    good = openssl("smime", "-verify", "-in", signed, "-CAfile", authority)
    assert good.returncode == 0
    assert "rt/camera/camera_info" in good.stdout
    changed = folder / "changed.p7s"
    changed.write_bytes(signed.read_bytes().replace(b"rt/camera/camera_info", b"rt/tendon/trajectory2"))
    assert openssl("smime", "-verify", "-in", changed, "-CAfile", authority).returncode != 0


def test_an_end_certificate_cannot_sign_another_one(tmp_path):
    authority = make_authority(NOW)
    node = make_certificate(authority, "/softgrip/camera", [], NOW, 10)
    forged = make_certificate(node, "/softgrip/tendon_driver", [], NOW, 10)
    for name, credential in (("ca", authority), ("node", node), ("forged", forged)):
        (tmp_path / f"{name}.pem").write_bytes(credential.certificate_pem)
    chain = ["-CAfile", tmp_path / "ca.pem", "-untrusted", tmp_path / "node.pem"]
    assert openssl("verify", *chain, tmp_path / "forged.pem").returncode != 0


def test_a_signature_is_of_the_authority_that_made_it(tmp_path):
    (tmp_path / "text.p7s").write_bytes(sign_document(make_authority(NOW), b"<dds/>"))
    (tmp_path / "other.pem").write_bytes(make_authority(NOW).certificate_pem)
    answer = openssl("smime", "-verify", "-in", tmp_path / "text.p7s", "-CAfile", tmp_path / "other.pem")
    assert answer.returncode != 0


def test_the_command_makes_checks_and_renews(folder, capsys):
    assert keys_command.main([str(folder), "--check"]) == 1
    assert "make keys" in capsys.readouterr().err
    assert keys_command.main([str(folder)]) == 0
    assert "authority" in capsys.readouterr().out
    assert keys_command.main([str(folder), "--check"]) == 0
    before = snapshot(folder)
    assert keys_command.main([str(folder), "--rotate"]) == 0
    assert snapshot(folder) != before


@pytest.mark.parametrize("host", ["not a host", "10.0.0.256", "", "a..b"])
def test_what_is_no_host_is_refused(folder, policy, host):
    with pytest.raises(SecurityError, match="host"):
        Keystore(folder, policy, [host]).make()


def test_keys_of_an_older_policy_are_named_and_written_again_without_a_new_key(folder, policy):
    older = Policy(policy.identities[:-1])
    Keystore(folder, older).make()
    keys = snapshot(folder)
    (text,) = [text for text in Keystore(folder, policy).warnings() if "policy.xml" in text]
    assert "`make keys`" in text
    assert Keystore(folder, policy).make().warnings == ()
    assert keys.items() <= snapshot(folder).items()
