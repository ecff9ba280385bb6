# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_description describe`: the hand with a finger set as URDF, xacro or MJCF, for static use."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_description.errors import HandError
from softgrip_description.hand import load_hand, shipped_hand
from softgrip_description.mjcf import mjcf_of
from softgrip_description.solids import base_outline, link_outline, prism_triangles, stl_of
from softgrip_description.urdf import MeshUri, urdf_of
from softgrip_description.xacro_macro import macro_of
from softgrip_model.finger import JointModel
from softgrip_model.profile import FingerDesign, ProfileError, load, shipped_directory

EPILOG = """examples:
  ros2 run softgrip_description describe power > hand.urdf
  ros2 run softgrip_description describe pinch --format mjcf --output hand.xml
  ros2 run softgrip_description describe my_fingers.yaml --format xacro --output my_fingers.urdf.xacro
  ros2 run softgrip_description describe my_fingers.yaml --hand my_hand.yaml --meshes meshes/ --output hand.urdf
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; exit code 1 with a reason when hand or profile cannot be used."""
    parser = _parser()
    options = parser.parse_args(args)
    if options.format == "xacro" and options.prefix:
        parser.error("--prefix: expected none with --format xacro, since it is a parameter of the macro; give it there")
    try:
        text = describe(options)
    except (HandError, ProfileError, OSError) as error:
        print(f"[describe] {error}", file=sys.stderr)
        return 1
    if options.output:
        options.output.write_text(text, encoding="utf-8")
        print(f"[describe] wrote {options.output}", file=sys.stderr)
    else:
        print(text, end="")
    return 0


def describe(options: argparse.Namespace) -> str:
    """Return the description that the options ask for; writes meshes beside it where asked to.

    Raises:
        HandError, ProfileError: hand or profile cannot be used.
    """
    hand = load_hand(options.hand) if options.hand else shipped_hand()
    profile = load(profile_path(options.profile))
    fingers = {slot: (profile.id, profile.finger(slot)) for slot in profile.slots}
    if options.format == "mjcf":
        model = JointModel(options.joint_model)
        return mjcf_of(hand, fingers, profile.material, prefix=options.prefix, joint_model=model)
    mesh_uri = _mesh_uri(options.meshes, {slot: design for slot, (_, design) in fingers.items()})
    if options.format == "xacro":
        return macro_of(hand, profile, mesh_uri=mesh_uri)
    return urdf_of(hand, fingers, prefix=options.prefix, mesh_uri=mesh_uri)


def _mesh_uri(meshes: Path | None, fingers: dict[str, FingerDesign]) -> MeshUri | None:
    if meshes is None:
        return None
    folder = meshes.resolve()
    write_meshes(folder, fingers)
    return lambda name: (folder / f"{name}.stl").as_uri()


def profile_path(name: str) -> Path:
    """Return the file of a profile: a path to one, or the id of a shipped one."""
    path = Path(name)
    if path.suffix in {".yaml", ".yml"} or path.exists():
        return path
    return shipped_directory() / f"{name}.yaml"


def write_meshes(folder: Path, fingers: dict[str, FingerDesign]) -> None:
    """Write the body of every link as ``<finger>_link_<j>.stl`` and ``<finger>_base.stl`` [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    for slot, design in fingers.items():
        outlines = {f"{slot}_link_{j}": link_outline(design, j) for j in range(design.joints)}
        outlines[f"{slot}_base"] = base_outline(design)
        for name, outline in outlines.items():
            if len(outline):
                (folder / f"{name}.stl").write_bytes(stl_of(prism_triangles(outline, design.width_m)))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="describe",
        description="Write the hand with a finger set as URDF (for RViz, MoveIt, Rerun), xacro macro or MJCF (MuJoCo).",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("profile", help="id of a shipped profile, or a profile file")
    parser.add_argument("--hand", type=Path, help="hand file (default: the shipped hand)")
    parser.add_argument("--format", choices=("urdf", "xacro", "mjcf"), default="urdf", help="default: %(default)s")
    parser.add_argument(
        "--joint-model",
        choices=[model.value for model in JointModel],
        default=JointModel.FLEXURE.value,
        help="mjcf: strips that bend, shorten and shear, or one hinge a joint, which is stepped faster; "
        "default: %(default)s",
    )
    parser.add_argument("--prefix", default="", help="before every link and joint name, for several hands in one tree")
    parser.add_argument("--meshes", type=Path, help="write STL meshes to this folder and refer to them (urdf, xacro)")
    parser.add_argument("--output", type=Path, help="file to write (default: standard output)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
