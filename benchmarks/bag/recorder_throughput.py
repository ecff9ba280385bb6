# SPDX-License-Identifier: Apache-2.0
"""What the recorder sustains without loss: JointState 1 kHz x 8, 1280x720 JPEG 60 fps, 2,000-vertex shapes 60 Hz.

First the way from a callback to the disk (`Pipeline`) as fast as it goes, beside the bare writer of the `mcap` library
on the same bytes, both until the file is on the disk. Then the traffic itself: a recorder process, and processes that
publish at these rates for a while; every message published has to be in the bag.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer

from softgrip_bag.offers import OfferedQos
from softgrip_bag.pipeline import Pipeline
from softgrip_bag.reader import topic_summaries
from softgrip_bag.writer import BagWriter, Topic
from softgrip_testing.benchmark_claim import claim, spread
from softgrip_testing.process_table import processor_s
from softgrip_time.units import to_ns

JOINT_TOPICS = 8
RATES_HZ = {"joints": 1000.0, "image": 60.0, "shape": 60.0}
VARIANTS = 16  # different messages of a kind, sent in turn
PEER = "bare mcap.Writer, zstd, same bytes"
IMAGE_GOAL_MB_S = 100.0
RATIO_GOAL = 0.7
DOMAIN = "76"
READY = "ready"
_DEADLINE_S = 60.0
_CAPACITY_BYTES = 64_000_000
_ROOM_BYTES = 1_000_000

Message = tuple[str, int, bytes]  # topic, time [ns], CDR


def serialized() -> dict[str, list[bytes]]:
    """Return CDR of every kind of message."""
    from rclpy.serialization import serialize_message  # noqa: PLC0415  the roles start quicker without numpy's user
    from sensor_msgs.msg import CompressedImage, JointState  # noqa: PLC0415  as above

    from softgrip_interfaces.msg import PredictedShape  # noqa: PLC0415  as above

    random = np.random.default_rng(7)
    names = [f"joint_{index}" for index in range(12)]
    grid = np.stack(np.meshgrid(np.linspace(0, 0.09, 50), np.linspace(0, 0.02, 40)), axis=-1).reshape(-1, 2)
    texture = cv2.GaussianBlur(random.integers(0, 256, (720, 1280, 3), dtype=np.uint8), (5, 5), 0)
    found: dict[str, list[Any]] = {"joints": [], "image": [], "shape": []}
    for variant in range(VARIANTS):
        values = random.normal(size=(3, 12))
        joints = JointState(name=names, position=values[0], velocity=values[1], effort=values[2])
        coded = cv2.imencode(".jpg", np.roll(texture, 40 * variant, axis=1), [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        image = CompressedImage(format="jpeg", data=coded.tobytes())
        bend = 0.02 * np.sin(30.0 * grid[:, 0] + variant)
        vertices = np.column_stack([grid, bend + random.normal(scale=1e-6, size=len(bend))]).astype(np.float32)
        shape = PredictedShape(finger="index", mesh="grid", vertices=vertices.ravel(), hexahedra=len(vertices))
        shape.faces = np.arange(4 * 1911, dtype=np.uint32) % len(vertices)
        shape.strain = random.normal(size=len(vertices)).astype(np.float32)
        for kind, message in (("joints", joints), ("image", image), ("shape", shape)):
            found[kind].append(serialize_message(message))
    return found


def traffic(kinds: dict[str, list[bytes]], seconds: float) -> list[Message]:
    """Return what the cell says in so many seconds, by time."""
    messages = []
    for kind, rate in RATES_HZ.items():
        if kind in kinds:
            topics = [f"/joints_{index}" for index in range(JOINT_TOPICS)] if kind == "joints" else [f"/{kind}"]
            for count in range(round(rate * seconds)):
                data = kinds[kind][count % VARIANTS]
                messages += [(topic, to_ns(count / rate), data) for topic in topics]
    return sorted(messages, key=lambda message: message[1])


def write_bare(messages: Iterable[Message], topics: Iterable[str], path: Path) -> None:
    """The library alone, until the file is on the disk."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in topics}
        for topic, at, data in messages:
            writer.add_message(channels[topic], at, data, at, 0)
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())


