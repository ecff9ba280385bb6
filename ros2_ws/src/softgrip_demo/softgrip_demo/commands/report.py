# SPDX-License-Identifier: Apache-2.0
"""Turn a finished shift into its table, page and summary, after feeding its bag back through the predictor."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from softgrip_demo.record import RecordError, ShiftRecord
from softgrip_demo.summary import ReplayCheck, summarise

REPLAYED_NODE = "kinematics_predictor"


def main() -> int:
    """Entry point; the exit code is 0 when the shift is complete and its replay identical."""
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_demo report",
        description=__doc__,
        epilog="Writes report.html and summary.json there. Exit code 1: the replay differs; 2: no usable record.",
    )
    parser.add_argument("folder", type=Path, help="folder of the shift, e.g. out/demo")
    arguments = parser.parse_args()
    try:
        record = ShiftRecord.load(arguments.folder / "shift.json")
    except RecordError as error:
        print(error, file=sys.stderr)
        return 2
    start = time.monotonic()
    with ThreadPoolExecutor(1) as pool:  # the replay is a process of its own: drawn meanwhile
        replaying = pool.submit(replay_check, Path(record.bag_path), REPLAYED_NODE)
        from softgrip_demo.report import figures, render  # noqa: PLC0415  a second of libraries, beside the replay too

        drawn = figures(record, arguments.folder)
        replay = replaying.result()
    summary = summarise(record, replay, 0.0)
    page = render(record, summary, drawn)
    # what was not beside the replay
    summary["wall_s"]["report"] = round(time.monotonic() - start - replay.wall_clock_s, 3)
    (arguments.folder / "report.html").write_text(page)
    (arguments.folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    show(summary, arguments.folder)
    return 0 if replay.identical else 1


def replay_check(bag: Path, node: str) -> ReplayCheck:
    """Feed a bag through a node's code by the replay command and return what it found."""
    start = time.monotonic()
    command = ["ros2", "run", "softgrip_bag", "replay", str(bag), "--through", node, "--json"]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    wall_clock_s = time.monotonic() - start
    try:
        # `ros2 run` of Jazzy adds a line when a program ends with another code than 0
        found = json.loads(process.stdout[: process.stdout.rfind("}") + 1])
    except json.JSONDecodeError:
        return ReplayCheck(
            node, 0, identical=False, detail=process.stderr.strip() or process.stdout.strip(), wall_clock_s=wall_clock_s
        )
    return ReplayCheck(
        node, int(found["compared"]), bool(found["identical"]), str(found.get("detail", "")), wall_clock_s
    )


def show(summary: dict[str, Any], folder: Path) -> None:
    """Print the shift as a table."""
    console = Console()
    grasps = Table(title="Grasps", title_justify="left")
    for column in ("product", "fingers", "outcome", "Table 4.2", "result after"):
        grasps.add_column(column, justify="right" if column == "result after" else "left")
    for grasp in summary["grasps"]:
        colour = "green" if grasp["agrees"] else "red"
        latency = f"{grasp['latency_ms']:.1f} ms" if grasp["latency_ms"] is not None else "-"
        grasps.add_row(grasp["product"], grasp["grasp"], f"[{colour}]{grasp['outcome']}[/]", grasp["expected"], latency)
    console.print(grasps)
    shift = Table(show_header=False, title="Shift", title_justify="left")
    friction, bag, replay = summary["friction"], summary["bag"], summary["replay"]
    fit = f"error {friction['avg_error_pct']} % average, {friction['max_error_pct']} % maximum"
    shift.add_row("friction fit", f"{friction['n_points']} points, {fit}")
    for closing in summary["closings"]:
        shift.add_row(
            f"closing {closing['grasp']}",
            f"tip error {closing['tip_error_pct_mean']} % of the finger's length on average, "
            f"{closing['tip_error_pct_max']} % at most; "
            f"95 % interval holds {closing['tip_interval_held_pct']} %",
        )
    shift.add_row("shape", f"{summary['shape']['hexes']} hexahedra at {summary['shape']['rate_hz']} Hz")
    shift.add_row("swaps", str(summary["swaps"]))
    shift.add_row("bag", f"{bag['messages']} messages, {bag['topics']} topics, {bag['dropped']} dropped: {bag['path']}")
    same = "identical" if replay["identical"] else f"[red]differs: {replay['detail']}[/]"
    shift.add_row("replay", f"{replay['compared']} outputs of {replay['node']}: {same}")
    shift.add_row("wall time", f"{sum(value for value in summary['wall_s'].values() if value):.1f} s")
    console.print(shift)
    console.print(f"Page: {folder / 'report.html'}   figures: {folder / 'summary.json'}")


if __name__ == "__main__":
    sys.exit(main())
