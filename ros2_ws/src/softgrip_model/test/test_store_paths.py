# SPDX-License-Identifier: Apache-2.0
"""An id of a friction model is a name, never a way out of the folder: the file that it leads to is really there."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from softgrip_model.friction.errors import ModelFileError
from softgrip_model.friction.published import published, published_ids
from softgrip_model.friction.store import ModelStore


@pytest.mark.parametrize("way", ["../outside", "inside/../../outside", "{absolute}"])
def test_a_model_outside_the_folder_is_unknown(tmp_path: Path, way: str) -> None:
    store = ModelStore(tmp_path / "models")
    (tmp_path / "models" / "inside").mkdir()
    store.add(replace(published(published_ids()[0]), id="outside"))
    shutil.move(tmp_path / "models" / "outside.yaml", tmp_path / "outside.yaml")
    model_id = way.format(absolute=tmp_path / "outside")
    assert (tmp_path / "models" / f"{model_id}.yaml").exists(), "the way leads to a model"
    with pytest.raises(ModelFileError, match="no friction model"):
        store.get(model_id)
    with pytest.raises(ModelFileError):
        store.activate(model_id)
