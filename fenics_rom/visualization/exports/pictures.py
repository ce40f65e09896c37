"""Stills and moving pictures as files, of pictures (height, width, 3) of bytes; each is there whole or not at all."""

import io
import tempfile
from collections.abc import Iterable
from pathlib import Path

from numpy import ndarray as Array

from fenics_rom.io.atomic_write import write_whole
from fenics_rom.visualization.optional_dependencies import load_package

MP4_SETTINGS = {"codec": "libx264", "pixelformat": "yuv420p", "macro_block_size": 2, "quality": 8}  # what browsers play


def write_still(file: Path, picture: Array) -> None:
    """Writes a .png file."""
    content = io.BytesIO()
    load_package("PIL.Image").fromarray(picture).save(content, "PNG", optimize=True)
    write_whole(file, content.getvalue())


def write_film(file: Path, pictures: Iterable[Array], rate: float) -> None:
    """Writes pictures of even height and width, `rate` a second: a .gif that begins anew at its end, or an .mp4."""
    write_whole(file, _encode_gif(pictures, rate) if file.suffix == ".gif" else _encode_mp4(pictures, rate))


def _encode_gif(pictures: Iterable[Array], rate: float) -> bytes:
    """Each picture in 256 colours of its own, without dithering, which would flicker and take room."""
    Image, content = load_package("PIL.Image"), io.BytesIO()
    quantized = (
        Image.fromarray(picture).quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        for picture in pictures
    )
    next(quantized).save(content, "GIF", save_all=True, append_images=quantized, duration=1000 / rate, loop=0)
    return content.getvalue()


def _encode_mp4(pictures: Iterable[Array], rate: float) -> bytes:
    """By imageio's encoder, a program that writes a file."""
    load_package("imageio_ffmpeg")
    imageio = load_package("imageio.v2")
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        with imageio.get_writer(film, fps=rate, **MP4_SETTINGS) as writer:
            for picture in pictures:
                writer.append_data(picture)
        return film.read_bytes()
