# SPDX-License-Identifier: Apache-2.0
"""What rosdistro has no key for: CMake takes what is installed, else its makers', by its hash, or does without."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WORKSPACE = ROOT / "ros2_ws" / "src"
MODEL, VENDOR = WORKSPACE / "softgrip_model", WORKSPACE / "softgrip_mcap_vendor"
#: As Highway's own CMakeLists.txt begins its tests (1.0.7, line 478): CTest turns BUILD_TESTING on where nobody set it.
HIGHWAY = """cmake_minimum_required(VERSION 3.10)
project(hwy LANGUAGES CXX)
option(HWY_FORCE_STATIC_LIBS "Ignore BUILD_SHARED_LIBS" OFF)
if(NOT HWY_FORCE_STATIC_LIBS)
  message(FATAL_ERROR "a shared library would have to be installed")
endif()
file(WRITE ${CMAKE_CURRENT_BINARY_DIR}/hwy.cc "void hwy() {}")
add_library(hwy STATIC ${CMAKE_CURRENT_BINARY_DIR}/hwy.cc)
include(CTest)
"""

needs_cmake = pytest.mark.skipif(not shutil.which("cmake") or not shutil.which("ninja"), reason="no CMake or Ninja")


def configured(source: Path, build: Path, *options: str) -> str:
    """Return the rules of a build folder; a failure shows what CMake said."""
    python = f"-DPython{3 if source == VENDOR else ''}_EXECUTABLE={sys.executable}"
    command = ["cmake", "-S", source, "-B", build, "-G", "Ninja", python, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return (build / "build.ninja").read_text()


@pytest.fixture
def highway(tmp_path: Path) -> str:
    """A stand-in for Highway's sources, so that nothing is fetched; the option that names it, and none is installed."""
    folder = tmp_path / "highway"
    folder.mkdir()
    (folder / "CMakeLists.txt").write_text(HIGHWAY)
    return f"-DFETCHCONTENT_SOURCE_DIR_HIGHWAY={folder}"


@needs_cmake
def test_an_installed_highway_is_taken(tmp_path: Path, highway: str) -> None:
    if not list(Path("/usr/include").glob("hwy/highway.h")):
        pytest.skip("no Highway is installed")
    rules = configured(MODEL, tmp_path / "build", "-DSOFTGRIP_TESTS_ONLY=ON", highway)
    assert re.search(r"/libhwy\.(so|a)", rules)
    assert "highway-build" not in rules


@needs_cmake
def test_without_highway_its_sources_are_built(tmp_path: Path, highway: str) -> None:
    rules = configured(
        MODEL, tmp_path / "build", "-DSOFTGRIP_TESTS_ONLY=ON", "-DCMAKE_DISABLE_FIND_PACKAGE_hwy=ON", highway
    )
    (links,) = re.findall(r"^build gdfe_tests: .*?\n\n", rules, re.MULTILINE | re.DOTALL)
    assert "highway-build/libhwy.a" in links
    assert "-fPIC" in re.findall(r"^build \S*hwy\.cc\.o: .*?\n\n", rules, re.MULTILINE | re.DOTALL)[0]


@needs_cmake
def test_highways_sources_bring_no_tests_into_a_wheel(tmp_path: Path, highway: str) -> None:
    pytest.importorskip("pybind11")
    import pybind11  # noqa: PLC0415  as above

    rules = configured(
        MODEL,
        tmp_path / "build",
        "-DSKBUILD=2",
        f"-Dpybind11_DIR={pybind11.get_cmake_dir()}",
        "-DCMAKE_DISABLE_FIND_PACKAGE_hwy=ON",
        highway,
    )
    assert "build gdfe/_core." in rules
    assert "gdfe_tests" not in rules


@needs_cmake
def test_without_metis_the_core_is_built_all_the_same(tmp_path: Path) -> None:
    rules = configured(MODEL, tmp_path / "build", "-DSOFTGRIP_TESTS_ONLY=ON", "-DMETIS_LIBRARY=")
    assert "build gdfe_tests:" in rules
    assert "SOFTGRIP_HAVE_METIS" not in rules
    assert "libmetis" not in rules


@needs_cmake
def test_installed_modules_are_left_alone(tmp_path: Path) -> None:
    for module in ("mcap", "zstandard", "lz4"):
        pytest.importorskip(module)
    configured(VENDOR, tmp_path / "build", f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'install'}")
    assert (tmp_path / "build/wanted.lock").read_text() == ""
    assert "site-packages" not in (tmp_path / "build/cmake_install.cmake").read_text()


@needs_cmake
def test_without_an_index_the_build_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pip")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(AssertionError, match=r"No matching distribution(?s:.*)PIP_FIND_LINKS=FOLDER"):
        configured(VENDOR, tmp_path / "build", "-DSOFTGRIP_VENDOR_ALL=ON")


def test_whatever_is_fetched_is_known_by_its_hash() -> None:
    calls = 0
    for path in [*WORKSPACE.rglob("CMakeLists.txt"), *WORKSPACE.rglob("*.cmake")]:
        if "build" in path.relative_to(WORKSPACE).parts:
            continue
        text = path.read_text()
        assert not re.search(r"file\(DOWNLOAD|ExternalProject|GIT_REPOSITORY|\bcurl\b|\bwget\b", text), path
        for call in re.findall(r"FetchContent_Declare\(([^)]*)\)", text):
            calls += 1
            assert re.search(r"URL_HASH SHA256=[0-9a-f]{64}$", call.strip()), f"{path}: {call}"
        for call in re.findall(r"-m pip [^)]*", text):
            calls += 1
            assert "--require-hashes" in call, f"{path}: {call}"
    assert calls == 2


def test_what_is_vendored_is_the_locked_version() -> None:
    lock, vendored = ((folder / "requirements.lock").read_text() for folder in (ROOT, VENDOR))
    entries = re.findall(r"^(\w+)==\S+ \\\n(?:    --hash=.*\n)+", vendored, re.MULTILINE)
    assert entries == ["lz4", "mcap", "zstandard"]
    for entry in re.split(r"^(?=\w)", vendored, flags=re.MULTILINE)[1:]:
        assert f"\n{entry}" in lock


@pytest.mark.long
@pytest.mark.timeout(2400)
@needs_cmake
def test_modules_that_pip_installed_write_and_read_bags(tmp_path: Path) -> None:
    """Fetches them from the index that pip is set up for."""
    folder = tmp_path / "install"
    configured(VENDOR, tmp_path / "build", "-DSOFTGRIP_VENDOR_ALL=ON", f"-DCMAKE_INSTALL_PREFIX={folder}")
    for command in (["--build"], ["--install"]):
        subprocess.run(["cmake", *command, tmp_path / "build"], check=True, capture_output=True, timeout=1200)
    site = folder / sysconfig.get_path("purelib", vars={"base": "", "platbase": ""}).lstrip("/")
    code = (
        "import lz4.frame, mcap, zstandard\n"
        f"assert all(one.__file__.startswith({str(folder)!r}) for one in (lz4.frame, mcap, zstandard)), lz4.__file__\n"
        "import pytest\n"
        "raise SystemExit(pytest.main(['-q', '-p', 'no:cacheprovider', '-p', 'no:xdist', 'test_writer.py', "
        "'test_chunk_data.py', 'test_mcap_stream.py', 'test_salvage.py']))"
    )
    path = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=WORKSPACE / "softgrip_bag" / "test",
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
