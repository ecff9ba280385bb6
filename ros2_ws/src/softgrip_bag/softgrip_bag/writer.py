# SPDX-License-Identifier: Apache-2.0
"""A bag on disk: MCAP files of raw CDR with everything needed to read them, and rosbag2's metadata.yaml beside them.

What was written is readable at the latest `FLUSH_INTERVAL` later, whatever happens to the process: chunks are
closed and handed to the disk by time as well as by size. Each file explains itself: topics, metadata records and
attachments are repeated in every one.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from softgrip_bag import metadata
from softgrip_bag.errors import BagError, DiskError
from softgrip_bag.mcap_file import Attachment, McapFile, Topic
from softgrip_bag.metadata import FileEntry, TopicEntry
from softgrip_model.durable import make_folder_durably, sync_folder
from softgrip_time.units import to_ns

__all__ = ["Attachment", "BagWriter", "FileLimits", "Topic"]

#: [s] longest time a message waits in memory.
FLUSH_INTERVAL = 0.25


#: [ns] the times that both MCAP (64 bits without sign) and ROS (64 bits with sign) can write.
STAMP_RANGE = (0, 2**63 - 1)


def clamp_stamp(time_ns: int) -> int:
    """Return the time that can be written next to one [ns since the epoch]."""
    return min(max(time_ns, STAMP_RANGE[0]), STAMP_RANGE[1])


@dataclass(frozen=True)
class FileLimits:
    """When a bag goes on in another file, and how many files it keeps; 0 = no limit.

    Attributes:
        file_bytes: [byte] size of a file.
        file_seconds: [s] length of a file, by time of reception.
        kept_files: the oldest file is deleted when there are more.
    """

    file_bytes: int = 0
    file_seconds: float = 0.0
    kept_files: int = 0


class BagWriter:
    """Writes one bag; not thread-safe.

    Args:
        folder: to be created; must not exist.
        facts: metadata records, name -> {key: value}, written at the start of each file.
        limits: of its files.

    Attributes:
        clamped_stamps: times that MCAP and ROS cannot write, taken for the nearest that they can.

    Raises:
        BagError: the folder is there.
        DiskError: it cannot be made.
    """

    def __init__(
        self, folder: Path, facts: dict[str, dict[str, str]] | None = None, limits: FileLimits | None = None
    ) -> None:
        self.folder = folder
        self._facts = dict(facts or {})
        self._limits = limits or FileLimits()
        self._attachments: dict[str, Attachment] = {}
        self.topics: dict[str, Topic] = {}
        self.clamped_stamps = 0
        self._closed: list[McapFile] = []
        self._opened: list[McapFile] = []  # and not deleted
        self._deleted: Counter[str] = Counter()  # topic -> messages that were in deleted files
        self._next_number = 0
        try:
            make_folder_durably(folder.parent)
            folder.mkdir()
            sync_folder(folder.parent)
            self._file = self._open()
        except FileExistsError:
            raise BagError(f"expected a new folder for the bag, found that {folder} exists: name another") from None
        except OSError as error:
            self.abandon()
            raise DiskError(
                f"cannot create the bag's folder {folder}: {error.strerror or error}; make room or name another folder"
            ) from error
        except BaseException:
            self.abandon()
            raise
        self._flushed = time.monotonic()

    @property
    def messages(self) -> int:
        """Messages written so far and still kept."""
        return sum(file.span.messages for file in {*self._closed, self._file})

    @property
    def stored(self) -> Counter[str]:
        """Topic -> messages in whole chunks of the files that are there."""
        return self._total([file for file in self._opened if file.path.exists()])

    @property
    def removed(self) -> Counter[str]:
        """Topic -> messages in files that were deleted because there were more than are kept."""
        return self._deleted + self._total([file for file in self._opened if not file.path.exists()])

    @property
    def path(self) -> Path:
        """The file being written."""
        return self._file.path

    def add_topic(self, topic: Topic) -> None:
        """Register a topic; once per name.

        Raises:
            RecordRefusedError: there are as many as a file can have; messages of it are refused.
        """
        self._file.add_topic(topic)
        self.topics[topic.name] = topic

    def add_fact(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record, here and in the files to come."""
        self._facts[name] = values
        self._file.add_metadata(name, values)

    def attach(self, attachment: Attachment) -> None:
        """Carry a file, here and in the files to come."""
        self._attachments[attachment.name] = attachment
        self._file.add_attachment(attachment, time.time_ns())

    def write(self, topic: str, received: int, published: int, data: bytes) -> None:
        """Write one message; ``received`` and ``published`` [ns since the epoch], ``data`` CDR with its header.

        Raises:
            RecordRefusedError: no such topic.
        """
        times = clamp_stamp(received), clamp_stamp(published)
        self.clamped_stamps += times != (received, published)
        if self._full(times[0]):
            self.split()
        self._file.write(topic, *times, data)

    def flush_if_due(self) -> None:
        """Hand what is in memory to the disk when the flush interval has passed."""
        now = time.monotonic()
        if now - self._flushed >= FLUSH_INTERVAL:
            self._flushed = now
            self._file.flush()

    def split(self) -> Path:
        """Finish the present file and go on in a new one; returns the finished one."""
        done = self._file
        self._finish(done)
        self._file = self._open()
        while 0 < self._limits.kept_files < len(self._closed) + 1:
            self._delete(self._closed.pop(0))
        metadata.write(self.folder, self._information(self._closed))
        return done.path

    def close(self) -> Path:
        """Finish the file and write metadata.yaml; returns the bag's folder.

        Raises:
            BagError: the file's end does not say that all messages are in it.
        """
        self._finish(self._file)
        metadata.write(self.folder, self._information(self._closed))
        return self.folder

    def abandon(self) -> None:
        """Give up after an error: what is on the disk stays, each open file cut back to its last complete chunk."""
        for file in self._opened:
            file.abandon()

    def _full(self, received: int) -> bool:
        span, limits = self._file.span, self._limits
        if span.first is None:
            return False
        too_long = 0 < to_ns(limits.file_seconds) <= received - span.first
        return too_long or 0 < limits.file_bytes <= self._file.size

    def _open(self) -> McapFile:
        file = McapFile(self.folder / f"{self.folder.name}_{self._next_number}.mcap")
        self._next_number += 1
        self._opened.append(file)  # before it is open: `abandon` closes what is in this list
        file.open()
        for name, values in self._facts.items():
            file.add_metadata(name, values)
        for attachment in self._attachments.values():
            file.add_attachment(attachment, time.time_ns())
        for topic in self.topics.values():
            file.add_topic(topic)
        sync_folder(self.folder)
        return file

    def _delete(self, file: McapFile) -> None:
        file.path.unlink()
        self._opened.remove(file)
        self._deleted += file.stored

    def _finish(self, file: McapFile) -> None:
        own = yaml.dump(self._information([file]), Dumper=metadata.Plain)
        file.add_metadata("rosbag2", {"serialized_metadata": own})
        file.finish()
        self._closed.append(file)

    def _total(self, files: Sequence[McapFile]) -> Counter[str]:
        total: Counter[str] = Counter()
        for file in files:
            total += file.stored
        return total

    def _information(self, files: list[McapFile]) -> dict[str, object]:
        return metadata.information(
            [FileEntry(file.path.name, file.span) for file in files],
            [
                TopicEntry(
                    topic.name,
                    topic.type_name,
                    topic.type_hash,
                    [offer.as_map() for offer in topic.qos],
                    sum(file.counts[topic.name] for file in files),
                )
                for topic in self.topics.values()
            ],
        )
