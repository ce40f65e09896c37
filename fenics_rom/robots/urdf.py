"""What a URDF file may say, checked with the line, and made ready for MuJoCo, which reads it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.robots.xml_lines import Element

MOVING = ("revolute", "continuous", "prismatic", "floating")
TYPES = (*MOVING, "fixed")
READ = (".stl", ".obj")  # meshes that MuJoCo reads
LARGEST = 20.0  # m: what is larger is most likely in mm
OPTIONS = {
    "strippath": "false",
    "discardvisual": "false",
    "fusestatic": "false",
    "inertiafromgeom": "false",
    "boundmass": "1e-9",
    "boundinertia": "1e-15",
}


class Urdf:
    """A URDF file.

    Args:
        root: its element.
        folder: what paths of meshes begin with.
        source: its name, for messages.

    Attributes:
        left_out: what of it is not taken over.

    Raises:
        SceneError: what is not allowed, with the line.
    """

    def __init__(self, root: Element, folder: Path, source: str):
        self._root, self._folder, self._source, self.left_out = root, folder, source, list[str]()
        self._links = {link.given.get("name", ""): link for link in root.all("link")}
        self._joints = {joint.given.get("name", ""): joint for joint in root.all("joint")}
        self._check_tree()
        for name, link in self._links.items():
            self._check_inertia(name, link)
        self._check_mimics()
        for link in self._links.values():
            self._check_shapes(link)

    def _refuse(self, where: Element, said: str) -> SceneError:
        return SceneError(f"{self._source}, line {where.line}: {said}")

    def _check_tree(self) -> None:
        parents = dict[str, tuple[str, Element]]()
        for name, joint in self._joints.items():
            kind = joint.given.get("type", "")
            if kind not in TYPES:
                raise self._refuse(joint, f"joint {name!r}: type = {kind!r}: use one of {', '.join(TYPES)}")
            ends = [joint.first(tag) for tag in ("parent", "child")]
            names = ["" if end is None else end.given.get("link", "") for end in ends]
            for end, link in zip(("parent", "child"), names, strict=True):
                if link not in self._links:
                    raise self._refuse(joint, f"joint {name!r}: {end} = {link!r}: there is no such link")
            if names[1] in parents:
                other = parents[names[1]][1]
                raise self._refuse(
                    joint,
                    f"joint {name!r}: closes a loop, as link {names[1]!r} has a parent by joint "
                    f"{other.given.get('name')!r}, line {other.line}: use a tree; "
                    "a joint of the world may close it",
                )
            parents[names[1]] = names[0], joint
            self._check_distance(joint, f"joint {name!r}")
        for link in self._links:
            seen = [link]
            while seen[-1] in parents:
                seen.append(parents[seen[-1]][0])
                if seen[-1] == link:
                    raise self._refuse(parents[link][1], f"links {' in '.join(seen)}: a loop; use a tree")
        self._parents = parents

    def _check_distance(self, of: Element, what: str) -> None:
        origin = of.first("origin")
        if origin is not None and np.abs(self._numbers(origin, "xyz", 3)).max() > LARGEST:
            raise self._refuse(
                origin, f"{what}: xyz = {origin.given['xyz']!r}: is farther than {LARGEST:g} m: its unit is m, not mm"
            )

    def _numbers(self, of: Element, key: str, count: int) -> Array:
        given = of.given.get(key, " ".join(["0"] * count))
        try:
            numbers = np.array([float(each) for each in given.split()])
        except ValueError:
            numbers = np.empty(0)
        if len(numbers) != count or not np.isfinite(numbers).all():
            raise self._refuse(of, f"{key} = {given!r}: use {count} finite number{'s' * (count > 1)}")
        return numbers

    def _check_inertia(self, name: str, link: Element) -> None:
        inertial = link.first("inertial")
        by = self._parents.get(name)
        if inertial is None:
            if by is not None and by[1].given["type"] in MOVING:
                raise self._refuse(
                    link,
                    f"link {name!r}: has no <inertial>, and joint {by[1].given.get('name')!r} moves it: use a "
                    "mass > 0 with an inertia",
                )
            return
        mass, inertia = inertial.first("mass"), inertial.first("inertia")
        if mass is None or inertia is None:
            raise self._refuse(inertial, f"link {name!r}: <{'mass' if mass is None else 'inertia'}> is missing")
        value = float(self._numbers(mass, "value", 1)[0])
        is_still = value == 0 and (by is None or by[1].given["type"] not in MOVING)
        if not (value > 0 or is_still):
            raise self._refuse(mass, f"link {name!r}: mass = {value!r} kg: use a number > 0")
        xx, yy, zz, xy, xz, yz = (
            float(self._numbers(inertia, key, 1)[0]) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if not is_still and (moments[0] <= 0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-6)):
            raise self._refuse(
                inertia,
                f"link {name!r}: principal moments {moments.tolist()} kg m2: use moments > 0, none larger than "
                "the sum of the others",
            )
        if not is_still and moments[2] > value * LARGEST**2:
            raise self._refuse(inertia, f"link {name!r}: inertia of {value:g} kg: its unit is kg m2, not kg mm2")

    def _check_mimics(self) -> None:
        for name, joint in self._joints.items():
            chain, at = [name], joint.first("mimic")
            while at is not None:
                leader = at.given.get("joint", "")
                if leader not in self._joints:
                    raise self._refuse(at, f"joint {chain[-1]!r}: mimics {leader!r}: there is no such joint")
                chain.append(leader)
                if leader in chain[:-1]:
                    raise self._refuse(at, f"mimic: {' follows '.join(chain)}: use a chain without a circle")
                at = self._joints[leader].first("mimic")

    def _check_shapes(self, link: Element) -> None:
        for tag in ("collision", "visual"):
            for shape in link.all(tag):
                for mesh in [each for each in shape.everywhere() if each.tag == "mesh"]:
                    file = self._mesh_file(mesh)
                    if file.suffix.lower() not in READ:
                        if tag == "collision":
                            raise self._refuse(
                                mesh, f"mesh {file.name}: use for a collision {', '.join(READ)}; convert it"
                            )
                        self.left_out.append(f"line {mesh.line}: visual mesh {file.name}, which is no .stl or .obj")
                        link.children.remove(shape)
                        break
                    mesh.given["filename"] = str(file.resolve())

    def _mesh_file(self, mesh: Element) -> Path:
        name = mesh.given.get("filename", "")
        path = name.removeprefix("file://")
        if path.startswith("package://"):
            path = path.removeprefix("package://")
            inside = path.partition("/")[2]
            above = [self._folder.resolve(), *self._folder.resolve().parents]
            found = [folder / some for folder in above for some in (path, inside) if (folder / some).is_file()]
            if found:
                return found[0]
        if not (self._folder / path).is_file():
            raise self._refuse(mesh, f"mesh {name!r}: there is no such file beside {self._source} or above its folder")
        return self._folder / path

    def has_mass(self, link: str) -> bool:
        """Whether a link has an inertia."""
        return self._links[link].first("inertial") is not None

    def text(self) -> str:
        """As MuJoCo reads it."""
        extension = Element("mujoco", {}, 0, [Element("compiler", OPTIONS, 0)])
        return Element("robot", self._root.given, 0, [extension, *self._root.children]).text()

    def check_size(self, size: Callable[[str], float]) -> None:
        """A SceneError where a link is so large that its meshes are in mm; size: of a link by name, m."""
        for name, link in self._links.items():
            meshes = [each for each in link.everywhere() if each.tag == "mesh"]
            if meshes and size(name) > LARGEST:
                raise self._refuse(
                    meshes[0],
                    f"link {name!r}: its mesh is {size(name):.3g} m large: a unit of a mesh is 1 m, of one in mm give "
                    'scale="0.001 0.001 0.001"',
                )
