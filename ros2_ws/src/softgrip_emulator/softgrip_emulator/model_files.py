# SPDX-License-Identifier: Apache-2.0
"""Servo models that are described by YAML files, one a model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

from softgrip_emulator.errors import EmulatorError

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path


def described(folder: Path, besides: Collection[str] = ()) -> list[str]:
    """File names of the models in a folder, without those of other files."""
    return sorted(path.stem for path in folder.glob("*.yaml") if path.stem not in besides)


def read_description(folder: Path, name: str, besides: Collection[str] = ()) -> dict[str, Any]:
    """Read a model's file by the model's name ("XL330-M288") or by its own ("xl330_m288").

    Raises:
        EmulatorError: no such model.
    """
    stem = name.lower().replace("-", "_")
    known = described(folder, besides)
    if stem not in known:
        raise EmulatorError(f"servo model: expected one of {known}, found '{name}'")
    found: dict[str, Any] = yaml.safe_load((folder / f"{stem}.yaml").read_text(encoding="utf-8"))
    return found
