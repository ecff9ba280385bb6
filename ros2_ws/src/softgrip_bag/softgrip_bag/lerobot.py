# SPDX-License-Identifier: Apache-2.0
"""Write episodes as a LeRobotDataset v3.0 (https://github.com/huggingface/lerobot, src/lerobot/datasets).

    meta/info.json, meta/stats.json, meta/tasks.parquet, meta/episodes/chunk-000/file-000.parquet
    data/chunk-000/file-000.parquet    a row a frame, a row group an episode
    README.md                          the data card

Images are the bag's own JPEGs in an image column: a video would encode them a second time, and lose their stamps.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray
from pyarrow import parquet

from softgrip_bag.episode import Episode
from softgrip_bag.errors import BagError
from softgrip_time.units import to_s
from softgrip_vision.encoded_image import decode
from softgrip_vision.errors import FrameError

VERSION: Final = "v3.0"
IMAGE: Final = "observation.images.camera"
#: A file of data takes the next episode until it has so many bytes (LeRobot's `data_files_size_in_mb`).
_FILE_MB: Final = 100
_CHUNK: Final = 1000
_QUANTILES: Final = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
#: Statistics of images are taken of at most so many frames an episode, evenly spread.
_SAMPLED_IMAGES: Final = 30

_TEMPLATES: Final = Environment(
    loader=PackageLoader("softgrip_bag"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
)

Stats = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class _Column:
    """One feature of the dataset: its form, and its values of one episode."""

    dtype: str
    names: tuple[str, ...]
    values: NDArray[Any]

    @property
    def feature(self) -> dict[str, Any]:
        """The entry of info.json."""
        return {"dtype": self.dtype, "shape": [len(self.names)], "names": list(self.names)}

    @property
    def arrow(self) -> pa.Array:
        """The values, (n,) of one name, else (n, k) as lists of fixed length."""
        flat = pa.array(self.values.ravel(), pa.type_for_alias({"bool": "bool"}.get(self.dtype, self.dtype)))
        return flat if len(self.names) == 1 else pa.FixedSizeListArray.from_arrays(flat, len(self.names))


def write_lerobot(folder: Path, episodes: Sequence[Episode], rate_hz: int) -> None:
    """Write a dataset.

    Args:
        folder: new or empty.
        episodes: at least one; all with the same counts of joints, all with images or none.
        rate_hz: of their frames.

    Raises:
        BagError: nothing to write, a folder that is not empty, or episodes that differ in what they have.
    """
    if not episodes:
        raise BagError("expected at least one grasp or demonstration that moved a tendon, found none in these bags")
    if folder.exists() and any(folder.iterdir()):
        raise BagError(f"{folder}: expected a new or empty folder, found files in it")
    tasks = list(dict.fromkeys(one.task for one in episodes))
    with_images = all(one.images for one in episodes)
    rows: list[dict[str, Any]] = []
    every: list[Stats] = []
    features: dict[str, Any] = {}
    frames = 0
    files = _DataFiles(folder)
    for number, episode in enumerate(episodes):
        columns = _columns(episode, number, frames, tasks.index(episode.task), rate_hz)
        found = {name: column.feature for name, column in columns.items()}
        if with_images:
            found[IMAGE] = _image_feature(episode.images[0])
        if features and features != found:
            raise BagError(
                f"{episode.bag}: expected grasps with the same fingers and images as those before, found others; "
                "export bags of one hand and camera at a time"
            )
        features = found
        place = files.write(columns, episode.images if with_images else ())
        stats = _stats(columns, episode.images if with_images else ())
        every.append(stats)
        rows.append(_episode_row(episode, number, frames, place, stats))
        frames += len(episode.times_ns)
    files.close()
    _write_json(folder / "meta/info.json", _info(features, len(episodes), frames, len(tasks), rate_hz))
    _write_json(folder / "meta/stats.json", _merged(every))
    _write_tasks(folder / "meta/tasks.parquet", tasks)
    _write_table(folder / "meta/episodes/chunk-000/file-000.parquet", pa.Table.from_pylist(rows))
    (folder / "README.md").write_text(_card(episodes, rate_hz, with_images=with_images), encoding="utf-8")


class _DataFiles:
    """The files of data/, one open at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._number, self._bytes = folder, -1, 0
        self._writer: Any = None

    def write(self, columns: Mapping[str, _Column], images: Sequence[bytes]) -> tuple[int, int]:
        """Write an episode as one row group; return chunk and file that it is in."""
        arrays = {name: column.arrow for name, column in columns.items()}
        if images:
            kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
            arrays[IMAGE] = pa.array([{"bytes": image, "path": None} for image in images], kind)
        table = pa.table(arrays)
        if self._writer is None or self._bytes > _FILE_MB << 20:
            self._open(table.schema)
        assert self._writer is not None, "a file has been opened"
        self._writer.write_table(table)
        self._bytes += table.nbytes
        return divmod(self._number, _CHUNK)

    def _open(self, schema: pa.Schema) -> None:
        self.close()
        self._number, self._bytes = self._number + 1, 0
        chunk, file = divmod(self._number, _CHUNK)
        path = self._folder / f"data/chunk-{chunk:03d}/file-{file:03d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        self._writer = parquet.ParquetWriter(path, schema)

    def close(self) -> None:
        """End the open file."""
        if self._writer is not None:
            self._writer.close()


