"""The command `fenics-rom`, also as `python -m fenics_rom`."""

import os
import sys


def main() -> None:
    """Runs the command line; who interrupts while it is still being imported reads one line, too."""
    _open_closed_streams()
    try:
        from fenics_rom.cli.main import main as command_line
    except KeyboardInterrupt:
        print("fenics-rom: error: interrupted", file=sys.stderr)
        sys.exit(1)
    command_line()


def _open_closed_streams() -> None:
    """Of a stream that is closed (`>&-`) nothing is wanted; left closed, the next file that is opened would be it."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
            setattr(sys, name, os.fdopen(number, "r" if name == "stdin" else "w"))


if __name__ == "__main__":
    main()
