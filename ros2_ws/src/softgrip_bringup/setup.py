# SPDX-License-Identifier: Apache-2.0
"""Installs launch files, configuration and profiles into share/."""

from glob import glob

from setuptools import setup

PACKAGE = "softgrip_bringup"

setup(
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", glob("launch/*.yaml")),
        (f"share/{PACKAGE}/config", glob("config/*.yaml")),
        (f"share/{PACKAGE}/profiles", glob("profiles/*.yaml")),
    ],
)
