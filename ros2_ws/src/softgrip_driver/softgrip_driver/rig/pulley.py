# SPDX-License-Identifier: Apache-2.0
"""The guide pulley's own friction, kept beside the models."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml

from softgrip_driver.errors import ConfigurationError
from softgrip_model.durable import write_durably

_FILE = "pulley.calibration"


@dataclass(frozen=True)
class Pulley:
    """Tension ratio over the guide pulley [1] and its standard deviation [1]."""

    ratio: float
    stddev: float


def read_pulley(folder: Path) -> Pulley | None:
    """Return the last calibration, None when there was none.

    Raises:
        ConfigurationError: the file is damaged.
    """
    path = folder / _FILE
    if not path.exists():
        return None
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        pulley = Pulley(float(content["ratio"]), float(content["stddev"]))
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise ConfigurationError(
            f"{path}: expected ratio and stddev, found {error!r}; remove it or calibrate"
        ) from error
    if not (0.9 < pulley.ratio < 1.5 and 0.0 <= pulley.stddev < 0.2):
        raise ConfigurationError(f"{path}: expected a ratio of 0.9 .. 1.5, found {pulley}; calibrate the pulley again")
    return pulley


def write_pulley(folder: Path, pulley: Pulley) -> None:
    """Keep a calibration, whole or not at all.

    Raises:
        OSError: the disk refused.
    """
    write_durably(folder / _FILE, f"ratio: {pulley.ratio}\nstddev: {pulley.stddev}\n".encode())
