#!/bin/sh
# Fetches what package-lock.json in this folder names, unless it is there.
# usage: get_npm_packages.sh NPM
# `npm ls` is quick and says whether what is there is what the lock file asks for.
"$1" ls --omit=dev >/dev/null 2>&1 && exit 0
"$1" ci --ignore-scripts --no-audit --no-fund --fetch-retries=5 && exit 0
echo "npm could not fetch what $PWD/package.json names. Is its registry within reach ($("$1" config get registry))?" >&2
exit 1
