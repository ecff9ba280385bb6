# SPDX-License-Identifier: Apache-2.0
"""Grasps of a bag as a LeRobotDataset: frames against the bag as others read it, statistics against numpy."""

from __future__ import annotations

import json
import struct
from bisect import bisect_right
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from softgrip_bag.episode import TendonCommand, commanded
from softgrip_bag.errors import BagError
from softgrip_bag.nodes.commands import export
from softgrip_bag.nodes.recorded_episodes import recorded_episodes

pytest.importorskip("mcap_ros2")
pytest.importorskip("pyarrow")
from mcap_ros2.decoder import DecoderFactory
from pyarrow import parquet

from softgrip_bag.lerobot import IMAGE, write_lerobot

BAG = Path(__file__).resolve().parent / "bags" / "grasps"
RATE_HZ = 20


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lerobot") / "grasps"
    assert export.main(["--lerobot", str(folder), "--fps", str(RATE_HZ), str(BAG)]) == 0
    return folder


def episodes_of(folder: Path) -> list[dict]:
    return parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()


def frames_of(folder: Path) -> list[dict]:
    return parquet.read_table(folder / "data/chunk-000/file-000.parquet").to_pylist()


def recorded_states() -> tuple[list[int], list[list[float]]]:
    """Stamps and values of tendon/state, by a reader that is not ours."""
    rows = []
    with (BAG / "grasps_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages(topics=["/tendon/state"]):
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            rows.append((stamp, [*message.position, *message.effort]))
    rows.sort(key=lambda row: row[0])
    return [stamp for stamp, _ in rows], [values for _, values in rows]


def test_an_episode_is_a_grasp_with_its_verdict(dataset: Path) -> None:
    episodes, frames = episodes_of(dataset), frames_of(dataset)
    info = json.loads((dataset / "meta/info.json").read_text())
    assert [one["softgrip/outcome"] for one in episodes] == ["EMPTY", "GRIPPED", "SLIPPED", "TENDON_FAULT"]
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", RATE_HZ, 4)
    assert info["total_frames"] == len(frames) == sum(one["length"] for one in episodes)
    for one in episodes:
        own = frames[one["dataset_from_index"] : one["dataset_to_index"]]
        assert [frame["frame_index"] for frame in own] == list(range(one["length"]))
        assert {frame["episode_index"] for frame in own} == {one["episode_index"]}
        assert [frame["next.done"] for frame in own] == [False] * (one["length"] - 1) + [True]
        held = one["softgrip/outcome"] == "GRIPPED"
        assert sum(frame["next.reward"] for frame in own) == float(held)
        assert own[-1]["next.success"] is held


def test_a_frame_shows_the_last_state_at_its_time(dataset: Path) -> None:
    stamps, values = recorded_states()
    frames = frames_of(dataset)
    for episode in episodes_of(dataset):
        for frame in frames[episode["dataset_from_index"] : episode["dataset_to_index"]]:
            time_ns = episode["softgrip/start_ns"] + round(1e9 * frame["frame_index"] / RATE_HZ)
            at = bisect_right(stamps, time_ns) - 1
            assert frame["observation.state"] == pytest.approx(values[at], abs=1e-6)
            assert frame["observation.state_age_s"] == pytest.approx(1e-9 * (time_ns - stamps[at]), abs=1e-7)
            assert frame["timestamp"] == pytest.approx(frame["frame_index"] / RATE_HZ, abs=1e-6)


def test_statistics_are_those_of_the_columns(dataset: Path) -> None:
    stats = json.loads((dataset / "meta/stats.json").read_text())
    table = parquet.read_table(dataset / "data/chunk-000/file-000.parquet")
    for name in ("observation.state", "action", "next.reward"):
        values = np.array(table[name].to_pylist(), float).reshape(len(table), -1)
        assert stats[name]["count"] == [len(table)]
        for stat in ("min", "max", "mean", "std"):
            assert stats[name][stat] == pytest.approx(getattr(values, stat)(0), rel=1e-6, abs=1e-9)


def test_tasks_are_indexed_as_pandas_does(dataset: Path) -> None:
    schema = parquet.read_schema(dataset / "meta/tasks.parquet")
    assert json.loads(schema.metadata[b"pandas"])["index_columns"] == ["task"]
    assert "What is emulated" in (dataset / "README.md").read_text()


def test_commands_ramp_as_they_were_sent() -> None:
    # by hand: 10 mm at 20 mm/s from 2 mm at 0.1 s on, then 5 N
    times_ns = [round(1e9 * 0.1 * step) for step in range(8)]
    measured = np.full((8, 1), 0.002)
    moves = [TendonCommand(10**8, 0, 0.010, 0.020, 30.0), TendonCommand(6 * 10**8, 0, float("nan"), 0.01, 5.0)]
    length, tension = commanded(moves, times_ns, measured, 0.020)
    assert length[:, 0] == pytest.approx([0.002, 0.002, 0.004, 0.006, 0.008, 0.010, 0.020, 0.020])
    assert tension[:, 0].tolist() == [0, 30, 30, 30, 30, 30, 5, 5]


def test_images_are_the_bags_own_bytes(tmp_path: Path) -> None:
    picture = np.zeros((4, 6, 3), np.uint8)
    picture[..., 2] = 200  # OpenCV's red
    image = cv2.imencode(".png", picture)[1].tobytes()
    one = recorded_episodes(BAG, RATE_HZ)[0]
    count = len(one.times_ns)
    episode = replace(one, images=(image,) * count, image_stamps_ns=one.times_ns - 5_000_000)
    write_lerobot(tmp_path / "out", [episode], RATE_HZ)
    frames = frames_of(tmp_path / "out")
    assert {frame[IMAGE]["bytes"] for frame in frames} == {image}
    assert [frame["observation.image_age_s"] for frame in frames] == pytest.approx([0.005] * count)
    stats = json.loads((tmp_path / "out/meta/stats.json").read_text())[IMAGE]
    assert np.ravel(stats["mean"]) == pytest.approx([200 / 255, 0, 0])
    assert np.shape(stats["mean"]) == (3, 1, 1)
    with pytest.raises(BagError, match="new or empty"):
        write_lerobot(tmp_path / "out", [episode], RATE_HZ)
    with pytest.raises(BagError, match="found others"):
        write_lerobot(tmp_path / "mixed", [replace(episode, predicted_rad=np.zeros((count, 9))), episode], RATE_HZ)


def test_bags_without_episodes_are_named_and_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # a recorder's folder also has what it keeps of each fault
    without = [str(BAG.with_name(name)) for name in ("closings", "frames")]
    assert export.main(["--lerobot", str(tmp_path / "out"), *without, str(BAG)]) == 0
    printed = capsys.readouterr()
    assert [line.split(":")[0] for line in printed.err.splitlines() if line] == without
    assert "4 episodes, 1 of them a success" in printed.out
    assert export.main(["--lerobot", str(tmp_path / "none"), *without]) == 2
    assert "found none in these bags" in capsys.readouterr().err


def test_an_image_that_claims_more_than_a_camera_has_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    png = bytearray(cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1].tobytes())
    png[16:24] = struct.pack(">II", 60_000, 60_000)  # 11 GB of pixels
    whole = recorded_episodes(BAG, RATE_HZ)[0]
    images = (bytes(png),) * len(whole.times_ns)
    bomb = replace(whole, images=images, image_stamps_ns=whole.times_ns)
    with pytest.raises(BagError, match="32000000 pixels at most, found 60000x60000"):
        write_lerobot(tmp_path / "set", [bomb], RATE_HZ)