def write_ours(messages: Iterable[Message], topics: Iterable[str], folder: Path) -> None:
    """What a callback of the recorder does with a message, until the bag is finished on the disk."""
    bag = BagWriter(folder)
    for topic in topics:
        bag.add_topic(Topic(topic, "std_msgs/msg/String", "", "string data\n", (OfferedQos(),)))
    pipeline = Pipeline(bag, _CAPACITY_BYTES)
    for topic, at, data in messages:
        while pipeline.waiting_bytes > _CAPACITY_BYTES - _ROOM_BYTES:
            time.sleep(0.0005)
        pipeline.put(topic, at, at, data)
    pipeline.close()
    if pipeline.dropped or pipeline.error:
        raise RuntimeError(f"expected everything written, found {pipeline.dropped} dropped, error {pipeline.error}")


def race(messages: list[Message], folder: Path, runs: int) -> tuple[list[float], list[float], float]:
    """Return seconds of ours and of the bare writer, run in turn, and CPU seconds of the bare writer."""
    topics = sorted({topic for topic, _, _ in messages})
    ours, bare, cpu = [], [], []
    for run in range(runs + 1):
        start, busy = time.perf_counter(), time.process_time()
        write_bare(messages, topics, folder / "bare.mcap")
        half, busy = time.perf_counter(), time.process_time() - busy
        write_ours(messages, topics, folder / "ours")
        end = time.perf_counter()
        shutil.rmtree(folder / "ours")
        if run:  # the first one warms up
            ours.append(end - half)
            bare.append(half - start)
            cpu.append(busy)
    return ours, bare, statistics.median(cpu)


# -- roles: processes of the live part -------------------------------------------------------------------------


