"""Stills and moving pictures as files."""

import io
import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from fenics_rom.io.atomic_write import write_whole
from fenics_rom.visualization.optional_dependencies import imageio_package, pillow_package

Array = np.ndarray

MP4_SETTINGS = {"codec": "libx264", "pixelformat": "yuv420p", "macro_block_size": 2, "quality": 8}  # what browsers play


def write_still(file: Path, picture: Array) -> None:
    """Writes a .png file of a picture (height, width, 3) of bytes, or nothing.

    Raises:
        FileError: it cannot be written.
        MissingPackageError: there is no Pillow.
    """
    content = io.BytesIO()
    pillow_package().fromarray(picture).save(content, "PNG", optimize=True)
    write_whole(file, content.getvalue())


def write_film(file: Path, pictures: Iterable[Array], rate: float) -> None:
    """Writes a .gif file that begins anew at its end, or an .mp4 file; or nothing.

    Args:
        file: its ending says the format.
        pictures: (height, width, 3) bytes each, of even height and width.
        rate: pictures a second.

    Raises:
        FileError: it cannot be written.
        MissingPackageError: there is no encoder.
    """
    write_whole(file, _encode_gif(pictures, rate) if file.suffix == ".gif" else _encode_mp4(pictures, rate))


def _encode_gif(pictures: Iterable[Array], rate: float) -> bytes:
    """Each picture in 256 colours of its own, without dithering, which would flicker and take room."""
    Image, content = pillow_package(), io.BytesIO()
    quantized = (
        Image.fromarray(picture).quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        for picture in pictures
    )
    next(quantized).save(content, "GIF", save_all=True, append_images=quantized, duration=1000 / rate, loop=0)
    return content.getvalue()


def _encode_mp4(pictures: Iterable[Array], rate: float) -> bytes:
    """The encoder is a program that writes a file."""
    imageio = imageio_package()
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        with imageio.get_writer(film, fps=rate, **MP4_SETTINGS) as writer:
            for picture in pictures:
                writer.append_data(picture)
        return film.read_bytes()
