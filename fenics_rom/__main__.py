"""`python -m fenics_rom` is `fenics-rom`."""

from fenics_rom.cli import main

main()
