#!/bin/bash
# bash demos/run.sh [NAME ...]: installs what is missing, then runs the demos NAME (the plate, if none is named).
set -euo pipefail
cd "$(dirname "$(realpath "$0")")/.."

[ $# -gt 0 ] || set -- plate
demos=()
for script in demos/*/*.py; do
  name=$(basename "$script" .py)
  [ "$script" != "demos/$name/$name.py" ] || demos+=("$name")
done
for name in "$@"; do
  if [[ " ${demos[*]} " != *" $name "* ]]; then
    echo "error: there is no demo '$name'; there are: ${demos[*]}" >&2
    exit 2
  fi
done

. demos/install.sh
for name in "$@"; do
  .venv/bin/python "demos/$name/$name.py"
done
printf 'Output: %s\n' "${@/#/$PWD/demos/}" | sed 's|$|/out/|'
