"""Checks that every package and shared library that this build links has a row in third_party_licenses, and that the
row's packages bring their licence texts. A package without a licence text is rejected by name.

usage: licenses_test.py SOURCE_DIR BINARY_DIR
"""
import pathlib
import re
import subprocess
import sys

# Part of every Linux system: the C library and the loader (LGPL-2.1+), linked by every program.
SYSTEM = {"libc", "libm", "libpthread", "libdl", "librt", "ld-linux-x86-64", "ld-linux-aarch64"}


def rows(readme):
    """Yield the cells of each row of the first table."""
    for line in readme.read_text().split("\n## ")[0].splitlines():
        if line.startswith("| ") and not line.startswith("| dependency"):
            yield [cell.strip() for cell in line.strip("|").split("|")]


def copyright_of(package):
    return pathlib.Path("/usr/share/doc", package, "copyright")


def installed(package):
    return subprocess.run(["dpkg-query", "-s", package], capture_output=True, check=False).returncode == 0


def refusal(source):
    """Return the output of packing a component that needs a package without a copyright file."""
    command = ["cmake", "-DCPACK_COMPONENTS_ALL=guard", "-DCPACK_DFR_GUARD_BUILT_WITH=libabsent-dev",
               "-P", source / "cmake/CopyCopyrights.cmake"]
    out = subprocess.run(command, capture_output=True, text=True, check=False)
    return out.stderr if out.returncode else ""


def linked(program):
    """Return the libraries that a program links directly, without version: libceres.so.3 -> libceres."""
    out = subprocess.run(["readelf", "-d", program], capture_output=True, text=True, check=False).stdout
    return {name.split(".so")[0] for name in re.findall(r"\(NEEDED\).*\[(.+)\]", out)}


def main(source, binary):
    folder = source / "third_party_licenses"
    packages, libraries, errors = set(), set(), []
    licensed = {}
    for cells in rows(folder / "README.md"):
        if len(cells) != 6 or not all(cells[:4]):
            errors.append(f"row {cells[0]}: needs six columns, with version, licence and packages")
            continue
        packages.update(cells[3].split())
        libraries.update(cells[4].split())
        # npm packages contain their licence texts and are not part of our packages.
        own = [] if cells[3].startswith("from npm: ") else cells[3].split(", through ")[0].split()
        licensed.update({library: own for library in cells[4].split()})
        for package in own:
            if installed(package) and not copyright_of(package).is_file():
                errors.append(f"row {cells[0]}: {copyright_of(package)} is missing")
    if "libabsent-dev" not in refusal(source):
        errors.append("a package without a copyright file must be refused by name")
    tools = re.search(r"^These build tools[^:]*: (.*?)\.$", (folder / "README.md").read_text(), re.M | re.S)
    packages.update(re.split(r",\s+", tools.group(1)))

    for row in (source / "components.txt").read_text().splitlines():
        if re.match("[a-z]", row):
            for package in " ".join(row.split("|")[3:]).split():
                if package not in packages:
                    errors.append(f"components.txt: {package} has no row")
    programs = [p for d in ("bin", "tests", "python/dfr") for p in sorted((binary / d).glob("*")) if p.is_file() and p.suffix not in (".py", ".pyi", ".typed")]
    for program in programs:
        for library in sorted(linked(program) - libraries - SYSTEM):
            if not library.startswith("libdfr_"):  # ours
                errors.append(f"{program.name} links {library}, which has no row")
        for library in sorted(linked(program) & libraries):
            if not any(copyright_of(package).is_file() for package in licensed[library]):
                errors.append(f"{program.name} links {library}, whose row names no package with a copyright file")
    if not programs:
        errors.append(f"no program was found below {binary}")
    print("\n".join(errors) or f"{len(programs)} programs checked")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])))
