"""The command `fenics-rom`, also as `python -m fenics_rom`."""

import sys


def main() -> None:
    """Runs the command line; who interrupts while it is still being imported reads one line, too."""
    try:
        from fenics_rom.cli.main import main as command_line
    except KeyboardInterrupt:
        print("fenics-rom: error: interrupted", file=sys.stderr)
        sys.exit(1)
    command_line()


if __name__ == "__main__":
    main()
