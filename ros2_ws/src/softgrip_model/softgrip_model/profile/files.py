# SPDX-License-Identifier: Apache-2.0
"""Profiles as YAML files: strict reading (unknown and missing keys are errors), writing that reads back equal."""

from __future__ import annotations

import dataclasses
import os
import sys
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from softgrip_model.durable import write_durably
from softgrip_model.profile.schema import SCHEMA, Profile, ProfileError, problems

#: libyaml's where PyYAML was built with it: several times as fast, and each node reads all profiles at its start.
_Loader: type[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load(path: Path) -> Profile:
    """Read and validate one profile file.

    Raises:
        ProfileError: the file is missing, is not YAML, or does not describe a sound finger set.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ProfileError(f"{path}: cannot be read as a profile: {error}") from error
    try:
        return loads(text)
    except ProfileError as error:
        raise ProfileError(f"{path}: {error}") from error


def loads(text: str) -> Profile:
    """Read and validate a profile from YAML text.

    Raises:
        ProfileError: see `load`.
    """
    try:
        data = yaml.load(text, _Loader)  # noqa: S506  safe as well
    except yaml.YAMLError as error:
        raise ProfileError(f"not YAML: {error}") from error
    if not isinstance(data, dict):
        raise ProfileError(f"expected a mapping with 'schema: {SCHEMA}', found {type(data).__name__}")
    if data.get("schema") != SCHEMA:
        raise ProfileError(
            f"schema: this version reads schema {SCHEMA}, found {data.get('schema')!r}; write the profile again"
        )
    profile: Profile = _build(Profile, data, "")
    validate(profile)
    return profile


def validate(profile: Profile) -> None:
    """Check a profile made in memory.

    Raises:
        ProfileError: lists everything that is wrong with it.
    """
    found = problems(profile)
    if found:
        raise ProfileError("\n  ".join([f"profile {profile.id!r} cannot be used:", *found]))


def dumps(profile: Profile) -> str:
    """The profile as YAML text; `loads` gives an equal value."""
    return yaml.safe_dump(_plain(profile), sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)


def save(profile: Profile, path: Path) -> None:
    """Validate and write a profile.

    Raises:
        ProfileError: the profile is not sound; nothing is written.
        OSError: the disk refused; the file is the old one or the new one, whole.
    """
    validate(profile)
    write_durably(path, dumps(profile).encode())


def load_directory(directory: Path) -> dict[str, Profile]:
    """All profiles of a folder, by id.

    Raises:
        ProfileError: no such folder, no profile in it, a bad file, an id that is not the file's name.
    """
    paths = sorted(directory.glob("*.yaml"))
    if not paths:
        raise ProfileError(f"{directory}: expected a folder with profiles (*.yaml), found none")
    profiles = {}
    for path in paths:
        profile = load(path)
        if profile.id != path.stem:
            raise ProfileError(f"{path}: id: expected {path.stem!r} as the file's name says, found {profile.id!r}")
        profiles[profile.id] = profile
    return profiles


def _plain(value: object) -> object:
    """A value of the schema as YAML's own types; (name, value) pairs become mappings."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, tuple):
        if value and all(isinstance(item, tuple) and len(item) == 2 and isinstance(item[0], str) for item in value):
            return {name: _plain(item) for name, item in value}
        return [_plain(item) for item in value]
    return value


def _build(kind: Any, data: Any, where: str) -> Any:
    """`data` from YAML as a value of the schema's type `kind`; `where` is the key's path for messages."""
    if dataclasses.is_dataclass(kind):
        return _build_dataclass(kind, data, where)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is tuple:
        return _build_tuple(arguments, data, where)
    if origin is types.UnionType:
        return None if data is None else _build(arguments[0], data, where)
    if kind is float:
        is_number = isinstance(data, int | float) and not isinstance(data, bool)
        if not is_number or abs(data) > sys.float_info.max:
            raise ProfileError(f"{where}: expected a number, found {data!r}{_number_hint(data)}")
        return float(data)
    if not isinstance(data, kind) or isinstance(data, bool):
        raise ProfileError(f"{where}: expected {kind.__name__}, found {data!r}")
    return data


def _number_hint(data: object) -> str:
    is_scientific = isinstance(data, str) and "e" in data.lower() and any(c.isdigit() for c in data)
    return " (YAML reads exponents only as in 1.0e+6)" if is_scientific else ""


def _build_dataclass(kind: Any, data: Any, where: str) -> Any:
    prefix = f"{where}." if where else ""
    if not isinstance(data, dict):
        raise ProfileError(f"{where}: expected a mapping, found {data!r}")
    hints = typing.get_type_hints(kind)
    unknown = sorted(str(key) for key in data if key not in hints)
    optional = {field.name for field in dataclasses.fields(kind) if field.default is not dataclasses.MISSING}
    missing = sorted(key for key in hints if key not in data and key not in optional)
    if unknown or missing:
        raise ProfileError(
            f"{where or 'profile'}: missing keys {missing}, unknown keys {unknown}; it has {sorted(hints)}"
        )
    return kind(**{key: _build(hint, data[key], f"{prefix}{key}") for key, hint in hints.items() if key in data})


def _build_tuple(arguments: tuple[object, ...], data: object, where: str) -> object:
    item = arguments[0]
    if typing.get_origin(item) is tuple:  # (name, value) pairs, a mapping in YAML
        value_kind: object = typing.get_args(item)[1]
        if not isinstance(data, dict):
            raise ProfileError(f"{where}: expected a mapping, found {data!r}")
        return tuple(
            (_build(str, key, where), _build(value_kind, value, f"{where}.{key}")) for key, value in data.items()
        )
    if not isinstance(data, list):
        raise ProfileError(f"{where}: expected a list, found {data!r}")
    if arguments[-1] is not Ellipsis and len(data) != len(arguments):
        raise ProfileError(f"{where}: expected {len(arguments)} values, found {len(data)}")
    return tuple(_build(item, value, f"{where}[{i}]") for i, value in enumerate(data))


def load_profiles(directory: str = "") -> dict[str, Profile]:
    """Return the profiles that a parameter names: of a folder, or where it is empty those of softgrip_bringup.

    Raises:
        ProfileError: there are none, or one of them cannot be used.
    """
    return load_directory(Path(directory) if directory else shipped_directory())


def mounting_of(fingers: Sequence[str], profiles: Sequence[str]) -> dict[str, str]:
    """Return slot -> profile id from a node's parameters `fingers` and `profiles`.

    Args:
        fingers: slots.
        profiles: the profile in each of them, or one for all.

    Raises:
        ProfileError: another number of profiles.
    """
    each = list(profiles) * len(fingers) if len(profiles) == 1 else list(profiles)
    if len(each) != len(fingers):
        raise ProfileError(f"parameter 'profiles': expected 1 or {len(fingers)} for {list(fingers)}, found {each}")
    return dict(zip(fingers, each, strict=True))


def shipped_directory() -> Path:
    """Return the folder of softgrip_bringup's profiles: of an installed workspace, beside this source, or in the wheel.

    Raises:
        ProfileError: neither is there.
    """
    installed = [
        Path(prefix) / "share" for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix
    ]
    here = Path(__file__).resolve()
    places = [share / "softgrip_bringup" for share in (*installed, here.parents[3])]
    for directory in (place / "profiles" for place in (*places, here.parents[1])):
        if directory.is_dir():
            return directory
    raise ProfileError("the profiles of softgrip_bringup were not found; source the workspace or name a folder")
