"""Packs a build, installs the packages into an empty root, and builds and runs from there.

usage: packages_test.py SOURCE_DIR BINARY_DIR CXX

The dependencies of a package are correct if dpkg installs the package into a root that holds only its direct and
indirect dependencies. They are complete if they own every file that a compiler reads to build a consumer.
"""

import os
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

SOURCE, BINARY, CXX = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3]
HOST_STATUS = pathlib.Path("/var/lib/dpkg/status")


def run(*command, **options):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, **options)
    if done.returncode != 0:
        raise AssertionError(f"{' '.join(map(str, command))}\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return done.stdout


def fields(stanza):
    return dict(re.findall(r"^([A-Z][\w-]*): *(.*(?:\n .*)*)", stanza, re.M))


def alternatives(field):
    """Return the names in a dependency field: one list of choices per clause."""
    clauses = filter(None, (clause.strip() for clause in field.split(",")))
    return [[re.split(r"[ (:]", choice.strip())[0] for choice in clause.split("|")] for clause in clauses]


class Host:
    """The packages installed on this machine."""

    def __init__(self):
        self.stanzas, self.providers = {}, {}
        for stanza in HOST_STATUS.read_text().split("\n\n"):
            info = fields(stanza)
            if info.get("Status") != "install ok installed":
                continue
            self.stanzas[info["Package"]] = (stanza, info)
            for [provided] in alternatives(info.get("Provides", "")):
                self.providers.setdefault(provided, info["Package"])

    def closure(self, names):
        """Return these packages and all their dependencies."""
        found, wanted = set(), list(names)
        while wanted:
            name = wanted.pop()
            name = name if name in self.stanzas else self.providers.get(name, name)
            if name in found or name not in self.stanzas:
                continue
            found.add(name)
            info = self.stanzas[name][1]
            for choices in alternatives(info.get("Depends", "") + "," + info.get("Pre-Depends", "")):
                wanted += [c for c in choices if c in self.stanzas or c in self.providers][:1]
        return found


def owners(files):
    """Return the packages of the files. A merged /usr lists some files under their old names."""
    files = sorted(set(files))
    names = files + [f.removeprefix("/usr") for f in files]
    out = subprocess.run(["dpkg-query", "-S", *names], capture_output=True, text=True).stdout
    owner = {}
    for line in out.splitlines():
        packages, _, path = line.rpartition(": ")
        if not packages.startswith("diversion"):
            owner.setdefault(path.removeprefix("/usr"), set()).update(
                name.split(":")[0] for name in packages.split(", ")
            )
    return {f: owner.get(f.removeprefix("/usr"), set()) for f in files}


class PackagesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory(dir=BINARY)
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        # Fast compression, because these packages are deleted.
        run("cpack", "-G", "DEB", "--config", BINARY / "CPackConfig.cmake", "-B", cls.folder,
            "-D", "CPACK_DEBIAN_COMPRESSION_TYPE=gzip")
        cls.debs = sorted(cls.folder.glob("*.deb"))
        cls.info = {deb: fields(run("dpkg-deb", "--field", deb)) for deb in cls.debs}
        cls.host = Host()
        cls.rows = {}
        for row in (SOURCE / "components.txt").read_text().splitlines():
            cells = [cell.strip() for cell in row.split("|")]
            if re.match("[a-z]", row) and cells[1] != "-":
                cls.rows[cells[0]] = (cells[2].split(), cells[3].split())
        cls.root = cls.folder / "root"
        cls.install()

    @classmethod
    def install(cls):
        """Install with dpkg into a root that contains only the dependencies of our packages."""
        names = {c for info in cls.info.values() for choices in alternatives(info.get("Depends", "")) for c in choices}
        for part in ("updates", "info", "triggers"):
            (cls.root / "var/lib/dpkg" / part).mkdir(parents=True)
        status = [cls.host.stanzas[name][0] for name in sorted(cls.host.closure(names))]
        (cls.root / "var/lib/dpkg/status").write_text("\n\n".join(status) + "\n\n")
        for name in ("libdfr", "dfr", "python3-dfr"):
            assert f"\nPackage: {name}" not in "\n".join(status), "dfr is installed on this machine"
        command = ["dpkg", f"--root={cls.root}", "--log=/dev/null", "--force-not-root", "--force-script-chrootless",
                   "--no-triggers", "--install", *cls.debs]
        run(*command if os.geteuid() == 0 else ["fakeroot", *command])

    def component(self, deb):
        name = self.info[deb]["Package"]
        name = re.sub(r"^(libdfr-|dfr-|python3-dfr$)", "", name).removesuffix("-dev").replace("-", "_")
        return name or "python"

    def test_one_package_per_component_with_this_version(self):
        version = re.search(r"project\(dfr VERSION (\S+)", (SOURCE / "CMakeLists.txt").read_text()).group(1)
        built = {self.component(deb) for deb in self.debs}
        self.assertLessEqual(built, set(self.rows))
        self.assertIn("core", built)
        for deb, info in self.info.items():
            self.assertEqual(info["Version"], version)
            self.assertRegex(deb.name, rf"^{info['Package']}_{version}_[a-z0-9]+\.deb$")
            self.assertTrue(info["Description"] and info["Maintainer"])
            # No file may be outside the folders that Debian allows.
            for path in re.findall(r"(\./\S*)$", run("dpkg-deb", "--contents", deb), re.M):
                self.assertRegex(path, r"^\./(usr/((bin|include|lib|share)/.*)?)?$")

    def test_each_brings_its_copyright_and_those_of_its_build_dependencies(self):
        for deb, info in self.info.items():
            self.assertTrue((self.root / "usr/share/doc" / info["Package"] / "copyright").is_file())
            for package in self.rows[self.component(deb)][1]:
                text = self.root / "usr/share/doc" / info["Package"] / "third_party" / package / "copyright"
                if package != "python3":
                    self.assertEqual(text.read_text(), pathlib.Path("/usr/share/doc", package, "copyright").read_text())

    def test_packages_depend_on_what_their_rows_need(self):
        for deb, info in self.info.items():
            needs, packages = self.rows[self.component(deb)]
            depends = info.get("Depends", "")
            if info["Package"] == "dfr-planar-page":
                self.assertEqual(depends, "")  # a page for browsers
            elif info["Package"].endswith("-dev"):
                expected = packages + [f"libdfr-{n.replace('_', '-')}-dev (= {info['Version']})" for n in needs]
                self.assertEqual(sorted(depends.split(", ")), sorted(expected))
            else:
                self.assertNotIn("-dev", depends)  # run-time libraries only
                self.assertIn("libc6", depends)

    def test_programs_depend_on_the_libraries_that_they_open_by_name(self):
        """Direct and indirect dependencies own each library whose name a program contains but does not link."""
        opened = set()
        for deb, info in self.info.items():
            listed = run("dpkg-deb", "--contents", deb)
            for path in re.findall(r"\./(usr/bin/\S+|usr/lib/python3/\S+\.so)$", listed, re.M):
                content = (self.root / path).read_bytes()
                if not content.startswith(b"\x7fELF"):
                    continue
                names = {n.decode() for n in re.findall(rb"\0(lib[\w+-]+\.so(?:\.\d+)+)(?=\0)", content)}
                names -= set(re.findall(r"\(NEEDED\).*\[(.*)\]", run("readelf", "--dynamic", self.root / path)))
                opened |= names
                found = [str(file) for name in names for file in pathlib.Path("/usr/lib").glob(f"*/{name}")]
                allowed = self.host.closure(c for choices in alternatives(info["Depends"]) for c in choices)
                for file, packages in owners(found).items():
                    self.assertTrue(packages & allowed, f"{path} opens {file} of {packages}")
        if any(info["Package"] == "dfr-pusher" for info in self.info.values()):
            self.assertLessEqual({"libOSMesa.so.8", "libEGL.so.1"}, opened)

    def test_dpkg_finds_nothing_missing(self):
        names = [info["Package"] for info in self.info.values()]
        self.assertEqual(run("dpkg", f"--root={self.root}", "--audit", *names), "")
        for info in self.info.values():
            status = run("dpkg-query", f"--admindir={self.root}/var/lib/dpkg", "-W", "-f", "${db:Status-Status}",
                         info["Package"])
            self.assertEqual(status, "installed")

    def pkg_config(self, module):
        [folder] = self.root.glob("usr/lib/**/pkgconfig")
        flags = run("pkg-config", "--cflags", "--libs", module, env={**os.environ, "PKG_CONFIG_PATH": str(folder)})
        return flags.split()

    def test_consumers_build_by_pkg_config_with_nothing_but_the_dependencies(self):
        compiler = self.host.closure(["g++", "libc6-dev", "libstdc++-12-dev"])
        for deb, info in self.info.items():
            if not info["Package"].endswith("-dev"):
                continue
            name = self.component(deb)
            with self.subTest(name):
                flags = self.pkg_config(info["Package"].removeprefix("lib").removesuffix("-dev"))
                [source] = (SOURCE / "tests/install/consumer").rglob(f"{name}.cc")
                program, rule = self.folder / name, self.folder / f"{name}.d"
                trace = run(CXX, "-O0", "-MD", "-MF", rule, source, "-o", program, *flags, "-Wl,--trace")
                run(program)
                read = re.findall(r"\S+", rule.read_text().replace("\\\n", " ").partition(":")[2])
                read += [line for line in trace.splitlines() if line.startswith("/")]
                foreign = {os.path.realpath(f) for f in read if not f.startswith("/tmp/")}
                foreign = [f for f in foreign if not f.startswith((str(self.folder), str(SOURCE)))]
                theirs = [p for choices in alternatives(info["Depends"]) for p in choices]
                ours = [p for p in theirs if p.startswith("libdfr-")]
                while ours:  # through our own packages
                    one = next(i for i in self.info.values() if i["Package"] == ours[-1])
                    ours.pop()
                    more = [p for choices in alternatives(one.get("Depends", "")) for p in choices]
                    ours += [p for p in more if p.startswith("libdfr-") and p not in theirs]
                    theirs += more
                allowed = self.host.closure(theirs) | compiler
                for path, packages in owners(foreign).items():
                    self.assertTrue(packages & allowed, f"{name} reads {path} of {packages}")

    def test_a_consumer_builds_by_cmake(self):
        build = self.folder / "by-cmake"
        library = "kernel" if any("kernel" in deb.name for deb in self.debs) else "core"
        run("cmake", "-S", SOURCE / "tests/install/consumer", "-B", build, "-G", "Ninja", f"-DLIBRARY={library}",
            f"-DCMAKE_PREFIX_PATH={self.root}/usr", f"-DCMAKE_CXX_COMPILER={CXX}", "-DCMAKE_BUILD_TYPE=Debug")
        run("cmake", "--build", build)
        run(build / "consumer")

    def test_programs_and_the_module_run(self):
        for program in self.root.glob("usr/bin/*"):
            self.assertIn("sage", run(program, "--help"))
            page = (self.root / "usr/share/man/man1" / f"{program.name}.1").read_text()
            self.assertRegex(page, rf"\n\.SH NAME\n{program.name} \\- [A-Z]")
            self.assertIn("\n.SH OPTIONS\n", page)
            for completion in (f"bash-completion/completions/{program.name}",
                               f"fish/vendor_completions.d/{program.name}.fish",
                               f"zsh/vendor-completions/_{program.name}"):
                self.assertTrue((self.root / "usr/share" / completion).is_file(), completion)
            zsh = (self.root / f"usr/share/zsh/vendor-completions/_{program.name}").read_text()
            self.assertIn(program.name, zsh.splitlines()[0].split())  # "#compdef NAME ..."
        built = {info["Package"] for info in self.info.values()}
        if "dfr-planar-page" in built:
            self.assertTrue((self.root / "usr/share/dfr/planar.html").is_file())
        if "python3-dfr" in built:
            packages = self.root / "usr/lib/python3/dist-packages"
            run("/usr/bin/python3", "-c", "import dfr; dfr.OneClassSVM().fit_predict([[0.0], [1.0], [2.0]])",
                env={**os.environ, "PYTHONPATH": str(packages), "PYTHONDONTWRITEBYTECODE": "1"})


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
