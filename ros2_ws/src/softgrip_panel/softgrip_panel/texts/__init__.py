# SPDX-License-Identifier: Apache-2.0
"""All words of the pages, in one file a language: `en.yaml`; copy and translate it for another."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from softgrip_panel.errors import PanelError

FOLDER = Path(__file__).parent


class Texts:
    """The catalogue of one language.

    Args:
        language: name of a file beside this one, such as "en".

    Raises:
        PanelError: there is no such file, or it is not a catalogue.
    """

    def __init__(self, language: str = "en") -> None:
        known = sorted(path.stem for path in FOLDER.glob("*.yaml"))
        if language not in known:
            raise PanelError(f"language: expected one of {', '.join(known)}, found {language!r}")
        document = yaml.safe_load((FOLDER / f"{language}.yaml").read_text(encoding="utf-8"))
        self._texts = dict(_flat(document, ""))
        self.language = language

    def __call__(self, key: str, /, **values: object) -> str:
        """Return the text of a key with values filled in; a key that is not there is shown as it is."""
        text = self._texts.get(key)
        return key if text is None else text.format(**values) if values else text

    def has(self, key: str) -> bool:
        """Whether there is a text of a key."""
        return key in self._texts

    @property
    def keys(self) -> tuple[str, ...]:
        """All keys."""
        return tuple(self._texts)


class _Spoken:
    """The catalogue that this process speaks; English until it was told another."""

    texts: Texts | None = None


def speak(texts: Texts) -> None:
    """Let `say` use a catalogue from now on: one language a panel."""
    _Spoken.texts = texts


def say(key: str, /, **values: object) -> str:
    """Return the text of a key in the panel's language, for what the model and the gate have to say."""
    if _Spoken.texts is None:
        _Spoken.texts = Texts()
    return _Spoken.texts(key, **values)


def _flat(node: object, prefix: str) -> Mapping[str, str]:
    if not isinstance(node, dict):
        return {prefix: str(node)}
    found: dict[str, str] = {}
    for key, value in node.items():
        found |= _flat(value, f"{prefix}.{key}" if prefix else str(key))
    return found
