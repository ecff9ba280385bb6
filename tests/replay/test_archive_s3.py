# SPDX-License-Identifier: Apache-2.0
"""An archive in S3, by its own wire protocol: moto's server on this machine, asked by s3fs, by DuckDB and by boto3."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from softgrip_bag.commands import query
from softgrip_bag.nodes.commands import archive as command
from softgrip_bag.reader import bag_digest

pytest.importorskip("duckdb")
pytest.importorskip("pyarrow")
pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader

from softgrip_bag.archive import Archive

pytest.importorskip("s3fs", reason="make s3-setup")
boto3 = pytest.importorskip("boto3", reason="make s3-setup")
moto_server = pytest.importorskip("moto.server", reason="make s3-setup")


BAGS = Path(__file__).parent / "bags"
PLACE = "s3://softgrip/cells"
KEYS = {"aws_access_key_id": "key", "aws_secret_access_key": "secret"}


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture(scope="module")
def bucket(endpoint: str) -> Any:
    client = boto3.client("s3", endpoint_url=endpoint, region_name="us-east-1", **KEYS)
    client.create_bucket(Bucket="softgrip")
    return client


@pytest.fixture(scope="module")
def options(endpoint: str) -> list[str]:
    return [
        f"--option={name}={value}" for name, value in (("endpoint_url", endpoint), ("key", "key"), ("secret", "secret"))
    ]


def objects(bucket: Any) -> dict[str, str]:
    """Return what the server holds, key -> digest, as boto3 reads it."""
    found = bucket.list_objects_v2(Bucket="softgrip")
    return {one["Key"]: one["ETag"] for one in found.get("Contents", [])}


def test_bags_go_to_s3_and_are_asked_there(bucket: Any, options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([str(BAGS / "frames"), "--to", PLACE, *options]) == 0
    held = objects(bucket)
    assert f"cells/manifest/{bag_digest(BAGS / 'frames')}.json" in held
    (copy,) = [key for key in held if key.endswith("frames_0.mcap")]
    body = bucket.get_object(Bucket="softgrip", Key=copy)["Body"].read()
    assert body == (BAGS / "frames" / "frames_0.mcap").read_bytes()
    # again: nothing changes, and nothing half-written stays behind
    assert command.main([str(BAGS / "frames"), "--to", PLACE, *options]) == 0
    assert objects(bucket) == held
    assert not any(key.endswith(".new") for key in held)
    capsys.readouterr()
    question = "SELECT count(*) AS images, sum(data_length) AS bytes FROM camera_image_raw_compressed"
    assert query.main([question, "--in", PLACE, "--json", *options]) == 0
    with AnyReader([BAGS / "frames"]) as reader:
        images = [one for one in reader.connections if one.topic == "/camera/image_raw/compressed"]
        lengths = [len(reader.deserialize(data, one.msgtype).data) for one, _, data in reader.messages(images)]
    assert json.loads(capsys.readouterr().out) == {"images": len(lengths), "bytes": sum(lengths)}


def test_a_bucket_that_is_not_there_is_named(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([str(BAGS / "frames"), "--to", "s3://nobody/x", *options]) == 2
    assert "nobody" in capsys.readouterr().err


def test_an_archive_reads_manifests_through_s3(bucket: Any, endpoint: str) -> None:
    del bucket
    manifests = Archive(PLACE, {"endpoint_url": endpoint, "key": "key", "secret": "secret"}).manifests()
    assert [one["bag"] for one in manifests] == ["frames"]
