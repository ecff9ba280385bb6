# SPDX-License-Identifier: Apache-2.0
"""The cell described once, in one file: what the wizard writes, the launch starts and the first run checks.

Example:
    >>> cell = load_cell(Path("cell.yaml"))
    >>> [servo.tendon for servo in cell.servos.chain]
    ['index', 'middle', 'thumb']
"""

from softgrip_description.cell_file.cell import (
    CellCamera,
    CellFile,
    CellFolders,
    CellRig,
    ChainServo,
    RigGauge,
    RigStage,
    ServoChain,
    TorqueValues,
    cell_text,
    load_cell,
    parse_cell,
    save_cell,
)
from softgrip_description.cell_file.parameters import device_arguments, launch_arguments, node_parameters, read_shipped

__all__ = [
    "CellCamera",
    "CellFile",
    "CellFolders",
    "CellRig",
    "ChainServo",
    "RigGauge",
    "RigStage",
    "ServoChain",
    "TorqueValues",
    "cell_text",
    "device_arguments",
    "launch_arguments",
    "load_cell",
    "node_parameters",
    "parse_cell",
    "read_shipped",
    "save_cell",
]
