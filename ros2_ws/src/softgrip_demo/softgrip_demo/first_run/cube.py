# SPDX-License-Identifier: Apache-2.0
"""The first thing that a new cell grasps: a cube that anybody can print, as a product of the catalogue."""

from __future__ import annotations

import time

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.finger_records import read_finger_records
from softgrip_cell.products import Fragility, GraspType, Product, ProductShape, ProductSurface, Recipe
from softgrip_cell.storage import Database, Library
from softgrip_design.parts.bench import CUBE_G, CUBE_MM

#: The part that `parts` makes, in PLA, which the thesis prints its palm of: weigh yours. The recipe is an orange's of
#: the shipped catalogue: with 18 N the emulated cell holds it 8 times of 8 (seeds 1 to 4, two places), with 8 and 14 N
#: 6 times.
TEST_CUBE = Product(
    "test_cube",
    "Test cube",
    GraspType.POWER,
    ProductShape.BALL,
    (1e-3 * CUBE_MM,) * 3,
    1e-3 * CUBE_G,
    ProductSurface.SMOOTH,
    Fragility.ROBUST,
    Recipe(18.0, 25.0, 0.020, 0.012),
)


def add_test_cube(database_url: str, who: str) -> None:
    """Put the cube into the database of a cell that does not run; an empty one is filled as the manager would.

    Raises:
        CellError: the database cannot be used.
    """
    database = Database(database_url)
    library = Library(database, time.time_ns)
    with database:
        if library.is_empty():
            library.import_catalogue(read_catalogue(), who)
            library.import_finger_records(read_finger_records().values(), who)
        if TEST_CUBE.id not in library.catalogue().products:
            library.save_product(TEST_CUBE, who)
