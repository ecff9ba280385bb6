# SPDX-License-Identifier: Apache-2.0
"""Grasp products with every finger set on the emulated hand, as fast as the computer can, without nodes."""

from softgrip_emulator.plant.grasp import GraspState
from softgrip_emulator.plant.manual_grasp import HandPulledCell
from softgrip_model.profile import load_directory, shipped_directory

TENSION_N = 14.0


def main(products: tuple[str, ...] = ("egg", "orange", "grape")) -> dict[tuple[str, str], GraspState]:
    """Return what became of each product in each finger set."""
    profiles, found = load_directory(shipped_directory()), {}
    for product in products:
        for finger_set in ("power", "pinch", "hook"):
            cell = HandPulledCell(profiles, finger_set, seed=1)
            cell.place(product)
            state = cell.close(TENSION_N)
            word = "crushed" if state.crushed else "held" if state.held else "slipped" if state.slipped else "missed"
            force = sum(state.contact_forces_n)
            print(f"{product:8} {finger_set:6} {word:8} pressed with {force:.1f} N")
            found[product, finger_set] = state
    return found


if __name__ == "__main__":
    main()
