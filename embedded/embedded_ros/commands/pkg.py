# SPDX-License-Identifier: Apache-2.0
"""``ros2 pkg``."""

from __future__ import annotations

import argparse

from embedded_ros import workspace


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    parser = argparse.ArgumentParser(prog="ros2 pkg", description="Look at the packages of the workspace.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    verbs.add_parser("list", help="output a list of available packages")
    prefix = verbs.add_parser("prefix", help="output the prefix path of a package")
    prefix.add_argument("package_name", help="name of the package")
    prefix.add_argument("--share", action="store_true", help="show the share folder (the same here: the source folder)")
    executables = verbs.add_parser("executables", help="output a list of package specific executables")
    executables.add_argument("package_name", nargs="?", help="name of the package; all when not given")
    executables.add_argument("--full-path", action="store_true", help="show module:function of each executable")
    xml = verbs.add_parser("xml", help="output the XML of the package manifest")
    xml.add_argument("package_name", help="name of the package")
    arguments = parser.parse_args(argv)
    packages = workspace.packages()
    if arguments.verb == "list":
        print("\n".join(sorted({*packages, *workspace.interface_folders()})))
        return None
    if arguments.package_name is not None and arguments.package_name not in packages:
        if arguments.verb == "executables":
            return f"Package '{arguments.package_name}' not found"
        return "Package not found"
    if arguments.verb == "prefix":
        print(packages[arguments.package_name].folder)
    elif arguments.verb == "xml":
        print((packages[arguments.package_name].folder / "package.xml").read_text(encoding="utf-8"))
    else:
        for name in [arguments.package_name] if arguments.package_name else sorted(packages):
            for script, target in sorted(packages[name].scripts):
                print(target if arguments.full_path else f"{name} {script}")
    return None
