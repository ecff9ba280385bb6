# SPDX-License-Identifier: Apache-2.0
"""An archive in S3, by its own wire protocol: moto's server on this machine, asked by s3fs, by DuckDB and by boto3."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from softgrip_bag.archive import Archive
from softgrip_bag.archive.store import bag_digest
from softgrip_bag.commands import query
from softgrip_bag.nodes.commands import archive as command
from softgrip_bag.nodes.digest import digest

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
    names = ("frames", "grasps")
    assert command.main([*(str(BAGS / name) for name in names), "--to", PLACE, *options]) == 0
    held = objects(bucket)
    for name in names:
        assert f"cells/manifest/{bag_digest(BAGS / name)}.json" in held
    (copy,) = [key for key in held if key.endswith("grasps_0.mcap")]
    body = bucket.get_object(Bucket="softgrip", Key=copy)["Body"].read()
    assert body == (BAGS / "grasps" / "grasps_0.mcap").read_bytes()
    # again: nothing changes, and nothing half-written stays behind
    assert command.main([str(BAGS / "frames"), "--to", PLACE, *options]) == 0
    assert objects(bucket) == held
    assert not any(key.endswith(".new") for key in held)
    capsys.readouterr()
    question = "SELECT outcome, count(*) AS n FROM grasps GROUP BY outcome ORDER BY outcome"
    assert query.main([question, "--in", PLACE, "--json", *options]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {row["outcome"]: row["n"] for row in rows} == Counter(one.outcome for one in digest(BAGS / "grasps").grasps)


def test_a_bucket_that_is_not_there_is_named(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([str(BAGS / "frames"), "--to", "s3://nobody/x", *options]) == 2
    assert "nobody" in capsys.readouterr().err


def test_an_archive_reads_manifests_through_s3(bucket: Any, endpoint: str) -> None:
    del bucket
    manifests = Archive(PLACE, {"endpoint_url": endpoint, "key": "key", "secret": "secret"}).manifests()
    assert {one["bag"] for one in manifests} == {"frames", "grasps"}
