# SPDX-License-Identifier: Apache-2.0
"""Finger profiles: one YAML file describes the fingers of one set, as printed. All values in SI units."""

from softgrip_model.profile.files import (
    dumps,
    load,
    load_directory,
    load_profiles,
    loads,
    mounting_of,
    save,
    shipped_directory,
    validate,
)
from softgrip_model.profile.schema import (
    MOMENT_LAWS,
    SCHEMA,
    Cable,
    FingerDesign,
    Material,
    PathPoint,
    Profile,
    ProfileError,
    digest,
)

__all__ = [
    "MOMENT_LAWS",
    "SCHEMA",
    "Cable",
    "FingerDesign",
    "Material",
    "PathPoint",
    "Profile",
    "ProfileError",
    "digest",
    "dumps",
    "load",
    "load_directory",
    "load_profiles",
    "loads",
    "mounting_of",
    "save",
    "shipped_directory",
    "validate",
]
