#!/bin/sh
# Installs the packages of package-lock.json in the current folder, unless they are installed.
# usage: get_npm_packages.sh NPM
# `npm ls` is fast, and fails if the installed packages differ from the lock file.
"$1" ls --omit=dev >/dev/null 2>&1 && exit 0
"$1" ci --ignore-scripts --no-audit --no-fund --fetch-retries=5 && exit 0
echo "$PWD/package.json: npm cannot fetch the packages; is its registry reachable ($("$1" config get registry))?" >&2
exit 1
