# SPDX-License-Identifier: Apache-2.0
"""Solve the whole shape of a closing finger, and compare its tip with the quick predictor's."""

import numpy as np

from softgrip_model.finger import Finger, JointModel, close
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.gdfe.closing import ClosingPath, ClosingSettings
from softgrip_model.gdfe.finger_mesh import RESOLUTIONS
from softgrip_model.profile import load_directory, shipped_directory


def main() -> list[tuple[float, float, float]]:
    """Return pulled length [mm] and the distance of both predictors' tips to the mesh's [mm]: hinges, flexures."""
    profile = load_directory(shipped_directory())["power"]
    shapes = ClosingPath(profile, "index", ClosingSettings(resolution=RESOLUTIONS["coarse"]))
    law, rows = assumed_friction(profile).law, []
    for pulled_mm in (4.0, 8.0, 12.0):
        shape = shapes.shape(1e-3 * pulled_mm)
        tips = (
            close(Finger.from_profile(profile, "index", model), law, [pulled_mm]).tip_mm[0, 0]
            for model in (JointModel.HINGE, JointModel.FLEXURE)
        )
        hinge, flexure = (float(np.hypot(*(tip - 1e3 * shape.tip[:2]))) for tip in tips)
        print(
            f"{pulled_mm:4.1f} mm: {shapes.hexahedra} hexahedra, {shape.tension[0]:.2f} N, largest strain "
            f"{shape.strain.max():.2f}; tips apart: hinges {hinge:.2f} mm, flexures {flexure:.2f} mm"
        )
        rows.append((pulled_mm, hinge, flexure))
    return rows


if __name__ == "__main__":
    main()
