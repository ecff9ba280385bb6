# SPDX-License-Identifier: Apache-2.0
"""Draw what the shipped Lichtblick layout shows of a recorded bag, with matplotlib, into docs/images/bags_layout.png.

Not a screenshot: the panels' own paths are read from the layout and followed through the messages of the bag.
"""

from __future__ import annotations

import argparse
import io
import json
import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import image as images
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rclpy.serialization import deserialize_message

from softgrip_bag.nodes.messages import message_class, tree
from softgrip_bag.plots import INK, STYLE
from softgrip_bag.reader import read

ROOT = Path(__file__).resolve().parents[2]
LAYOUT = ROOT / "ros2_ws/src/softgrip_bag/layouts/softgrip.lichtblick.json"
BAGS = ROOT / "tests/replay/bags"
CAMERA = "/camera/image_raw/compressed"
_STEP = re.compile(r'(?P<name>\w+)(?:\[(?P<index>\d+|:)\])?(?:\{(?P<key>\w+)=="(?P<value>[^"]+)"\})?')


def follow(value: Any, steps: list[str]) -> Any:
    """Return what a Lichtblick message path leads to; None when there is nothing."""
    for step in steps:
        found = _STEP.fullmatch(step)
        assert found is not None, step
        value = value[found["name"]]
        if found["key"]:
            value = next((item for item in value if item[found["key"]] == found["value"]), None)
        elif found["index"]:
            value = value[int(found["index"])] if int(found["index"]) < len(value) else None
        if value is None:
            return None
    return value


def curves(bag: Path, paths: list[str]) -> dict[str, tuple[list[float], list[Any]]]:
    """Return times [s since the first stamp] and values of every path."""
    split = {path: path.split(".") for path in paths}
    found: dict[str, tuple[list[float], list[Any]]] = {path: ([], []) for path in paths}
    for raw in read(bag, {steps[0] for steps in split.values()}):
        values = tree(deserialize_message(raw.data, message_class(raw.type_name)))
        stamp = values["header"]["stamp"]
        for path, (topic, *steps) in split.items():
            if topic == raw.topic and (value := follow(values, steps)) is not None:
                found[path][0].append(stamp["sec"] + 1e-9 * stamp["nanosec"])
                found[path][1].append(value)
    start = min(times[0] for times, _ in found.values() if times)
    return {path: ([time - start for time in times], values) for path, (times, values) in found.items()}


def draw_plot(axes: Axes, panel: dict[str, Any], found: dict[str, tuple[list[float], list[Any]]]) -> None:
    """One Plot panel."""
    for line in panel["paths"]:
        times, values = found[line["value"]]
        style = "--" if line.get("lineStyle") == "dashed" else "-"
        axes.plot(times, values, style, color=line["color"], lw=0.9, label=line["label"])
    shown = np.concatenate([np.asarray(found[line["value"]][1], dtype=float) for line in panel["paths"]])
    low, high = np.nanpercentile(shown, [0.0, 99.0])  # where a model has its limit single values are far out
    axes.set_ylim(low - 0.05 * (high - low), high + 0.3 * (high - low))
    axes.set_title(panel["title"], loc="left", fontsize=9)
    axes.set_ylabel(panel["yAxisLabel"])
    axes.legend(fontsize=8, ncols=2, loc="upper left")


def draw_states(axes: Axes, panel: dict[str, Any], found: dict[str, tuple[list[float], list[Any]]], end: float) -> None:
    """The StateTransitions panel: one row a path, a bar for every value."""
    names = []
    for row, line in enumerate(panel["paths"]):
        times, values = found[line["value"]]
        changes = [i for i, value in enumerate(values) if i == 0 or value != values[i - 1]]
        for i, following in zip(changes, [*changes[1:], None], strict=True):
            until = end if following is None else times[following]
            axes.barh(row, until - times[i], left=times[i], height=0.7, color="#9cc5b0", edgecolor="white")
            axes.text(times[i], row, f" {str(values[i])[:12]}", va="center", fontsize=8, clip_on=True)
        names.append(line["label"])
    axes.set_yticks(range(len(names)), names)
    axes.set_xlim(0, end)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.set_title(panel["foxglovePanelTitle"], loc="left", fontsize=9)


def draw_camera(axes: Axes, bag: Path) -> None:
    """The Image panel."""
    frame = next(iter(read(bag, {CAMERA})))
    message = deserialize_message(frame.data, message_class(frame.type_name))
    axes.imshow(images.imread(io.BytesIO(bytes(message.data)), format="jpeg"))
    axes.set_axis_off()
    axes.set_title("camera", loc="left", fontsize=9, color=INK)


def main() -> int:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bag", type=Path, default=BAGS / "closings", help="drawn in the plots")
    parser.add_argument("--frames", type=Path, default=BAGS / "frames", help="whose first frame is shown")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs/images/bags_layout.png")
    options = parser.parse_args()
    panels = json.loads(LAYOUT.read_text())["configById"]
    plots = [panel for name, panel in panels.items() if name.startswith("Plot!")]
    states = next(panel for name, panel in panels.items() if name.startswith("StateTransitions!"))
    found = curves(options.bag, [line["value"] for panel in (*plots, states) for line in panel["paths"]])
    end = max(float(np.max(times)) for times, _ in found.values() if times)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10, 7.2), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=(0.34, 0.66))
        camera, cell = left.subplots(2, 1)
        draw_camera(camera, options.frames)
        draw_states(cell, states, found, end)
        grid = right.add_gridspec(3, 2)
        places = [grid[0, 0], grid[0, 1], grid[1, 0], grid[1, 1], grid[2, :]]
        for place, panel in zip(places, plots, strict=True):
            draw_plot(right.add_subplot(place), panel, found)
        figure.savefig(options.output, dpi=110, metadata={"Software": None})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
