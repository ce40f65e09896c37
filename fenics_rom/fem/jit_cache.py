"""Where dolfinx keeps the forms it has compiled: in the user's cache, or in a temporary folder where there is none."""

import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path


def provide_jit_cache() -> None:
    """Names a temporary folder where a home cannot be used, as in containers; to be called before dolfinx is imported.

    By variables, which dolfinx reads when it is imported: its options have other names in other releases.
    """
    try:
        with suppress(FileNotFoundError):
            (Path.home() / ".config" / "dolfinx").stat()  # where dolfinx and FFCx look for options
    except (OSError, RuntimeError):  # a home of somebody else, or none
        os.environ["HOME"] = str(_own_folder())
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "fenics"
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=cache):  # what may be written is known by writing alone
            pass
    except OSError:
        os.environ["XDG_CACHE_HOME"] = str(_own_folder())


def _own_folder() -> Path:
    """The same in every run, so that forms are compiled once; of nobody else, as what is in it is executed."""
    folder = Path(tempfile.gettempdir()) / f"fenics-rom-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022:
        return folder
    return Path(tempfile.mkdtemp(prefix="fenics-rom-"))
