"""The linear models of a ROM as an FMU: FMI 2.0, co-simulation, from the same C, with its source and compiled."""

import io
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import uuid
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

from fenics_rom.deployment.c_source import CSource, filled
from fenics_rom.errors import FileError, MissingPackageError
from fenics_rom.io.atomic_write import write_whole
from fenics_rom.rom.rom import Rom
from fenics_rom.version import VERSION

PLATFORMS = {"linux": ("linux64", ".so"), "darwin": ("darwin64", ".dylib"), "win32": ("win64", ".dll")}
FLAGS = ["-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden"]
ACCOUNT = tuple(f"energy.{what}" for what in ("stored", "supplied", "dissipated", "lost_in_switching"))  # J
BASE_UNITS = {  # exponents of the units that inputs and outputs have
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "m": {"m": 1},
    "m3": {"m": 3},
    "m/s2": {"m": 1, "s": -2},
    "1": {},
}
SAME_DATE = (1980, 1, 1, 0, 0, 0)  # of all parts: the same model is the same file


def write_fmu(place: Path, rom: Rom, plant: CSource) -> None:
    """Writes an FMU of a ROM's plant.

    Inputs are the columns of all contact modes, of which those of the active one act, actuators and loads, which begin
    with what is constant in the scene (gravity with 1), and the contact mode; outputs displacements and the account.

    Raises:
        MissingPackageError: there is no C compiler.
        FileError: it fails, or the file cannot be written.
    """
    start = dict.fromkeys(plant.inputs, 0.0)
    for load, acts in rom.environment.loads.items():
        if acts.signal is not None and acts.signal.times is None:
            values = acts.signal.values.tolist()
            names = [load] if len(values) == 1 else [f"{load}[{k}]" for k in range(len(values))]
            start |= dict(zip(names, values, strict=True))
    start |= plant.start
    words = {"name": plant.name, "NAME": plant.name.upper(), "dt": repr(plant.dt)}
    words["start"] = ", ".join([*map(repr, start.values()), "0.0"])
    wrapper = filled("fmi.c", {**words, "guid": "$guid"})
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, plant.header + plant.source + wrapper)}}}"
    sources = {
        f"{plant.name}.h": plant.header,
        f"{plant.name}.c": plant.source,
        f"{plant.name}_fmi.c": wrapper.replace("$guid", guid),
    }
    platform, ending = PLATFORMS.get(sys.platform, PLATFORMS["linux"])
    parts = {
        "modelDescription.xml": _description(rom, plant, guid, start),
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
        f"binaries/{platform}/{plant.name}{ending}": _compiled(place, sources),
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in parts.items():
            archive.writestr(zipfile.ZipInfo(name, SAME_DATE), content, zipfile.ZIP_DEFLATED)
    write_whole(place, stream.getbuffer())


def _compiled(place: Path, sources: dict[str, str]) -> bytes:
    """A shared library of these files, by $CC or cc."""
    compiler = shlex.split(os.environ.get("CC") or "cc")
    if shutil.which(compiler[0]) is None:
        raise MissingPackageError(
            f"{place}: an FMU holds compiled code, and there is no C compiler {compiler[0]!r}: "
            f"sudo apt-get install gcc; {place.with_suffix('.c')} needs none"
        )
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, "utf-8")
        files = [name for name in sources if name.endswith(".c")]
        run = subprocess.run([*compiler, *FLAGS, *files, "-o", "library"], cwd=folder, capture_output=True, text=True)
        if run.returncode:
            raise FileError(f"{place}: {compiler[0]} does not compile it: {run.stderr.strip()[:500]}")
        return (Path(folder) / "library").read_bytes()


def _description(rom: Rom, plant: CSource, guid: str, start: dict[str, float]) -> bytes:
    """modelDescription.xml."""
    root = ET.Element("fmiModelDescription", fmiVersion="2.0", modelName=plant.name, guid=guid)
    root.attrib |= {"description": f"reduced soft body {rom.name}", "generationTool": f"fenics_rom {VERSION}"}
    root.attrib |= {"variableNamingConvention": "flat"}
    abilities = ["canGetAndSetFMUstate", "canSerializeFMUstate"]
    abilities += ["canHandleVariableCommunicationStepSize"] if plant.has_account else []
    interface = ET.SubElement(root, "CoSimulation", modelIdentifier=plant.name)
    interface.attrib |= dict.fromkeys(abilities, "true")
    files = ET.SubElement(interface, "SourceFiles")
    for name in (f"{plant.name}.c", f"{plant.name}_fmi.c"):
        ET.SubElement(files, "File", name=name)
    outputs = {**plant.outputs, **dict.fromkeys(ACCOUNT if plant.has_account else (), "J")}
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in sorted({*plant.inputs.values(), *outputs.values()}):
        base_unit = ET.SubElement(ET.SubElement(units, "Unit", name=unit), "BaseUnit")
        base_unit.attrib |= {base: str(exponent) for base, exponent in BASE_UNITS[unit].items()}
    types = ET.SubElement(root, "TypeDefinitions")
    modes = ET.SubElement(ET.SubElement(types, "SimpleType", name="contact_mode"), "Enumeration")
    for number, contact in enumerate(plant.contact_modes, start=1):
        ET.SubElement(modes, "Item", name=contact, value=str(number))
    stop = 1.0 if rom.environment.run is None else rom.environment.run.duration
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime=repr(stop), stepSize=repr(plant.dt))
    variables = ET.SubElement(root, "ModelVariables")
    for reference, (name, unit) in enumerate({**plant.inputs, **outputs}.items()):
        causality = "input" if reference < len(plant.inputs) else "output"
        variable = ET.SubElement(variables, "ScalarVariable", name=name, valueReference=str(reference))
        variable.attrib |= {"causality": causality, "variability": "continuous"}
        real = ET.SubElement(variable, "Real", unit=unit)
        if name in start:
            real.set("start", repr(start[name]))
    active = ET.SubElement(variables, "ScalarVariable", name="contact.mode", valueReference="0", causality="input")
    active.attrib |= {"variability": "discrete"}
    ET.SubElement(active, "Enumeration", declaredType="contact_mode", start="1")
    structure = ET.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        unknowns = ET.SubElement(structure, kind)
        for index in range(len(plant.inputs) + 1, len(variables)):
            ET.SubElement(unknowns, "Unknown", index=str(index), dependencies="")
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)
