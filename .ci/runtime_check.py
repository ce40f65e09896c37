"""What an installed runtime must do with NumPy and h5py alone, without what Windows lacks.

python .ci/runtime_check.py ROM.h5 RUN.h5
"""

import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path

ONLY_POSIX = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}
PACKAGES = {"fenics-rom", "numpy", "h5py", "pip", "setuptools"}  # setuptools: as in a new environment of Python 3.11


class NotOnWindows:
    """Refuses what Windows lacks, to whoever imports it from here on."""

    def find_spec(self, name, path=None, target=None):
        """See importlib."""
        if name in ONLY_POSIX:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def command(*words):
    """Exit status of a command and what it printed."""
    run = subprocess.run(
        [sys.executable, "-m", "fenics_rom", *map(str, words)], capture_output=True, text=True, encoding="utf-8"
    )
    return run.returncode, run.stdout, run.stderr


def complaint(fr, name):
    """What is said of a name that needs more than the runtime; nothing of one that needs no more."""
    try:
        getattr(fr, name)
    except fr.errors.MissingPackageError as error:
        return str(error)
    return ""


def main(rom_file, run_file):
    """Reads, steps, compares and writes; says what is missing for the rest."""
    installed = {each.metadata["Name"] for each in metadata.distributions()}
    assert installed <= PACKAGES, f"installed beside the runtime: {installed - PACKAGES}"
    sys.meta_path.insert(0, NotOnWindows())
    import fenics_rom as fr

    assert metadata.version("fenics-rom") == fr.__version__
    assert "site-packages" in Path(fr.__file__).parts, fr.__file__
    rom = fr.read_rom(rom_file)
    body, batch = fr.Simulator(rom, dt=1e-3), fr.Batch(rom, dt=1e-3, size=3)
    for contact in ("right", "corner", "right"):
        body.switch(contact)
        batch.switch(contact)
        body.step([1.0] * body.inputs)
        batch.step([1.0] * batch.inputs)
    assert body.energy > 0
    assert abs(batch.energy - body.energy).max() <= 1e-12 * body.energy
    run = fr.simulate(rom)
    assert fr.compare(run, fr.read_trajectory(run_file))["shape"].relative < 1e-9
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "größer.h5")  # names may have any letters
        fr.write_trajectory(place, run)
        assert fr.compare(fr.read_trajectory(place), run)["shape"].relative == 0.0
        fr.write_rom(place, rom, force=True)
        assert fr.read_rom(place).name == rom.name
    for name in ("assemble", "reduce", "read_scene"):
        assert "install" in complaint(fr, name), name
    assert command("--version") == (0, f"fenics-rom {fr.__version__}\n", "")
    status, _, told = command("info", rom_file)
    assert (status, told) == (1, 'fenics-rom: error: the command line needs rich: pip install "fenics-rom[cli]"\n')
    print(f"Python {sys.version.split()[0]}: runtime works with {', '.join(sorted(installed))}")


main(*sys.argv[1:])