def publish(kind: str, seconds: float) -> None:
    """Publish one kind at its rate once the recorder listens; prints ready, then how many."""
    import rclpy  # noqa: PLC0415  only the roles need it
    from rclpy.qos import HistoryPolicy, QoSProfile  # noqa: PLC0415  as above
    from sensor_msgs.msg import CompressedImage, JointState  # noqa: PLC0415  as above

    from softgrip_interfaces.msg import PredictedShape  # noqa: PLC0415  as above

    messages = serialized()[kind]
    types = {"joints": JointState, "image": CompressedImage, "shape": PredictedShape}
    rclpy.init()
    node = rclpy.create_node(f"publisher_{kind}")
    names = [f"joints_{index}" for index in range(JOINT_TOPICS)] if kind == "joints" else [kind]
    qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000)
    outputs = [node.create_publisher(types[kind], name, qos) for name in names]
    deadline = time.monotonic() + _DEADLINE_S
    while not all(output.get_subscription_count() for output in outputs) and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.02)
    print(READY, flush=True)
    sys.stdin.readline()
    start = time.monotonic()
    count = 0
    for turn in range(round(RATES_HZ[kind] * seconds)):
        time.sleep(max(0.0, start + turn / RATES_HZ[kind] - time.monotonic()))
        for output in outputs:
            output.publish(messages[turn % VARIANTS])
            count += 1
    took = time.monotonic() - start
    print(json.dumps({"sent": count, "seconds": took}), flush=True)
    sys.stdin.readline()
    node.destroy_node()
    rclpy.try_shutdown()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def live(folder: Path, seconds: float) -> tuple[int, int, float, float]:
    """Return messages sent, messages missing in the bag, the recorder's CPU share [%], and seconds it took."""
    environment = os.environ | {"ROS_DOMAIN_ID": DOMAIN, "EMBEDDED_ROUTER_PORT": str(_free_port())}
    bag = folder / "live"
    command = [sys.executable, "-m", "softgrip_bag.nodes.recorder", "--ros-args", "-p", f"root:={folder}"]
    recorder = subprocess.Popen([*command, "-p", f"path:={bag}"], env=environment, stderr=subprocess.DEVNULL)
    senders = [
        subprocess.Popen(
            [sys.executable, str(Path(__file__).resolve()), "--role", kind, "--seconds", str(seconds)],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for kind in RATES_HZ
    ]
    try:
        for sender in senders:
            if _line(sender) != READY:
                raise RuntimeError("expected a publisher to be ready")
        before = processor_s(recorder.pid)
        for sender in senders:
            _tell(sender)
        answers = [json.loads(_line(sender)) for sender in senders]
        share = 100.0 * (processor_s(recorder.pid) - before) / max(answer["seconds"] for answer in answers)
        for sender in senders:
            _tell(sender)
            sender.wait(_DEADLINE_S)
        _await_quiet(bag)
        recorder.send_signal(2)
        recorder.wait(_DEADLINE_S)
    finally:
        for process in (recorder, *senders):
            process.kill()
    sent, kept = sum(answer["sent"] for answer in answers), _kept(bag)
    shutil.rmtree(bag)
    return sent, sent - kept, share, max(answer["seconds"] for answer in answers)


def _kept(bag: Path) -> int:
    return sum(t.messages for t in topic_summaries(bag) if t.name.startswith(("/joints_", "/image", "/shape")))


def _await_quiet(bag: Path) -> None:
    """Wait until what was on its way to the recorder is on the disk: nothing more comes for a second."""
    before = -1
    while (found := _kept(bag)) != before:
        before = found
        time.sleep(1.0)


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def _tell(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()


# -- claims ------------------------------------------------------------------------------------------------------


def report(runs: int, seconds: float, folder: Path) -> None:
    """Measure and print the claims."""
    kinds = serialized()
    mix = traffic(kinds, seconds)
    images = traffic({"image": kinds["image"]}, seconds * 5)
    small = traffic({"joints": kinds["joints"]}, seconds)
    bare_cpu = 0.0
    for name, unit, messages, amount, goal in (
        ("throughput", "MB/s", mix, sum(len(m[2]) for m in mix) * 1e-6, None),
        ("image throughput", "MB/s", images, sum(len(m[2]) for m in images) * 1e-6, IMAGE_GOAL_MB_S),
        ("messages rate", "1/s", small, float(len(small)), None),
    ):
        ours, bare, cpu = race(messages, folder, runs)
        bare_cpu = bare_cpu or cpu
        claim(
            name,
            amount / statistics.median(ours),
            unit,
            better="higher",
            goal=goal or RATIO_GOAL * amount / statistics.median(bare),
            runs=runs,
            note=f"{len(messages)} messages, {sum(len(m[2]) for m in messages) * 1e-6:.0f} MB, callback to disk; ours "
            + spread(ours, "s")
            + "; peer "
            + spread(bare, "s"),
            peer=PEER,
            peer_value=amount / statistics.median(bare),
        )
    rounds = [live(folder, seconds) for _ in range(max(1, runs // 2))]
    sent = sum(item[0] for item in rounds)
    megabytes = sum(len(m[2]) for m in mix) * 1e-6 / seconds
    what = f"JointState 1 kHz x {JOINT_TOPICS}, 1280x720 JPEG 60 fps, 2,000-vertex shapes 60 Hz: {megabytes:.1f} MB/s"
    late = max(item[3] / seconds for item in rounds)
    claim(
        "dropped",
        float(sum(item[1] for item in rounds)),
        "1",
        better="lower",
        goal=0.0,
        runs=len(rounds),
        note=f"of {sent} messages of three processes at {what}; publishers took {late:.2f} of the time wanted",
    )
    claim(
        "CPU share",
        statistics.median(item[2] for item in rounds),
        "%",
        better="lower",
        goal=None,
        runs=len(rounds),
        note=f"of one processor, with middleware, which the peer has not; {spread([item[2] for item in rounds], '%')}, "
        + what,
        peer=PEER,
        peer_value=100.0 * bare_cpu / seconds,
    )


def main() -> int:
    """Measure, or play one role of the measurement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5, help="races per claim (default 5)")
    parser.add_argument("--seconds", type=float, default=4.0, help="of traffic per run (default 4)")
    parser.add_argument("--role", choices=sorted(RATES_HZ), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role:
        publish(options.role, options.seconds)
        return 0
    with tempfile.TemporaryDirectory(prefix="softgrip-recorder-") as folder:
        report(options.runs, options.seconds, Path(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
