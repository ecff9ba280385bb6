# SPDX-License-Identifier: Apache-2.0
"""File formats: what is read and written, with a shipped file of each as the example."""

from __future__ import annotations

from dataclasses import dataclass

from generated.markdown import ROOT, table

SOURCE = "ros2_ws/src"
#: Longer examples are cut.
MAX_LINES = 60


@dataclass(frozen=True)
class Format:
    """One format.

    Attributes:
        title: heading.
        use: what for, and units.
        written: what writes it.
        read: what reads it.
        example: a file of the repository, from its root; empty for none.
        language: of the example.
    """

    title: str
    use: str
    written: str
    read: str
    example: str = ""
    language: str = "yaml"


FORMATS = (
    Format(
        "Finger profile",
        "the fingers of one set as printed; SI units",
        "`ros2 run softgrip_design optimise`, or you",
        "`softgrip_model.profile.load`, every node",
        f"{SOURCE}/softgrip_bringup/profiles/pinch.yaml",
    ),
    Format(
        "Friction model",
        "a fitted law with covariance, ranges and provenance; SI units",
        "`friction_rig`, `ros2 run softgrip_model fit_friction`",
        "`softgrip_model.friction.model_file.read_model`",
        f"{SOURCE}/softgrip_model/softgrip_model/friction/data/braid-tpu.yaml",
    ),
    Format(
        "Friction measurements",
        "one header, one row a point; units stand in the header",
        "a spreadsheet, an external rig",
        "`softgrip_model.friction.csv_file.read_csv`",
    ),
    Format(
        "Hand",
        "palm, slots and tool centre points; m and rad",
        "you, from a drawing",
        "`softgrip_description.load_hand`",
        f"{SOURCE}/softgrip_description/softgrip_description/data/hand.yaml",
    ),
    Format(
        "Product catalogue",
        "products with recipes, and what each finger set can do",
        "you; imported into the cell's database",
        "`softgrip_cell.catalogue_file.read_catalogue`, `ros2 run softgrip_cell library`",
        f"{SOURCE}/softgrip_cell/softgrip_cell/data/catalogue.yaml",
    ),
    Format(
        "Finger records",
        "what is known about each printed finger",
        "you, for the first import",
        "`ros2 run softgrip_cell library`",
        f"{SOURCE}/softgrip_cell/softgrip_cell/data/finger_records.yaml",
    ),
    Format(
        "GDFE case",
        "mesh, materials, supports and loads of one simulation; mm, MPa and N",
        "you",
        "`ros2 run softgrip_model simulate`",
        f"{SOURCE}/softgrip_model/softgrip_model/gdfe/cases/finger_closing.yaml",
    ),
    Format(
        "Joint angles of a hand",
        "one row a frame, one column a joint",
        "`ros2 run softgrip_design capture`",
        "`ros2 run softgrip_design optimise`",
        f"{SOURCE}/softgrip_design/softgrip_design/data/captured_pinch.csv",
        "text",
    ),
    Format(
        "Bag",
        "a folder with MCAP files and metadata.yaml; messages are CDR of ROS 2",
        "`recorder`, `ros2 bag record`",
        "`ros2 run softgrip_bag`, any reader of MCAP; see [bags](../../bags.md)",
    ),
    Format(
        "Archive",
        "partitioned Parquet beside the untouched bags",
        "`ros2 run softgrip_bag archive`",
        "`ros2 run softgrip_bag query`, DuckDB; see [archive](../../archive.md)",
    ),
    Format(
        "Servo model of the emulator",
        "the registers in which a model differs from its series",
        "from the maker's control table",
        "`emulated_cell`",
        f"{SOURCE}/softgrip_emulator/softgrip_emulator/dynamixel/models/xl330_m288.yaml",
    ),
    Format(
        "Access policy",
        "who may publish, subscribe, serve and call; see [security](../../security.md)",
        "the project; a new topic needs a line",
        "`ros2 run softgrip_security keys`",
        f"{SOURCE}/softgrip_security/softgrip_security/data/access.yaml",
    ),
)


def page() -> str:
    """Return the page."""
    rows = [(f"[{one.title}](#{_anchor(one.title)})", one.use, one.written, one.read) for one in FORMATS]
    parts = ["# File formats\n", table(("format", "what for, units", "written by", "read by"), rows)]
    for one in FORMATS:
        parts.append(f"\n## {one.title}\n")
        parts.append(f"Written by {one.written}. Read by {one.read}.\n")
        if one.example:
            parts.append(_example(one))
    parts.append("")
    return "\n".join(parts).replace("## Friction measurements\n", _MEASUREMENTS, 1)


_MEASUREMENTS = """## Friction measurements

```text
angle [deg], load [g], T1 [N]
10, 200, 2.41
```
"""


def _anchor(title: str) -> str:
    return title.lower().replace(" ", "-")


def _example(one: Format) -> str:
    lines = (ROOT / one.example).read_text(encoding="utf-8").splitlines()
    shown = [line for line in lines[:MAX_LINES] if not line.startswith("# SPDX")]
    if len(lines) > MAX_LINES:
        shown.append("# ..." if one.language == "yaml" else "...")
    text = "\n".join(shown)
    return (
        f"The shipped [{one.example.rpartition('/')[2]}](../../../{one.example}):\n\n```{one.language}\n{text}\n```\n"
    )
