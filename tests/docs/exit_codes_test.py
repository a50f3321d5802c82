#!/usr/bin/env python3
"""Programs exit with 0 after --help, and with 2 and one line after a usage error.

usage: exit_codes_test.py PROGRAM ...
"""

import functools
import pathlib
import re
import subprocess
import sys
import unittest

PROGRAMS = [pathlib.Path(name) for name in sys.argv[1:]]


class ExitCodesTest(unittest.TestCase):
    @staticmethod
    @functools.cache
    def run_program(program, *arguments):
        return subprocess.run([program, *arguments], text=True, capture_output=True, check=False, timeout=60)

    def test_help_succeeds(self):
        for program in PROGRAMS:
            with self.subTest(program=program.name):
                done = self.run_program(program, "--help")
                self.assertEqual((done.returncode, done.stderr), (0, ""))

    def test_version_names_the_release_and_the_commit(self):
        for program in PROGRAMS:
            with self.subTest(program=program.name):
                done = self.run_program(program, "--version")
                self.assertEqual((done.returncode, done.stderr), (0, ""))
                self.assertRegex(done.stdout, r"\A\d+\.\d+\.\d+ \((unknown|[0-9a-f]+(\+changes)?)\)\n\Z")

    def test_usage_errors_give_two_and_one_line_with_the_closest_name(self):
        for program in PROGRAMS:
            commands = re.findall(r"^  ([a-z]+) ", self.run_program(program, "--help").stdout.partition("Subcommands:")[2], re.M)
            wrong = {"--versoin": "unknown option '--versoin' (did you mean '--version'?)", "nonsense": "nonsense"}
            for command in commands[-1:]:  # One parser serves all commands.
                wrong[command + "x"] = f"unknown command '{command}x' (did you mean '{command}'?)"
                del wrong["nonsense"]
            for argument, message in wrong.items():
                with self.subTest(program=program.name, argument=argument):
                    done = self.run_program(program, argument)
                    self.assertEqual((done.returncode, done.stdout), (2, ""))
                    self.assertRegex(done.stderr, rf"\A{program.name}: .*--help lists .*\n\Z")
                    self.assertIn(message, done.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