def _columns(episode: Episode, number: int, first: int, task: int, rate_hz: int) -> dict[str, _Column]:
    count = len(episode.times_ns)
    last = np.arange(count) == count - 1
    state = np.hstack([episode.lengths_m, episode.tensions_n])
    action = np.hstack([episode.commanded_lengths_m, episode.commanded_tensions_n])
    both = (*(f"{slot}_length_m" for slot in episode.tendons), *(f"{slot}_tension_n" for slot in episode.tendons))
    columns = {
        "observation.state": _Column("float32", both, state.astype(np.float32)),
        "action": _Column("float32", both, action.astype(np.float32)),
    }
    for name, angles in (("predicted", episode.predicted_rad), ("measured", episode.measured_rad)):
        if angles.shape[1] > 1:
            names = tuple(f"joint_{joint}_rad" for joint in range(angles.shape[1]))
            columns[f"observation.joints_{name}"] = _Column("float32", names, angles.astype(np.float32))
    single = {
        "observation.state_age_s": ("float32", _ages_s(episode, episode.state_stamps_ns)),
        "next.reward": ("float32", (last & episode.is_success).astype(np.float32)),
        "next.done": ("bool", last),
        "next.success": ("bool", last & episode.is_success),
        "timestamp": ("float32", (np.arange(count) / rate_hz).astype(np.float32)),
        "frame_index": ("int64", np.arange(count)),
        "episode_index": ("int64", np.full(count, number)),
        "index": ("int64", first + np.arange(count)),
        "task_index": ("int64", np.full(count, task)),
    }
    if len(episode.image_stamps_ns):
        single["observation.image_age_s"] = ("float32", _ages_s(episode, episode.image_stamps_ns))
    if "observation.joints_measured" in columns:
        single["observation.measured_age_s"] = ("float32", _ages_s(episode, episode.measured_stamps_ns))
    return columns | {
        name: _Column(dtype, (name.rpartition(".")[2],), np.asarray(values)) for name, (dtype, values) in single.items()
    }


