# SPDX-License-Identifier: Apache-2.0
"""One cell of a name on a machine and in a domain."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from softgrip_nodekit import StartupError, claim_name
from softgrip_nodekit.cell_lock import lock_folder


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")


def node(name: str = "/left/driver") -> Any:
    return SimpleNamespace(get_fully_qualified_name=lambda: name, get_namespace=lambda: name.rpartition("/")[0] or "/")


def test_a_second_cell_of_a_name_is_refused_with_the_name_and_who_has_it() -> None:
    held = claim_name(node())
    with pytest.raises(StartupError, match=rf"one cell named 'left' in domain 7.*process {os.getpid()}.*cell:="):
        claim_name(node())
    held.close()


def test_other_names_and_other_domains_are_free(monkeypatch: pytest.MonkeyPatch) -> None:
    held = [claim_name(node(name)) for name in ("/driver", "/left/driver", "/right/driver")]
    monkeypatch.setenv("ROS_DOMAIN_ID", "8")
    held.append(claim_name(node()))
    for file in held:
        file.close()


def test_a_name_is_free_again_once_it_was_let_go() -> None:
    claim_name(node()).close()
    claim_name(node()).close()


def test_a_killed_process_leaves_its_name_free() -> None:
    code = (
        "import os, signal; from types import SimpleNamespace; from softgrip_nodekit import claim_name\n"
        "node = SimpleNamespace(get_fully_qualified_name=lambda: '/left/driver', get_namespace=lambda: '/left')\n"
        "held = claim_name(node); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=False)
    assert (lock_folder() / "left.driver.lock").exists()
    claim_name(node()).close()
