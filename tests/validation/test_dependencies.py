# SPDX-License-Identifier: Apache-2.0
"""Nothing is used that package.xml does not declare: every import of a package's code, every library of its CMake."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml

from softgrip_bag import extras
from softgrip_description import ros2_control

ROOT = Path(__file__).resolve().parents[2]
WORKSPACE = ROOT / "ros2_ws" / "src"
PACKAGES = sorted(path.parent.name for path in WORKSPACE.glob("*/package.xml"))

#: Module -> rosdep key. Source: rosdep/python.yaml and rosdep/base.yaml of github.com/ros/rosdistro.
KEYS = {
    "cryptography": "python3-cryptography",
    "cv2": "python3-opencv",
    "dynamixel_sdk": "dynamixel_sdk",
    "gymnasium": "python3-gymnasium-pip",
    "hypothesis": "python3-hypothesis",
    "jinja2": "python3-jinja2",
    "lz4": "softgrip_mcap_vendor",
    "mcap": "softgrip_mcap_vendor",
    "meshio": "python3-meshio",
    "matplotlib": "python3-matplotlib",
    "mpl_toolkits": "python3-matplotlib",
    "numpy": "python3-numpy",
    "pytest": "python3-pytest",
    "rich": "python3-rich",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "sqlalchemy": "python3-sqlalchemy",
    "typing_extensions": "python3-typing-extensions",
    "yaml": "python3-yaml",
    "zstandard": "softgrip_mcap_vendor",
}
#: Modules that no distribution packages, or whose package is heavy: imported inside a function of the file named, which
#: says how to get them. File, module.
OPTIONAL = {
    ("softgrip_bag/lerobot.py", "pyarrow"),
    ("softgrip_bag/nodes/commands/archive.py", "pyarrow"),
    ("softgrip_bag/nodes/commands/export.py", "pyarrow"),
    ("softgrip_bag/rerun_file.py", "rerun"),
    ("softgrip_design/capture/detector.py", "mediapipe"),
    ("softgrip_design/parts/checks.py", "OCP"),
    ("softgrip_design/parts/checks.py", "manifold3d"),
    ("softgrip_design/parts/files.py", "lib3mf"),
    ("softgrip_design/parts/solid.py", "build123d"),
    ("softgrip_sweep/pools.py", "dask"),
    ("softgrip_sweep/pools.py", "distributed"),
    ("softgrip_testing/browser.py", "axe_selenium_python"),
    ("softgrip_testing/browser.py", "selenium"),
}
#: Folder, modules: what only the operator's page needs (softgrip_panel/nodes/panel.py says how to get them), and only
#: an archive (softgrip_bag/extras.py).
OPTIONAL_FOLDERS = {
    "softgrip_panel/web": {"fastapi", "nicegui", "segno", "starlette", "uvicorn"},
    "softgrip_bag/archive": {"duckdb", "fsspec", "pyarrow"},
}
#: CMake package or library -> rosdep key.
LIBRARIES = {
    "Eigen3": "eigen",
    "Python": "python3-dev",
    "Python3": "python3",
    "GTest": "gtest",
    "pybind11": "pybind11-dev",
}
#: What CMake does without where it is not found: by sources (hwy), or plainer; test_vendored.py configures it so.
#: OpenMP and threads come with the compiler.
WITHOUT_KEY = {"OpenMP", "Threads", "hwy", "metis"}
#: Namespace of a controller's type -> package that has it, where they differ. Source: ros2_controllers (branch jazzy),
#: parallel_gripper_controller/ros_control_plugins.xml.
CONTROLLERS_OF = {"parallel_gripper_action_controller": "parallel_gripper_controller"}
#: What the packages with a C++ core build with.
SHARED_CMAKE = WORKSPACE / "softgrip_cmake" / "cmake" / "softgrip_cmakeConfig.cmake"


def rosdistro() -> dict[str, set[str]]:
    """Return the names of rosdistro.txt: keys that install with apt, keys that install with pip, packages of Jazzy."""
    text = (Path(__file__).parent / "rosdistro.txt").read_text()
    return {kind: set(body.split()) for kind, body in re.findall(r"^\[(\w+)\]\n([^\[]*)", text, re.MULTILINE)}


ROSDISTRO = rosdistro()
#: Workbenches that bloom does not release: it takes no key that installs with pip.
NOT_RELEASED = {"softgrip_gym"}


def declared(package: str, *kinds: str) -> set[str]:
    root = ET.parse(WORKSPACE / package / "package.xml").getroot()
    return {element.text or "" for kind in kinds for element in root.iter(kind)}


def used_modules(package: str) -> dict[str, str]:
    """Return top-level module -> where it is imported at import time or later, of a package's own code."""
    found: dict[str, str] = {}
    for path in sorted((WORKSPACE / package / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            for name in names:
                top = name.split(".")[0]
                file = str(path.relative_to(WORKSPACE / package))
                extra = {
                    one for folder, modules in OPTIONAL_FOLDERS.items() if file.startswith(folder) for one in modules
                }
                if (file, top) not in OPTIONAL and top not in extra:
                    found.setdefault(top, f"{path.relative_to(ROOT)}:{node.lineno}")
    return found


def test_every_package_is_looked_at() -> None:
    assert len(PACKAGES) > 10


def named_by(package: str) -> set[str]:
    root = ET.parse(WORKSPACE / package / "package.xml").getroot()
    return {element.text or "" for element in root if element.tag.endswith("depend")}


def test_the_names_of_rosdistro_are_read() -> None:
    assert {kind: len(names) > 400 for kind, names in ROSDISTRO.items()} == {"apt": True, "pip": True, "jazzy": True}
    assert {"eigen", "python3-numpy"} <= ROSDISTRO["apt"]
    assert "python3-gymnasium-pip" in ROSDISTRO["pip"]
    assert "rclpy" in ROSDISTRO["jazzy"]
    assert not {"libhwy-dev", "python3-lz4"} & set.union(*ROSDISTRO.values())


@pytest.mark.parametrize("package", PACKAGES)
def test_every_key_exists(package: str) -> None:
    assert named_by(package) - set(PACKAGES) - set.union(*ROSDISTRO.values()) == set()


@pytest.mark.parametrize("package", sorted(set(PACKAGES) - NOT_RELEASED))
def test_what_is_released_needs_no_pip(package: str) -> None:
    """Dependencies of tests count: bloom makes them build dependencies of the Debian package."""
    assert named_by(package) & (ROSDISTRO["pip"] | NOT_RELEASED) == set()


@pytest.mark.parametrize("package", PACKAGES)
def test_every_import_is_declared(package: str) -> None:
    keys = declared(package, "depend", "exec_depend")
    missing = [
        f"{where}: imports {module}; expected <exec_depend>{KEYS.get(module, module)}</exec_depend>"
        for module, where in used_modules(package).items()
        if module not in sys.stdlib_module_names
        and module != package
        and not module.startswith("_")
        and KEYS.get(module, module) not in keys
    ]
    assert missing == []


def imports_of_a_test(tree: ast.Module) -> dict[str, int]:
    """Return top-level module -> line of what a test file can not be collected without: not what it checks for."""
    found: dict[str, int] = {}
    checked: set[str] = set()
    for node in tree.body:
        checked |= {
            str(call.args[0].value).split(".")[0]
            for call in ast.walk(node)
            if isinstance(call, ast.Call) and ast.unparse(call.func) == "pytest.importorskip"
            and isinstance(call.args[0], ast.Constant)
        }  # fmt: skip
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
        for top in {name.split(".")[0] for name in names} - checked - {*sys.stdlib_module_names, "__future__"}:
            found.setdefault(top, node.lineno)
    return found


TEST_FOLDERS = [*sorted(path for path in WORKSPACE.glob("*/test")), ROOT / "tests"]


@pytest.mark.parametrize("folder", TEST_FOLDERS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_import_of_a_test_is_declared_or_checked_for(folder: Path) -> None:
    """What rosdep installs is enough to collect every test; what it has no key for is skipped."""
    kinds = ("depend", "exec_depend", "test_depend")
    packages = [folder.parent.name] if folder.parent.name in PACKAGES else PACKAGES
    keys = {key for package in packages for key in declared(package, *kinds)}
    beside = {path.stem for path in folder.rglob("*.py")}
    missing = [
        f"{path.relative_to(ROOT)}:{line}: imports {module}; expected its key as test_depend, or pytest.importorskip"
        for path in sorted(folder.rglob("*.py"))
        for module, line in imports_of_a_test(ast.parse(path.read_text())).items()
        # packages of this workspace are built together; a test_depend on those for tests would close a circle
        if module not in PACKAGES and module not in beside and KEYS.get(module, module) not in keys
    ]
    assert missing == []


def test_what_every_test_needs_is_declared() -> None:
    """conftest.py takes hypothesis, pyproject.toml has a time-out: every package with tests says so."""
    for folder in TEST_FOLDERS[:-1]:
        assert {"python3-pytest", "python3-pytest-timeout", "python3-hypothesis"} <= declared(
            folder.parent.name, "test_depend"
        ), folder


def started(value: Any) -> Iterator[str]:
    """Yield the packages whose programs, files or plugins a launch file or a file of controllers names."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key in {"pkg", "type"} and isinstance(inner, str):
                yield CONTROLLERS_OF.get(inner.split("/")[0], inner.split("/")[0])
            yield from started(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from started(inner)
    elif isinstance(value, str):
        yield from re.findall(r"\$\((?:find-pkg-share|exec-in-pkg \w+) (\w+)\)", value)


def test_what_launch_files_start_is_declared() -> None:
    bringup = WORKSPACE / "softgrip_bringup"
    files = [*bringup.glob("launch/*.launch.yaml"), *bringup.glob("controllers/*.yaml")]
    named = {one for path in files for one in started(yaml.safe_load(path.read_text()))}
    assert {"rviz2", "controller_manager", "parallel_gripper_controller", "softgrip_description"} <= named
    # the hardware that the description names, the transport of the picture that RViz shows
    named |= {ros2_control._PLUGIN.split("/")[0], "compressed_image_transport"}
    assert named - {"softgrip_bringup"} - declared("softgrip_bringup", "depend", "exec_depend") == set()


DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
#: What the image takes from apt by its name: no package.xml has a key for it, or none of them needs it.
ONLY_IN_THE_IMAGE = {
    "libhwy-dev", "libmetis-dev", "python3-lz4", "python3-pip", "python3-psycopg2", "python3-zstandard",
    "ros-jazzy-rmw-cyclonedds-cpp", "ros-jazzy-rmw-zenoh-cpp",
}  # fmt: skip


def test_the_image_has_what_package_xml_declares_and_little_else() -> None:
    text = DOCKERFILE.replace("\\\n", " ")
    by_name = {
        word for words in re.findall(r"apt-get install ([^&\n]*)", text) for word in words.split() if word[0] != "-"
    }
    assert by_name == ONLY_IN_THE_IMAGE
    (install,) = re.findall(r"rosdep install ([^&\n]*)", text)
    assert "--from-paths src --ignore-src" in install
    assert set(re.findall(r"-t (\w+)", install)) == {"buildtool", "build", "exec"}


def test_what_the_image_does_not_take_by_rosdep_it_pins_or_does_without() -> None:
    text = DOCKERFILE.replace("\\\n", " ")
    (skipped,) = (set(found.split()) for found in re.findall(r'--skip-keys "([^"]*)"', text))
    used = {key for package in PACKAGES for key in declared(package, "exec_depend")}
    assert skipped <= used
    pinned = set(re.findall(r"wanted = /\^\(([a-z|]+)\)==", text)[0].split("|"))
    assert pinned == {"mcap", *extras.MODULES}
    # none of a cell's own nodes: only what the two launch files for RViz and ros2_control start
    assert skipped - ROSDISTRO["pip"] <= declared("softgrip_bringup", "exec_depend")


def found_by_shared_functions(text: str) -> set[str]:
    """Return what the shared CMake functions find for a package that calls them in `text`."""
    found: set[str] = set()
    for name, body in re.findall(
        r"^(?:function|macro)\((\w+)(.*?)^end", SHARED_CMAKE.read_text(), re.DOTALL | re.MULTILINE
    ):
        if f"{name}(" in text:
            found |= set(re.findall(r"find_package\((\w+)", body))
    return found if "PYTEST" in text else found - {"ament_cmake_pytest"}


def test_the_shared_cmake_functions_are_read() -> None:
    assert {"Eigen3", "pybind11", "ament_cmake"} <= found_by_shared_functions("softgrip_setup()")
    assert "GTest" in found_by_shared_functions("softgrip_core_tests(plant test.cpp)")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_library_of_cmake_is_declared(package: str) -> None:
    text = "".join(
        path.read_text()
        for path in [WORKSPACE / package / "CMakeLists.txt", *(WORKSPACE / package / "src").rglob("*.cmake")]
        if path.is_file()
    )
    keys = declared(package, "depend", "build_depend", "buildtool_depend", "test_depend")
    found = set(re.findall(r"find_package\((\w+)", text)) | found_by_shared_functions(text)
    found |= set(re.findall(r"find_library\(\w+ (\w+)", text))
    found -= WITHOUT_KEY
    missing = [name for name in sorted(found) if LIBRARIES.get(name, name) not in keys]
    assert missing == []


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_can_go_into_an_index(package: str) -> None:
    """What bloom and the index ask for: a licence with its text, a maintainer, a description, one version for all."""
    folder = WORKSPACE / package
    root = ET.parse(folder / "package.xml").getroot()
    vendored = {"softgrip_mcap_vendor": ["MIT", "BSD-3-Clause"]}  # of what it installs
    assert [one.text for one in root.iter("license")] == ["Apache-2.0", *vendored.get(package, [])]
    assert (folder / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()
    assert "@" in root.find("maintainer").get("email")
    assert (root.findtext("description") or "").strip().endswith(".")
    assert re.fullmatch(r"\d+\.\d+\.\d+", root.findtext("version") or "")  # one for all: test_changelog.py
    for page in folder.rglob("*.md"):  # docs.ros.org has the package alone
        assert "](.." not in page.read_text(), page
