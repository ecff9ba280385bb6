# SPDX-License-Identifier: Apache-2.0
"""A part of a bag as a bag of its own: chosen topics, a stretch of time, and all that explains it."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path

from softgrip_bag.errors import BagError
from softgrip_bag.mcap_file import Attachment
from softgrip_bag.offers import OfferedQos
from softgrip_bag.reader import RawMessage, attachments, facts, read, topic_summaries
from softgrip_bag.schema_text import FindInterface, schema_text
from softgrip_bag.writer import BagWriter, Topic

#: Written again for each file.
_NOT_COPIED = "rosbag2"


def excerpt(
    bag: Path,
    to: Path,
    topics: Collection[str] | None = None,
    since: int = 0,
    until: int | None = None,
    instead: Mapping[str, Sequence[RawMessage]] | None = None,
    find: FindInterface | None = None,
    edit: Callable[[Attachment], Attachment] = lambda attachment: attachment,
) -> int:
    """Write a part of a bag; returns the number of messages.

    Latched messages from before ``since`` come along: without them nobody knows what was set up.

    Args:
        bag: to read.
        to: folder to create.
        topics: only these; None = all.
        since: [ns] by time of reception.
        until: [ns] by time of reception; None = the end.
        instead: topic -> messages in place of the recorded ones.
        find: where these have today's form: gives its definition; None = they have the bag's.
        edit: gives what to carry in place of an attached file.

    Raises:
        BagError: no bag, no MCAP, or no room to write.
    """
    chosen = [topic for topic in topic_summaries(bag) if topics is None or topic.name in topics]
    latched = {topic.name for topic in chosen if topic.latched}
    carried = facts(bag)
    carried.pop(_NOT_COPIED, None)
    part = BagWriter(to, carried)
    try:
        for attachment in attachments(bag):
            part.attach(edit(attachment))
        for topic in chosen:
            offers = tuple(OfferedQos.from_map(offer) for offer in topic.qos)
            schema = schema_text(topic.type_name, find) if find and topic.name in (instead or {}) else topic.schema
            part.add_topic(Topic(topic.name, topic.type_name, topic.type_hash, schema, offers))
        for message in _merged(bag, {topic.name for topic in chosen}, instead or {}):
            if until is not None and message.received > until:
                break
            if message.received >= since or message.topic in latched:
                part.write(message.topic, message.received, message.published, message.data)
        part.close()
    except OSError as error:
        part.abandon()
        raise BagError(f"{to}: cannot be written: {error.strerror}") from error
    return part.messages


def _merged(bag: Path, topics: set[str], instead: Mapping[str, Sequence[RawMessage]]) -> Iterator[RawMessage]:
    others = (message for topic in topics & instead.keys() for message in instead[topic])
    recorded = read(bag, topics - instead.keys())
    return heapq.merge(recorded, sorted(others, key=_received), key=_received)


def _received(message: RawMessage) -> int:
    return message.received
