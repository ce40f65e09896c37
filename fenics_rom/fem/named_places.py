"""What the places of a scene pick of its mesh, and the groups of the mesh, to be listed and drawn."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import MeshError, SceneError
from fenics_rom.fem.cell_points import cell_volumes, checked_nodes
from fenics_rom.fem.mesh import Mesh, read_mesh
from fenics_rom.fem.nodes import Nodes, triangle_areas
from fenics_rom.fem.places import held_nodes, patch_nodes, patch_triangles, picked_cells
from fenics_rom.mechanics.readings import OF_SURFACE
from fenics_rom.scene.places import CellPlace, Held, Place, given_piece
from fenics_rom.scene.scene import ReadingEntry, Scene


@dataclass(frozen=True)
class PickedPlace:
    """What a place picks: nodes (supports), triangles of the surface, or cells.

    Attributes:
        name: where it is in the scene, as contacts.tip; of a group of the mesh "mesh: " and its name.
        kind: "nodes", "triangles" or "cells".
        count: how many of this kind.
        nodes: (n,) all of them, of the triangles or cells too.
        triangles: (t, 3) that show it, between vertices: its own, or the outer faces of its cells; none of nodes.
        size: m² of triangles, m³ of cells, 0 of nodes.
        corners: (2, 3), m, of the box along the axes around it.
    """

    name: str
    kind: str
    count: int
    nodes: Array
    triangles: Array
    size: float
    corners: Array


@dataclass(frozen=True)
class Survey:
    """The places of a scene: what they pick, and why others pick nothing.

    Attributes:
        coordinates: (N, 3), m, of all nodes.
        surface: (F, 3) outward triangles, between vertices.
        places: in the order of the scene, then groups of the mesh.
        mistakes: one sentence for each place that picks nothing.
    """

    coordinates: Array
    surface: Array
    places: tuple[PickedPlace, ...]
    mistakes: tuple[str, ...]


def survey_places(scene: Scene) -> Survey:
    """Picks all places of a scene; on one rank.

    Raises:
        MeshError: the mesh cannot be used.
    """
    mesh = read_mesh(scene.mesh_file, scene.mesh_groups, scene.mesh_scale)
    nodes = checked_nodes(mesh, scene.degree)
    supports = {"clamped": scene.clamped, "held": scene.held, "rigid": scene.rigid}
    whole: dict[str, Any] = {"supports": supports, "contacts": scene.contacts, "actuators": scene.actuators}
    whole |= scene.read | {"effects": scene.effects, "materials": scene.materials}
    places: list[PickedPlace] = []
    mistakes = []
    for name, place in _places_in(whole, ""):
        try:
            places.append(_picked(name, place, mesh, nodes))
        except (MeshError, SceneError) as error:
            mistakes.append(str(error) if name in str(error) else f"{name}: {error}")
    for name, triangles in mesh.surfaces.items():
        if len(triangles):
            place, label = Place(surface=name), f"mesh: {name}"
            found = _of_nodes(label, nodes, held_nodes(nodes, place, label))  # which may be inside the body
            with suppress(MeshError):
                found = _of_triangles(label, nodes, patch_triangles(nodes, place, label))
            places.append(found)
    for name, cells in mesh.regions.items():
        if len(cells):
            places.append(_of_cells(f"mesh: {name}", mesh, nodes, np.isin(np.arange(len(mesh.cells)), cells)))
    return Survey(nodes.coordinates, nodes.surface, tuple(places), tuple(mistakes))


def named_surfaces(scene: Scene, nodes: Nodes) -> dict[str, Array]:
    """Nodes of the surfaces that have names: groups of the mesh, and places of the scene by where they are in it."""
    found = {}
    others = {"actuators": scene.actuators, **scene.read, "effects": scene.effects}
    groups = ((name, Place(surface=name)) for name, triangles in nodes.mesh.surfaces.items() if len(triangles))
    for name, place in (*groups, *_places_in(others, "")):
        if isinstance(place, Place) and (place.surface is None or name == place.surface):
            with suppress(MeshError, SceneError):  # it is inside the body, or assembly says what is wrong with it
                found[name] = patch_nodes(nodes, place, name)
    return found


def _places_in(part: Any, where: str) -> Iterator[tuple[str, Place | CellPlace]]:
    """All places in a record, by where they are."""
    if isinstance(part, ReadingEntry):
        if part.quantity in OF_SURFACE and part.place is not None:
            yield where, part.place
    elif isinstance(part, Place | CellPlace):
        if given_piece(part) is not None or (isinstance(part, Held) and part.point is not None):
            yield where, part
    elif isinstance(part, tuple):
        for k, inner in enumerate(part):
            yield from _places_in(inner, f"{where}[{k}]")
    elif is_dataclass(part) or isinstance(part, Mapping):
        parts = part if isinstance(part, Mapping) else {one.name: getattr(part, one.name) for one in fields(part)}
        for key, inner in parts.items():
            yield from _places_in(inner, f"{where}.{key}" if where else key)


def _picked(name: str, place: Place | CellPlace, mesh: Mesh, nodes: Nodes) -> PickedPlace:
    if isinstance(place, CellPlace):
        return _of_cells(name, mesh, nodes, picked_cells(mesh, place, name))
    if name.startswith(("supports.clamped", "supports.held", "effects.driven_support")):
        return _of_nodes(name, nodes, held_nodes(nodes, place, name))
    return _of_triangles(name, nodes, patch_triangles(nodes, place, name))


def _corners(points: Array) -> Array:
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _of_nodes(name: str, nodes: Nodes, which: Array) -> PickedPlace:
    none = np.empty((0, 3), dtype=int)
    return PickedPlace(name, "nodes", len(which), which, none, 0.0, _corners(nodes.coordinates[which]))


def _of_triangles(name: str, nodes: Nodes, triangles: Array) -> PickedPlace:
    which, area = np.unique(nodes.triangle_nodes(triangles)), float(triangle_areas(nodes, triangles).sum())
    corners = _corners(nodes.coordinates[which])
    return PickedPlace(name, "triangles", len(triangles), which, triangles, area, corners)


def _of_cells(name: str, mesh: Mesh, nodes: Nodes, chosen: Array) -> PickedPlace:
    faces = nodes.kind.triangles(nodes.cells[chosen])[0].reshape(-1, 3)
    _, first, times = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    which, volume = np.unique(nodes.cell_nodes[chosen]), float(cell_volumes(nodes)[chosen].sum())
    corners = _corners(nodes.coordinates[which])
    return PickedPlace(name, "cells", int(chosen.sum()), which, faces[first[times == 1]], volume, corners)
