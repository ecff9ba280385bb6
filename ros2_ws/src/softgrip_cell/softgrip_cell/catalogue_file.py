# SPDX-License-Identifier: Apache-2.0
"""Catalogue files (YAML, schema 1): products and finger sets, in and out."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import yaml

from softgrip_cell.errors import CatalogueError
from softgrip_cell.products import (
    Catalogue,
    FingerSet,
    Fragility,
    GraspType,
    Product,
    ProductShape,
    ProductSurface,
    Recipe,
    TableMark,
)
from softgrip_cell.yaml_fields import Fields, checked_number, load

KIND = "softgrip_catalogue"
SCHEMA = 1

#: The catalogue that ships with the package.
SHIPPED = Path(__file__).parent / "data" / "catalogue.yaml"


def read_catalogue(path: Path = SHIPPED) -> Catalogue:
    """Read and check a catalogue file.

    Raises:
        CatalogueError: with the place in the file, what was expected and what was found.
    """
    fields = load(path, KIND, SCHEMA)
    sets = fields.mapping("finger_sets")
    finger_sets = {name: read_finger_set(name, sets.mapping(name)) for name in sets.names()}
    if not finger_sets:
        raise CatalogueError(f"{path}: expected at least one finger set, found none")
    entries = fields.mapping("products")
    products = {name: read_product(name, entries.mapping(name), set(finger_sets)) for name in entries.names()}
    fields.finish()
    return Catalogue(finger_sets=finger_sets, products=products)


def read_product(product_id: str, fields: Fields, finger_sets: set[str]) -> Product:
    """Read and check one product.

    Args:
        product_id: its key in the file.
        fields: its mapping.
        finger_sets: names that marks may use.
    """
    recipe = _recipe(fields.mapping("recipe"))
    own = fields.mapping("own_recipes") if fields.has("own_recipes") else Fields(f"{fields.where}.own_recipes", {})
    marks = fields.mapping("marks") if fields.has("marks") else Fields(f"{fields.where}.marks", {})
    product = Product(
        id=product_id,
        name=fields.text("name"),
        grasp=fields.choice("grasp", GraspType),
        shape=fields.choice("shape", ProductShape),
        size_m=_size(fields),
        mass_kg=fields.number("mass_kg", 0.0005, 5.0, "kg"),
        surface=fields.choice("surface", ProductSurface),
        fragility=fields.choice("fragility", Fragility),
        recipe=recipe,
        marks={name: marks.choice(name, TableMark) for name in marks.names()},
        own_recipes={name: _recipe(own.mapping(name), recipe) for name in own.names()},
        version=fields.count("version", 1) if fields.has("version") else 1,
    )
    for name, used in (("marks", product.marks), ("own_recipes", product.own_recipes)):
        unknown = sorted(set(used) - finger_sets)
        if unknown:
            raise CatalogueError(f"{fields.where}.{name}: expected finger sets {sorted(finger_sets)}, found {unknown}")
    fields.finish()
    return product


def product_document(product: Product) -> dict[str, object]:
    """Return a product as a plain mapping, the form that read_product reads."""
    return {
        "name": product.name,
        "grasp": product.grasp.value,
        "shape": product.shape.value,
        "size_m": list(product.size_m),
        "mass_kg": product.mass_kg,
        "surface": product.surface.value,
        "fragility": product.fragility.value,
        "recipe": asdict(product.recipe),
        "marks": {name: mark.value for name, mark in sorted(product.marks.items())},
        "own_recipes": {name: asdict(recipe) for name, recipe in sorted(product.own_recipes.items())},
        "version": product.version,
    }


def finger_set_document(finger_set: FingerSet) -> dict[str, object]:
    """Return a finger set as a plain mapping, the form that read_finger_set reads."""
    return {"grasp": finger_set.grasp.value, "profile": finger_set.profile}


def catalogue_text(catalogue: Catalogue) -> str:
    """Return a catalogue as the text of a YAML file that read_catalogue reads back to equal values."""
    document = {
        "schema": SCHEMA,
        "kind": KIND,
        "finger_sets": {name: finger_set_document(item) for name, item in catalogue.finger_sets.items()},
        "products": {name: product_document(product) for name, product in catalogue.products.items()},
    }
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True)


def read_finger_set(name: str, fields: Fields) -> FingerSet:
    """Read and check one finger set."""
    finger_set = FingerSet(id=name, grasp=fields.choice("grasp", GraspType), profile=fields.text("profile"))
    fields.finish()
    return finger_set


def _recipe(fields: Fields, base: Recipe | None = None) -> Recipe:
    """Read a recipe; where there is a base, fields that are not given are taken from it."""
    bounds = {
        "hold_contact_tension_n": (0.1, 40.0, "N"),
        "force_limit_n": (0.1, 100.0, "N"),
        "pull_limit_m": (0.001, 0.060, "m"),
        "closing_speed_m_per_s": (0.001, 0.100, "m/s"),
    }
    values = {
        name: getattr(base, name) if base is not None and not fields.has(name) else fields.number(name, *limits)
        for name, limits in bounds.items()
    }
    fields.finish()
    return Recipe(**values)


def _size(fields: Fields) -> tuple[float, float, float]:
    where = f"{fields.where}.size_m"
    value = fields.raw("size_m")
    if not isinstance(value, list) or len(value) != 3:
        raise CatalogueError(f"{where}: expected [length, width, height] in m, found {value!r}")
    length, width, height = (checked_number(where, item, 0.001, 1.0, "m") for item in value)
    if not length >= width >= height:
        raise CatalogueError(f"{where}: expected length >= width >= height, found {value!r}")
    return (length, width, height)
