"""A ROM that a caller gave, or the one in the file whose name was given."""

from typing import Any

from fenics_rom.rom.rom import Rom


def given_rom(where: str, given: Any) -> Rom:
    """The ROM; `where` is for the message.

    Raises:
        SceneError: it is neither a ROM nor a name.
        FileError: the file cannot be read, or holds something else.
    """
    if isinstance(given, Rom):
        return given
    from fenics_rom.io.given import object_or_file  # here, as files need h5py
    from fenics_rom.rom.file import ROM_FILE

    rom: Rom = object_or_file(where, given, ROM_FILE)
    return rom
