#!/bin/bash
# Sourced by demos/run.sh and tests/run.sh, in the project's root: installs what is missing and sets what Open MPI
# and OpenBLAS read. Root or sudo is needed for missing Debian packages only; when all is there, no network.
set -euo pipefail

packages=(
  python3-dolfinx # with PETSc, SLEPc, Open MPI, SciPy and the C++ compiler
  python3-gmsh python3-h5py python3-venv
  libegl1 # VTK draws with it where there is no screen
  libopenblas0 # Debian's default BLAS is the reference one, many times slower
)

die() {
  echo "error: $*" >&2
  exit 1
}

install_packages() {
  local needs="this needs Debian 12 or 13 (or a derivative that has its packages)" package missing=() progress=/dev/null
  local apt=(env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=600)
  command -v apt-get >/dev/null || die "there is no apt-get; $needs"
  for package in "${packages[@]}"; do
    [ "$(dpkg-query -Wf '${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
  done
  [ ${#missing[@]} -gt 0 ] || return 0

  if [ $EUID -ne 0 ]; then
    apt=(sudo "${apt[@]}")
    { command -v sudo >/dev/null && "${apt[@]}" --version >/dev/null; } ||
      die "first run as root: apt-get update && apt-get install -y --no-install-recommends ${missing[*]}"
  fi
  echo "Installing ${missing[*]} with apt (some minutes) ..."
  "${apt[@]}" update || true # someone's broken source is no reason to stop; what is really missing shows now
  if ! apt-cache show "${missing[@]}" >/dev/null 2>&1 || ! dpkg --compare-versions \
    "$(apt-cache show --no-all-versions python3-dolfinx | sed -n 's/^Version: //p')" ge 1:0.5; then
    die "apt does not offer ${missing[*]} (dolfinx 0.5 or newer); $needs and its archive within reach"
  fi
  [ ! -t 1 ] || progress=/dev/stdout # 500 packages: something to watch for who waits, too much for a log
  "${apt[@]}" install -y --no-install-recommends "${missing[@]}" >"$progress"
}

check_venv() {
  .venv/bin/python -I - <<'PYTHON'
import sys
from importlib.util import find_spec

for name in "numpy", "scipy", "h5py", "dolfinx", "gmsh":  # compiled for each other: not one of them from elsewhere
    spec = find_spec(name)
    if not spec or not spec.origin.startswith("/usr/lib/"):
        sys.exit(f"error: .venv does not see Debian's {name}: {spec}")
for name in (
    "fenics_rom", "furo", "gymnasium", "matplotlib", "mujoco", "myst_parser", "numba", "playwright", "pydantic", "pytest", "pyvista", "rich",
    "rosbags", "sphinx", "tomlkit", "viser", "xdist"
):
    if not find_spec(name):
        sys.exit(f"error: .venv has no {name}")
PYTHON
}

# Keeps pip from putting others over Debian's NumPy, SciPy and h5py.
constrain_pip() {
  .venv/bin/python -I - >.venv/constraints.txt <<'PYTHON'
import sysconfig
from importlib import import_module, metadata
from pathlib import Path

for name in "numpy", "scipy", "h5py":
    version = import_module(name).__version__
    print(f"{name}=={version}")
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:  # h5py in Debian 12, which pip would not see and install again
        info = Path(sysconfig.get_path("purelib"), f"{name}-{version}.dist-info")
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
PYTHON
}

make_venv() {
  local made_from
  made_from=$(/usr/bin/python3 -V && pwd && sha256sum pyproject.toml demos/install.sh demos/*/requirements.txt)
  if [ "$(cat .venv/made-from 2>/dev/null)" = "$made_from" ] && check_venv 2>/dev/null; then return; fi

  echo "Making .venv ..."
  rm -rf .venv
  # Not the python3 on PATH: that may be one of pyenv or conda, which has no dolfinx.
  /usr/bin/python3 -m venv --system-site-packages .venv
  constrain_pip
  .venv/bin/pip install -q --disable-pip-version-check -c .venv/constraints.txt -e '.[offline,fast,plot,view,surfaces,docs,test]' \
    -r demos/learning/requirements.txt -r demos/robot/requirements.txt
  check_venv
  echo "$made_from" >.venv/made-from # last: a .venv without it is half-made, and made again
}

export PYTHONNOUSERSITE=1 # a NumPy in ~/.local would come before Debian's
install_packages
make_venv

export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" # the ranks of mpirun would fight for the cores
export OMPI_MCA_btl=^tcp # one machine needs no network, and containers make Open MPI complain about theirs
# More ranks than cores, in the words of Open MPI 4 and 5.
export OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe
export OMPI_MCA_ess_singleton_isolated=1 # one rank needs no server, whose start takes half a second of each command
if [ $EUID -eq 0 ]; then
  export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi
