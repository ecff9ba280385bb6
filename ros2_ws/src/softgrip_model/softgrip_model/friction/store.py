# SPDX-License-Identifier: Apache-2.0
"""A folder of friction models, beside those that were published."""

from __future__ import annotations

from pathlib import Path

from softgrip_model.durable import make_folder_durably, write_durably
from softgrip_model.friction.errors import ModelFileError
from softgrip_model.friction.model_file import read_model, write_model
from softgrip_model.friction.published import published, published_ids
from softgrip_model.friction.record import ID_PATTERN, FrictionModel

_ACTIVE = "active"


class ModelStore:
    """Models by id, in one folder; the published ones are always there too.

    Args:
        folder: made when missing.
    """

    def __init__(self, folder: Path) -> None:
        make_folder_durably(folder)
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
        if not ID_PATTERN.fullmatch(model_id) or not path.is_file():
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
            OSError: the disk refused.
        """
        if model.id in self.ids():
            raise ModelFileError(f"expected a new id, found '{model.id}', which is taken")
        write_model(model, self._folder / f"{model.id}.yaml")

    @property
    def active(self) -> str:
        """Id of the model that was chosen last; empty when none was.

        Raises:
            ModelFileError: the file that says so is damaged. It does not stand for "none".
        """
        path = self._folder / _ACTIVE
        if not path.exists():
            return ""
        content = path.read_text(encoding="utf-8", errors="replace").strip()
        if not ID_PATTERN.fullmatch(content):
            raise ModelFileError(
                f"{path}: expected the id of the active friction model, found {content!r}; write one of "
                f"{', '.join(self.ids())} into it, or remove it to go back to the initial model"
            )
        return content

    def activate(self, model_id: str) -> FrictionModel:
        """Choose a model, also for the next start.

        Raises:
            ModelFileError: unknown id or damaged file.
            OSError: the disk refused; the choice is the one before, or this one.
        """
        model = self.get(model_id)
        write_durably(self._folder / _ACTIVE, f"{model_id}\n".encode())
        return model
