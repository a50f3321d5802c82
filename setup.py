"""Builds the Python module dfr with CMake: only its dependencies, and optional parts if theirs are installed."""

import pathlib
import re
import subprocess
import sys

from skbuild import setup

HERE = pathlib.Path(__file__).parent.resolve()
# Dependencies of optional parts: component, its purpose, pkg-config's modules.
PARTS = (
    ("demonstrations", "load_demonstrations()", ("hdf5-serial", "libzstd", "snappy", "nlohmann_json")),
    ("experiment", "Experiment", ("CLI11", "nlohmann_json", "tomlplusplus")),
)


def found(module):
    try:
        return subprocess.run(["pkg-config", "--exists", module], check=False).returncode == 0
    except FileNotFoundError:
        return False


arguments = [
    "-DDFR_COMPONENTS=python",
    "-DDFR_BUILD_TESTS=OFF",
    "-DDFR_PYTHON_INSTALL_DIR=python",
]
without = []
for component, what, modules in PARTS:
    missing = [module for module in modules if not found(module)]
    if missing:
        print(f"dfr: without {what}, because pkg-config finds no {', '.join(missing)}", file=sys.stderr)
        without.append(component)
if without:
    arguments.append(f"-DDFR_WITHOUT={';'.join(without)}")

setup(
    name="dfr",
    version=re.search(r"project\(dfr VERSION (\S+)", (HERE / "CMakeLists.txt").read_text()).group(1),
    description="Run-time safety filter for policies learned from demonstrations",
    long_description=(HERE / "docs/python.md").read_text(),
    long_description_content_type="text/markdown",
    license="BSD-3-Clause",
    license_files=["LICENSE", "CITATION.cff"],
    python_requires=">=3.9",
    install_requires=["numpy>=1.22"],
    packages=["dfr"],
    package_dir={"": "python"},
    package_data={"dfr": ["py.typed", "*.pyi"]},
    cmake_args=arguments,
    cmake_install_target="install-python",
)
