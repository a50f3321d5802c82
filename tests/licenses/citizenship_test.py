"""The files for users of the project exist and agree with each other.

usage: citizenship_test.py SOURCE_DIR BINARY_DIR
"""
import pathlib
import re
import subprocess
import sys
import unittest
import xml.etree.ElementTree

SOURCE, BINARY = (pathlib.Path(p).resolve() for p in sys.argv[1:3])
del sys.argv[1:3]


def text(name):
    return (SOURCE / name).read_text()


def cff(key):
    """Return a one-line value at the top level of CITATION.cff."""
    return re.search(rf'^{key}: "?(.+?)"?$', text("CITATION.cff"), re.M).group(1)


def components():
    """Return the needs and packages of each component in components.txt."""
    rows = {}
    for row in text("components.txt").splitlines():
        cells = [cell.strip() for cell in row.split("|")]
        if re.match("[a-z]", row) and cells[1] != "-":
            rows[cells[0]] = cells[1], cells[2].split(), cells[3].split()
    return rows


def reaches_gpl(name, rows):
    _, needs, packages = rows[name]
    return bool({"libceres-dev", "libopencv-videoio-dev"} & set(packages)) or any(
        reaches_gpl(need, rows) for need in needs
    )


class Citizenship(unittest.TestCase):
    def test_the_licence_is_bsd_3_clause(self):
        self.assertTrue(text("LICENSE").startswith("BSD 3-Clause License\n"))
        self.assertEqual(cff("license"), "BSD-3-Clause")
        for page in ("README.md", "CONTRIBUTING.md", "third_party_licenses/README.md"):
            self.assertRegex(text(page), r"\]\((\.\./)?LICENSE\)", page)

    def test_versions_agree(self):
        version = re.search(r"project\(dfr VERSION (\S+)", text("CMakeLists.txt")).group(1)
        self.assertEqual(cff("version"), version)
        ros = xml.etree.ElementTree.parse(SOURCE / "package.xml").getroot()
        self.assertEqual(ros.findtext("version"), version)
        self.assertEqual((ros.findtext("name"), ros.findtext("license")), ("dfr", cff("license")))
        cluster = [SOURCE / "libs/experiment/tools/dfr-cluster", "--version"]
        self.assertEqual(subprocess.run(cluster, capture_output=True, text=True, check=True).stdout, version + "\n")

    def test_the_citation_names_the_paper_of_the_readme(self):
        title = re.search(r"preferred-citation:\n.*\n  title: >-\n    (.*)\n", text("CITATION.cff")).group(1)
        self.assertIn(" ".join(title.split()), " ".join(text("README.md").split()))

    def test_the_page_on_licences_says_what_reaches_gpl_code(self):
        rows = components()
        [row] = re.findall(r"^\| (.*`dfr::imitation`.*) \| (.*) \|$", text("third_party_licenses/README.md"), re.M)
        told = [set(re.findall(r"`(?:dfr::)?(\w+)`", cell)) for cell in row]
        told[1] |= {"python"} if "the Python module" in row[1] else set()
        self.assertEqual(told[0], {name for name in rows if reaches_gpl(name, rows)})
        self.assertEqual(told[1], set(rows) - told[0])

    def test_every_package_brings_its_copyright(self):
        rows = components()
        files = sorted((BINARY / "copyright").glob("*/copyright"))
        self.assertTrue(files)
        for file in files:
            with self.subTest(file.parent.name):
                copyright = file.read_text()
                self.assertIn("License: BSD-3-Clause", copyright)
                self.assertIn("ADVISED OF THE POSSIBILITY OF SUCH DAMAGE", copyright)
                # In this format, empty lines end paragraphs.
                self.assertIn("\n .\n", copyright)
                self.assertEqual("only under the GPL" in copyright, reaches_gpl(file.parent.name, rows))


if __name__ == "__main__":
    unittest.main()
