"""A mesh with colours at its vertices as binary glTF (Khronos, glTF 2.0): a browser interpolates them.

viser's plain meshes have one colour (1.1), and trimesh, its writer of glTF, gives a mesh either colours at vertices or
a material; without one it is a mirror of metal. Colours are of linear light, as glTF has them, and in single precision:
eight bits of linear light are too few for dark colours.
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray as Array

TRIANGLES, FLOAT, UNSIGNED = 4, 5126, 5125
MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942


@dataclass(frozen=True)
class Part:
    """Triangles that are drawn alike: faces (t, 3) into the vertices, in one colour, or in those of the vertices."""

    faces: Array
    colour: tuple[float, float, float] | None = None


def encode_mesh(places: Array, colours: Array, parts: Sequence[Part], opacity: float | None) -> bytes:
    """The file of a mesh that is seen from both sides, neither metal nor mirror.

    Args:
        places: of vertices, (V, 3).
        colours: red, green and blue of vertices, (V, 3), 0 to 1 of linear light.
        parts: triangles; light has an edge between two parts.
        opacity: 0 to 1; None: it is not seen through.
    """
    at = places.astype("<f4")
    blocks = [at, colours.astype("<f4"), *(part.faces.astype("<u4") for part in parts)]
    ends = np.cumsum([block.nbytes for block in blocks]).tolist()
    vertices = {"componentType": FLOAT, "count": len(at), "type": "VEC3"}
    accessors: list[dict[str, Any]] = [
        {**vertices, "bufferView": 0, "min": at.min(axis=0).tolist(), "max": at.max(axis=0).tolist()},
        {**vertices, "bufferView": 1},
    ]
    primitives, materials = [], []
    for k, part in enumerate(parts):
        normals = len(accessors)  # all zero, viser fills them in; without any a browser shades each triangle alone
        accessors += [
            vertices,
            {"componentType": UNSIGNED, "count": part.faces.size, "type": "SCALAR", "bufferView": 2 + k},
        ]
        attributes = {"POSITION": 0, "NORMAL": normals} | ({"COLOR_0": 1} if part.colour is None else {})
        primitives.append({"attributes": attributes, "indices": normals + 1, "material": k, "mode": TRIANGLES})
        factor = [*(part.colour or (1.0, 1.0, 1.0)), 1.0 if opacity is None else opacity]
        materials.append(
            {
                "pbrMetallicRoughness": {"baseColorFactor": factor, "metallicFactor": 0.0, "roughnessFactor": 1.0},
                "alphaMode": "OPAQUE" if opacity is None else "BLEND",
                "doubleSided": True,
            }
        )
    head = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives}],
        "materials": materials,
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": end - block.nbytes, "byteLength": block.nbytes}
            for block, end in zip(blocks, ends, strict=True)
        ],
        "buffers": [{"byteLength": ends[-1]}],
    }
    text = json.dumps(head, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join(
        [
            struct.pack("<III", MAGIC, VERSION, 28 + len(text) + ends[-1]),
            struct.pack("<II", len(text), JSON_CHUNK),
            text,
            struct.pack("<II", ends[-1], BINARY_CHUNK),
            *(block.tobytes() for block in blocks),
        ]
    )
