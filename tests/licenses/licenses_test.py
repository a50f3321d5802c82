"""Every package and shared library that this build links has a row and a text in third_party_licenses.

usage: licenses_test.py SOURCE_DIR BINARY_DIR
"""
import pathlib
import re
import subprocess
import sys

# Part of every Linux system: the C library and the loader (LGPL-2.1+), reached by every program.
SYSTEM = {"libc", "libm", "libpthread", "libdl", "librt", "ld-linux-x86-64", "ld-linux-aarch64"}


def rows(readme):
    """(cells, text file) of each row of the first table."""
    for line in readme.read_text().splitlines():
        match = re.match(r"\| \[[^]]+\]\(([^)]+)\) \|", line)
        if match:
            yield [cell.strip() for cell in line.strip("|").split("|")], match.group(1)


def linked(program):
    """The libraries that a program names itself, without version: libceres.so.3 -> libceres."""
    out = subprocess.run(["readelf", "-d", program], capture_output=True, text=True, check=False).stdout
    return {name.split(".so")[0] for name in re.findall(r"\(NEEDED\).*\[(.+)\]", out)}


def main(source, binary):
    folder = source / "third_party_licenses"
    packages, libraries, errors = set(), set(), []
    for cells, text in rows(folder / "README.md"):
        if len(cells) != 6 or not cells[1] or not cells[2]:
            errors.append(f"row {cells[0]}: needs six columns, with version and licence")
            continue
        packages.update(cells[3].split())
        libraries.update(cells[4].split())
        if not (folder / text).is_file() or (folder / text).stat().st_size < 500:
            errors.append(f"row {cells[0]}: {text} does not hold a licence text")
    tools = re.search(r"^Build tools[^:]*: (.*?)\.$", (folder / "README.md").read_text(), re.M | re.S)
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
    if not programs:
        errors.append(f"no program was found below {binary}")
    print("\n".join(errors) or f"{len(programs)} programs checked")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])))
