#!/bin/bash
# bash tests/run.sh [--all | --elsewhere] [PYTEST ARGUMENT ...]: installs what is missing, then runs the tests: without
# --all a case of each that is not slow, and of compiled steps some; with --elsewhere of the laws a test of each file, and
# not what is the same on all systems. Given other arguments, it runs pytest with them.
set -euo pipefail
cd "$(dirname "$(realpath "$0")")/.."

. demos/install.sh
packages=(chromium) # for the live view's tests
install_packages
pytest=(.venv/bin/python -m pytest)
with_numba=(tests/test_compilation.py tests/mechanics/test_compiled_contact.py tests/runtime/test_compiled_{steps,frames}.py)
if [ $# -eq 0 ]; then
  set -- --short
elif [ "$*" = --elsewhere ]; then
  set -- --elsewhere --ignore=tests/{demos,certification,studies,test_{attributes,layers,pages,random_scenes,stand_ins}.py}
elif [ "$*" = --all ]; then
  with_numba=(tests/test_compilation.py tests/world/test_compiled_{drives,joints,world}.py
    tests/mechanics/test_{compiled_contact,contact}.py
    tests/runtime/test_{compiled_*,batch_contact,clearance,compliance_in_blocks,differentiation_contact,errors,fast_motion}.py
    tests/runtime/test_{mesh_obstacles,residual_compliance,skin_looks}.py)
else
  exec "${pytest[@]}" "$@"
fi
unset PYTHONDONTWRITEBYTECODE # some hundred times Python is started, and would compile the package each time
marked() { grep -rl --include='test_*.py' "mark\.$1" tests; }
mapfile -t alone < <(marked alone)
mapfile -t ranks < <(marked ranks)

log=$(mktemp)
trap 'rm -f "$log"' EXIT
summaries=() failed=0
part() { # NAME PYTEST ARGUMENT ...
  local name=$1
  shift
  echo "=== $name"
  "${pytest[@]}" "$@" 2>&1 | tee "$log" || failed=1
  summaries+=("$name: $(tail -n 1 "$log")")
}

# A file's tests on one core, in the order of tests/conftest.py.
by_file=(--dist loadfile --no-loadscope-reorder --maxprocesses 4 --numprocesses)
export FENICS_ROM_COMPILED=0 # NumPy is the reference; what runs compiled is held to it below
part "on all cores" "$@" --ignore=tests/test_compilation.py -m "not (alone or ranks)" "${by_file[@]}" auto
part "ranks" "$@" -m ranks "${ranks[@]}" "${by_file[@]}" 2 # each is one process for most of its time
part "alone" "$@" -m alone "${alone[@]}" # what goes by the clock
FENICS_ROM_COMPILED=1 part "compiled" "${@/#--elsewhere/--short}" "${with_numba[@]}" "${by_file[@]}" auto
printf '=== %s\n' "${summaries[@]}"
exit "$failed"