def _ages_s(episode: Episode, stamps_ns: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return how old what a frame shows was at the frame's time [s]; -1 where there was nothing yet."""
    return np.where(stamps_ns < 0, -1.0, to_s(episode.times_ns - stamps_ns)).astype(np.float32)


def _image_feature(image: bytes) -> dict[str, Any]:
    height, width, channels = _decoded(image).shape
    return {"dtype": "image", "shape": [height, width, channels], "names": ["height", "width", "channels"]}


def _decoded(image: bytes) -> NDArray[np.uint8]:
    try:
        return np.asarray(decode(image)[:, :, ::-1])
    except FrameError as error:
        raise BagError(f"camera/image_raw/compressed: {error}") from error


def _stats(columns: Mapping[str, _Column], images: Sequence[bytes]) -> Stats:
    found = {name: _stats_of(np.asarray(column.values, float).reshape(len(column.values), -1), len(column.values))
             for name, column in columns.items()}  # fmt: skip
    if images:
        chosen = np.linspace(0, len(images) - 1, min(len(images), _SAMPLED_IMAGES)).round().astype(int)
        pixels = np.concatenate([_decoded(images[index]).reshape(-1, 3) for index in chosen]) / 255.0
        of_images = _stats_of(pixels, len(chosen))
        found[IMAGE] = {
            name: value if name == "count" else [[[channel]] for channel in value] for name, value in of_images.items()
        }
    return found


def _stats_of(values: NDArray[np.float64], count: int) -> dict[str, Any]:
    stats = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    stats |= {name: np.quantile(values, share, axis=0) for name, share in _QUANTILES.items()}
    return {name: value.tolist() for name, value in stats.items()} | {"count": [count]}


def _merged(every: Sequence[Stats]) -> Stats:
    """Return the statistics of all episodes together; quantiles are the episodes' mean, as LeRobot merges them."""
    merged: Stats = {}
    for name in every[0]:
        parts = {stat: np.array([stats[name][stat] for stats in every], float) for stat in every[0][name]}
        counts = parts["count"].reshape(-1, *([1] * (parts["mean"].ndim - 1)))
        total = counts.sum()
        mean = (parts["mean"] * counts).sum(0) / total
        variance = ((parts["std"] ** 2 + (parts["mean"] - mean) ** 2) * counts).sum(0) / total
        stats = {"min": parts["min"].min(0), "max": parts["max"].max(0), "mean": mean, "std": np.sqrt(variance)}
        stats |= {quantile: (parts[quantile] * counts).sum(0) / total for quantile in _QUANTILES}
        merged[name] = {stat: value.tolist() for stat, value in stats.items()} | {"count": [int(total)]}
    return merged


def _episode_row(episode: Episode, number: int, first: int, place: tuple[int, int], stats: Stats) -> dict[str, Any]:
    row: dict[str, Any] = {
        "episode_index": number,
        "tasks": [episode.task],
        "length": len(episode.times_ns),
        "data/chunk_index": place[0],
        "data/file_index": place[1],
        "dataset_from_index": first,
        "dataset_to_index": first + len(episode.times_ns),
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        "softgrip/bag": episode.bag,
        "softgrip/start_ns": int(episode.times_ns[0]),
        "softgrip/product": episode.product,
        "softgrip/finger_set": episode.finger_set,
        "softgrip/outcome": episode.outcome,
        "softgrip/reason": episode.reason,
        "softgrip/evidence": episode.evidence,
    }
    return row | {f"stats/{name}/{stat}": value for name, found in stats.items() for stat, value in found.items()}


def _info(features: Mapping[str, Any], episodes: int, frames: int, tasks: int, rate_hz: int) -> dict[str, Any]:
    return {
        "codebase_version": VERSION,
        "robot_type": "softgrip",
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": _CHUNK,
        "data_files_size_in_mb": _FILE_MB,
        "video_files_size_in_mb": 200,
        "fps": rate_hz,
        "splits": {"train": f"0:{episodes}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": dict(features),
    }


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the tasks as pandas does with the task as index, which is how LeRobot looks them up."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": list(tasks)})
    column = {"metadata": None, "field_name": None}
    described = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            column | {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
            column | {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    _write_table(path, table.replace_schema_metadata({"pandas": json.dumps(described)}))


def _write_table(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(table, path)


def _write_json(path: Path, document: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=4) + "\n", encoding="utf-8")


def _card(episodes: Sequence[Episode], rate_hz: int, *, with_images: bool) -> str:
    """Return the data card: what this is, what is emulated, what the columns mean."""
    template = _TEMPLATES.get_template("lerobot_card.md.j2")
    return template.render(
        episodes=len(episodes),
        successes=sum(one.is_success for one in episodes),
        frames=sum(len(one.times_ns) for one in episodes),
        bags=sorted({one.bag for one in episodes}),
        rate_hz=rate_hz,
        with_images=with_images,
    )
