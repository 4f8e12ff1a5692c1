#!/bin/sh
# Prints the Python to build with: 3.11 or 3.12, else says what was tried and ends with 1.
#
# A name on PATH may exist and still not run (version managers leave shims), so each candidate is run. The Python of an
# existing .venv comes first: which Python is on PATH today must not throw away a finished set-up.
set -u
wanted="${PYTHON:-}"
venv_config="$(dirname "$0")/../.venv/pyvenv.cfg"
probe='import sys; print("%d.%d.%d" % sys.version_info[:3]); sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))'

if [ -n "$wanted" ]; then
    candidates="$wanted"
else
    candidates="python3.12 python3.11 python3"
    if [ -r "$venv_config" ]; then
        candidates="$(sed -n 's/^executable = //p' "$venv_config") $candidates"
    fi
fi

tried=""
for candidate in $candidates; do
    if version=$("$candidate" -c "$probe" 2>/dev/null); then
        # Ask for the real file: a shim would be looked up again for every process.
        exec "$candidate" -c 'import os, sys; print(os.path.abspath(sys.executable))'
    fi
    tried="$tried $candidate (${version:-not found or not runnable});"
done
cat >&2 <<MESSAGE
setup: skinplan needs Python 3.11 or 3.12. Tried:$tried
  Debian 12, Ubuntu 24.04: sudo apt install python3 python3-dev python3-venv
  another place:           make setup PYTHON=/path/to/python3.12
MESSAGE
exit 1
