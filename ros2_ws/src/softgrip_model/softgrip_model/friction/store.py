# SPDX-License-Identifier: Apache-2.0
"""A folder of friction models, beside those that were published."""

from __future__ import annotations

import os
from pathlib import Path

from softgrip_model.friction.errors import ModelFileError
from softgrip_model.friction.model_file import read_model, write_model
from softgrip_model.friction.published import published, published_ids
from softgrip_model.friction.record import FrictionModel

_ACTIVE = "active"


class ModelStore:
    """Models by id, in one folder; the published ones are always there too.

    Args:
        folder: made when missing.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder

    def ids(self) -> tuple[str, ...]:
        """Return all ids: measured ones first, then published ones."""
        return (*sorted(path.stem for path in self._folder.glob("*.yaml")), *published_ids())

    def get(self, model_id: str) -> FrictionModel:
        """Return one model.

        Raises:
            ModelFileError: unknown id (names those available) or damaged file.
        """
        if model_id in published_ids():
            return published(model_id)
        path = self._folder / f"{model_id}.yaml"
        if Path(model_id).name != model_id or not path.exists():
            raise ModelFileError(f"no friction model '{model_id}'; available: {', '.join(self.ids())}")
        return read_model(path)

    def readable(self) -> tuple[list[FrictionModel], list[str]]:
        """Return all models that can be read, and one problem per file that cannot."""
        models, problems = [], []
        for model_id in self.ids():
            try:
                models.append(self.get(model_id))
            except ModelFileError as error:
                problems.append(str(error))
        return models, problems

    def add(self, model: FrictionModel) -> None:
        """Keep a model.

        Raises:
            ModelFileError: its id is a published one's or is taken.
        """
        if model.id in self.ids():
            raise ModelFileError(f"expected a new id, found '{model.id}', which is taken")
        write_model(model, self._folder / f"{model.id}.yaml")

    @property
    def active(self) -> str:
        """Id of the model that was chosen last; empty when none was."""
        path = self._folder / _ACTIVE
        return path.read_text(encoding="utf-8").strip() if path.exists() else ""

    def activate(self, model_id: str) -> FrictionModel:
        """Choose a model, also for the next start.

        Raises:
            ModelFileError: unknown id or damaged file.
        """
        model = self.get(model_id)
        temporary = self._folder / f".{_ACTIVE}.{os.getpid()}"
        temporary.write_text(model_id + "\n", encoding="utf-8")
        temporary.replace(self._folder / _ACTIVE)
        return model
