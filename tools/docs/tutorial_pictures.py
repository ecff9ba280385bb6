# SPDX-License-Identifier: Apache-2.0
"""Types the blocks of tutorials as a reader does, and takes the pictures that they make into docs/images."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
from PIL import Image, ImageOps

mpl.use("Agg")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "pages"))

import blocks

ROOT = Path(__file__).resolve().parents[2]
#: Tutorial -> picture that it makes -> its name in docs/images.
PICTURES = {
    "close-a-finger": {"closing.png": "tutorial_closing.png"},
    "design-from-a-film": {"design/my_power.png": "tutorial_design.png"},
    "measure-friction": {"fits/fit.png": "tutorial_friction.png"},
    "simulate-a-shape": {"shapes/rest.png": "tutorial_beam.png"},
}


def main() -> int:
    """Write the pictures."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    for tutorial, pictures in PICTURES.items():
        with tempfile.TemporaryDirectory() as folder:
            blocks.Reader(Path(folder)).run(ROOT / f"docs/tutorials/{tutorial}.md")
            for made, name in pictures.items():
                path = ROOT / "docs/images" / name
                picture = Image.open(Path(folder) / made).convert("RGB")
                drawn = ImageOps.invert(picture).getbbox()  # without the white around it
                picture.crop(drawn).quantize(64).save(path, optimize=True)
                print(path.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
