#!/bin/sh
# Regenerates the locks from the *.in files (needs uv: `pip install uv`). Called by `make lock`.
#
# One resolution holds for Python 3.11 and 3.12 and has the same versions on both, so that results do not depend on the
# Python. The locks name packages, versions and hashes and never an index: where packages come from is the machine's affair.
set -eu
cd "$(dirname "$0")"
UV="${UV:-uv}"
command -v "$UV" >/dev/null || { echo "make lock needs uv, which is not on PATH: pip install uv, or UV=/path/to/uv" >&2; exit 1; }

compile() {  # compile OUTPUT INPUT...
    output=$1; shift
    "$UV" --no-config pip compile --quiet --upgrade --universal --python-version 3.11 --fork-strategy fewest \
        --generate-hashes --no-annotate --no-header --no-emit-index-url --no-emit-find-links --no-emit-build-options \
        "$@" -o "$output.new"
    {
        echo "# Made by \`make lock\` for Python 3.11 and 3.12 from: $*"
        cat "$output.new"
    } > "$output.tmp"
    rm "$output.new"
    mv "$output.tmp" "$output"
}

# Everything, with ROS 2 as wheels.
compile lock-wheels.txt requirements.in requirements-ros.in requirements-dev.in
# The same versions without ROS, for a machine where a full ROS 2 Jazzy is sourced.
compile lock-system-ros.txt requirements.in requirements-dev.in -c lock-wheels.txt
# What builds packages.
compile lock-build.txt requirements-build.in -c lock-wheels.txt
# What is optional, beside the versions that are installed anyway.
compile lock-extras.txt requirements-extras.in -c lock-wheels.txt
