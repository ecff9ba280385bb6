# SPDX-License-Identifier: Apache-2.0
"""The operator's panel: from a click on STOP to torque off, by the truth of the emulated servos; what the page costs.

The click is a real one, in a real Chromium, beside two other pages; it counts from the browser's own event. The peer is
the same stop called by a ROS client, in the same run. The share of a processor is that of the panel's process beside a
whole emulated cell in real time with three pages open (Cell, Fingers, Swap).
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from _emulated_drives import Servos, emulated_servos, start_driver
from estop_latency import ANSWER_S, DOMAIN, Client, measure

from softgrip_testing.benchmark_claim import claim
from softgrip_testing.browser import PanelBrowser
from softgrip_testing.process_table import node_processes, processor_s

COUNT = 100
VIEW_S = 20.0
GOAL_S = 0.100
GOAL_SHARE = 0.15
#: Where the click was, by the browser's clock [s since the Unix epoch].
WATCH_CLICKS = (
    "document.addEventListener('click', () => {"
    " window.clickedAt = (performance.timeOrigin + performance.now()) / 1000 }, {capture: true})"
)


def address_of(log: Path) -> str:
    """Wait for the panel's address in a log."""
    deadline_s = time.monotonic() + 90.0
    while time.monotonic() < deadline_s:
        found = re.search(r"the page is at (http://\S+?)/\s", log.read_text())
        if found:
            return found[1]
        time.sleep(0.1)
    raise SystemExit(f"the panel did not say its address:\n{log.read_text()[-2000:]}")


@contextmanager
def started(command: list[str], log: Path, domain: int) -> Iterator[int]:
    """Run a command until the block ends; gives its process id."""
    with log.open("w") as out:
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "PATH": path}
        process = subprocess.Popen(
            command, stdout=out, stderr=subprocess.STDOUT, env=environment, start_new_session=True
        )
        try:
            yield process.pid
        finally:
            os.killpg(process.pid, signal.SIGINT)
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)


def open_three(browser: PanelBrowser, paths: tuple[str, ...]) -> None:
    """Open pages in windows of their own; the first one is in front."""
    browser.log_in("Ada")
    first = browser.driver.current_window_handle
    for path in paths[1:]:
        browser.driver.switch_to.new_window("window")
        browser.open(path)
    browser.driver.switch_to.window(first)
    browser.open(paths[0])


def click_times(browser: PanelBrowser, client: Client, servos: Servos, count: int) -> list[float]:
    """Click STOP so many times; return the times to torque off [s]."""
    times = []
    browser.script(WATCH_CLICKS)
    for _ in range(count):
        client.call("estop_reset")
        if not servos.wait_for(3, ANSWER_S):
            raise SystemExit("the drives did not come back after estop_reset")
        browser.find("#estop").click()
        if not servos.wait_for(0, ANSWER_S):
            raise SystemExit("a click did not stop the drives")
        to_epoch_s = time.time() - time.monotonic()
        times.append(max(0.0, servos.last_on_s + to_epoch_s - float(browser.script("return window.clickedAt"))))
    client.call("estop_reset")
    return times


def share_of_a_processor(folder: Path) -> float:
    """Return the panel's share beside a whole cell with three pages open."""
    log = folder / "cell.log"
    command = ["ros2", "launch", "softgrip_bringup", "cell.launch.yaml", f"out:={folder}/cell", f"wire_dir:={folder}/w"]
    with started(command, log, DOMAIN + 1) as session, PanelBrowser(address_of(log)) as browser:
        browser.log_in("Ada")
        browser.wait(lambda: browser.text("#mode") == "Idle", "a cell that is up", 90.0)
        open_three(browser, ("/", "/fingers", "/swap"))
        time.sleep(3.0)
        pid = node_processes(session)["panel"]
        before_s, began_s = processor_s(pid), time.monotonic()
        time.sleep(VIEW_S)
        return (processor_s(pid) - before_s) / (time.monotonic() - began_s)


def main() -> None:
    """Measure both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=COUNT, help="clicks (default: %(default)s)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with emulated_servos(folder) as servos:
            driver = start_driver(servos, folder, DOMAIN)
            client = Client()
            log = folder / "panel.log"
            command = [sys.executable, "-m", "softgrip_panel.nodes.panel", "--ros-args", "-r", "__node:=panel"]
            try:
                with started(command, log, DOMAIN), PanelBrowser(address_of(log)) as browser:
                    open_three(browser, ("/", "/swap", "/grasps"))
                    clicked = click_times(browser, client, servos, options.count)
                    called, _ = measure(client, servos, options.count)
            finally:
                client.close()
                driver.terminate()
                driver.wait(10.0)
        share = share_of_a_processor(folder)
    p99, peer = (sorted(times)[int(0.99 * (len(times) - 1))] for times in (clicked, called))
    claim(
        "click to torque off p99",
        1e3 * p99,
        "ms",
        better="lower",
        goal=1e3 * GOAL_S,
        peer="the same stop by a ROS client",
        peer_value=1e3 * peer,
        runs=len(clicked),
        note=f"p50 {1e3 * statistics.median(clicked):.1f} ms, max {1e3 * max(clicked):.1f} ms; three pages open",
    )
    claim(
        "panel CPU share",
        share,
        "1",
        better="lower",
        goal=GOAL_SHARE,
        runs=1,
        note=f"{VIEW_S:.0f} s, three pages open on a whole emulated cell in real time",
    )


if __name__ == "__main__":
    main()
