"""ROM and run files that no writer of this project makes, reproducible by seed.

A seal keeps accidents away from HDF5: flipped bits, torn files. What a mistake in a program writes with HDF5 is sealed
like a real file, and has to be seen by what it says.
"""

import io
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path

import h5py
import numpy as np

import fenics_rom as fr
from fenics_rom.errors import FenicsRomError, FileError
from fenics_rom.io.hdf5 import SEAL_SIZE, content_of, sealed

DATA = Path(__file__).parents[1] / "data"
ORIGINALS = ("rom-1.0.h5", "rom-1.1.h5", "rom-1.2.h5", "run-1.0.h5", "run-1.2.h5", "oblique.h5")
VALUES = (
    *(np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 5e-324, 1e-308, 1e-200, 1e-20, 1e20, 1e150, 1e154, 1e200, 1.7e308),
    -1e300,
)
WHOLE = (0, 1, -1, 2, 3, 10**6, 2**31, 2**53, 2**62, 2**63 - 1, -(2**63))
STEPS = 5

Random = np.random.Generator


@cache
def original(name: str) -> bytes:
    """A file as it is written; one of them is not among the data."""
    if name != "oblique.h5":
        return (DATA / name).read_bytes()
    import tempfile

    chain = 2 * np.eye(7) - np.eye(7, k=1) - np.eye(7, k=-1)
    ends = {"first": np.eye(7)[:, :1], "last": np.eye(7)[:, 6:]}
    system = fr.System(
        mass=np.eye(7), damping=chain / 9, stiffness=chain, contacts=ends, outputs={"e": np.eye(7)[:, :3]}
    )
    with tempfile.TemporaryDirectory() as folder:
        fr.write_rom(Path(folder) / name, fr.reduce(system, order=3, switching="oblique"))
        return (Path(folder) / name).read_bytes()


def prepare(folder: Path) -> None:
    """What all cases need."""
    for name in ORIGINALS:
        original(name)


def mutated(random: Random) -> tuple[str, bytes]:
    """What was done, and the file."""
    name = ORIGINALS[random.integers(len(ORIGINALS))]
    kind = KINDS[random.choice(len(KINDS), p=SHARES)]
    return f"{name}, {kind.__name__}", kind(original(name), random)


def outcome(content: bytes, folder: Path) -> str:
    """Reads a file, and does what there is to do with it. Any other error than those of this package goes through."""
    file = folder / "mutated.h5"
    file.write_bytes(content)
    try:
        what = content_of(file)
        if what == "run":
            record = fr.read_trajectory(file)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return f"a run, read, and {compared(record)}"
        rom = fr.read_rom(file)
    except FenicsRomError as error:
        return refused(error, FileError)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return f"a ROM, read, and {stepped(rom)}"


def refused(error: Exception, *kinds: type[Exception]) -> str:
    """Of an error that is one of those that may come, in one line."""
    assert isinstance(error, kinds)
    assert "\n" not in str(error)
    return "refused"


def compared(record: fr.Trajectory) -> str:
    """Compares a run with itself."""
    try:
        fr.compare(record, record)
        record.balance_error  # noqa: B018
    except FenicsRomError:
        return "refused to compare"
    return "compared"


def stepped(rom: fr.Rom) -> str:
    """Steps a ROM in each contact mode, with switches, in a row and in a batch, and runs its scene."""
    try:
        body = fr.Simulator(rom, dt=1e-3)
        for name in rom.contact_models:
            body.switch(name)
            for _ in range(STEPS):
                body.step(np.ones(body.inputs))
            for output in rom.outputs:
                body.displacement(output)
            assert body.ledger is not None
            body.energy, body.ledger.supplied, body.contact  # noqa: B018
        if rom.environment.is_plain:
            body.rollout(np.ones((STEPS, body.inputs)))
            columns = max(mode.inputs.shape[1] for mode in rom.contact_models.values())
            fr.Batch(rom, size=2, dt=1e-3).step(np.zeros((2, columns)))
        if rom.environment.run is not None:
            fr.simulate(rom, dt=0.01)
    except FenicsRomError:
        return "refused to step"
    return "stepped"


# --- bytes -----------------------------------------------------------------------------------------------------------


def unsealed(content: bytes, random: Random) -> bytes:
    """Damage: flipped bits, a torn or a longer file. None of these may be read."""
    data = bytearray(content)
    if random.random() < 0.2:
        return content[: random.integers(len(content))]
    if random.random() < 0.1:
        return content + random.bytes(random.integers(1, 100))
    for at in random.integers(len(data), size=random.integers(1, 9)):
        data[at] ^= 1 << random.integers(8)
    return bytes(data)


def seal(content: bytes) -> bytes:
    """The same with a seal that is right."""
    return sealed(content) + content[SEAL_SIZE:]


# --- what HDF5 can hold ----------------------------------------------------------------------------------------------


def rewritten(content: bytes, random: Random) -> bytes:
    """Written by HDF5, and not what it says: arrays changed, swapped, of other sizes and kinds, links, odd storage."""
    memory = io.BytesIO(content)
    with h5py.File(memory, "r+") as h5:
        for _ in range(random.integers(1, 3)):
            places: list[str] = []
            h5.visit(places.append)
            change = CHANGES[random.integers(len(CHANGES))]
            with suppress(Exception):  # after one change there may not be all that another needs
                change(h5, [h5[place] for place in places], random)
    return seal(memory.getvalue())


def _arrays(objects: Iterable[h5py.HLObject]) -> list[h5py.Dataset]:
    return [one for one in objects if isinstance(one, h5py.Dataset)]


def _one(things: list, random: Random):  # type: ignore[no-untyped-def, type-arg]
    return things[random.integers(len(things))]


def _replaced(h5: h5py.File, old: h5py.Dataset, data: object = None, **options: object) -> None:
    """Another array of the same name and unit."""
    name, unit = old.name, old.attrs.get("unit")
    del h5[name]
    new = h5.create_dataset(name, data=data, **options)
    if unit is not None:
        new.attrs["unit"] = unit


def values(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """Some numbers, or all of them."""
    array = _one(_arrays(objects), random)
    new = array[()]
    odd = VALUES if new.dtype.kind == "f" else WHOLE
    at = random.random(new.shape) < random.choice([0.02, 0.2, 1.0])
    way = random.integers(4)
    if way == 0 or new.dtype.kind != "f" or not new.ndim:
        new[at] = odd[random.integers(len(odd))]
    elif way == 1:
        new[at] *= 10.0 ** random.uniform(-300, 300)
    elif way == 2:
        new[at] += 1e-9 * random.standard_normal(np.count_nonzero(at))
    else:
        new = random.permutation(new.ravel()).reshape(new.shape)
    array[...] = new


def scaled(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """All of an array by a power of ten: what stays consistent stays readable."""
    names = ("inputs", "basis", "damping", "nodes", "node_mass", "tip", "0", "alpha", "acceleration", "times")
    found = [one for one in _arrays(objects) if one.name.split("/")[-1] in names and one.dtype.kind == "f"]
    array = _one(found, random)
    array[...] = array[()] * 10.0 ** random.uniform(-308, 308)


def stiffened(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """The whole body stiffer or softer by orders of magnitude, and consistently so."""
    factor = 10.0 ** random.uniform(-330, 330)
    for array in _arrays(objects):
        if array.name == "/stiffness" or array.name.endswith("/eigenvalues"):
            array[...] = array[()] * factor


def swapped(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """Two arrays, or an array and a group, under each other's name."""
    one, other = (_one(objects, random).name for _ in range(2))
    h5.move(one, "/between")
    h5.move(other, one)
    h5.move("/between", other)


def removed(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """A group, an array or an attribute less."""
    one = _one(objects, random)
    if random.random() < 0.3 and len(one.attrs):
        del one.attrs[_one(list(one.attrs), random)]
    elif random.random() < 0.3:
        del h5.attrs[_one(list(h5.attrs), random)]
    else:
        del h5[one.name]


def reshaped(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """Another shape: rows fewer or more, dimensions more or none."""
    old = _one(_arrays(objects), random)
    data = old[()]
    new = (
        *(data[:0], data[:1], data[:-1], data[None], data.ravel(), np.repeat(data, 2, 0), data.T, data[..., :0]),
        np.array(data.sum()),
    )
    _replaced(h5, old, new[random.integers(len(new))])


def another_kind(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """Numbers of other widths and orders of bytes, texts, references, records, sequences, and nothing."""
    old = _one(_arrays(objects), random)
    shape = old.shape
    kind = (
        *("<f4", ">f8", ">i8", "<u8", "i4", "S8", "bool", "complex128", "f2", h5py.ref_dtype, h5py.regionref_dtype),
        *(h5py.string_dtype(), h5py.vlen_dtype(np.float64), h5py.enum_dtype({"a": 1}), np.dtype("(2,)f8")),
        *(h5py.opaque_dtype(np.dtype("V8")), np.dtype([("x", "f8"), ("y", h5py.string_dtype())]), h5py.Empty("f8")),
    )[random.integers(18)]
    if isinstance(kind, h5py.Empty):
        _replaced(h5, old, kind)
    else:
        _replaced(h5, old, shape=shape, dtype=kind)


def announced(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """Sizes that lie: little or nothing is stored of them, or it is packed a thousand times smaller."""
    old = _one(_arrays(objects), random)
    shape = tuple(int(n) for n in random.choice([1, 8, 1000, 10**6, 2**31, 2**40, 2**61], size=max(1, old.ndim)))
    way = random.integers(4)
    if way == 0:
        _replaced(h5, old, shape=shape, dtype=old.dtype)
    elif way == 1:
        _replaced(h5, old, shape=shape, dtype=old.dtype, chunks=(1,) * len(shape))
    elif way == 2:
        _replaced(h5, old, shape=(2**21, *shape[1:])[: old.ndim] or (2**21,), dtype=old.dtype, compression="gzip")
        if h5[old.name].size < 2**23:
            h5[old.name][...] = 1
    else:
        _replaced(h5, old, shape=old.shape, dtype=old.dtype, fillvalue=7)


def stored_otherwise(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """In chunks, packed, in the header, in other files, or nowhere."""
    old = _one(_arrays(objects), random)
    data = old[()]
    way = random.integers(6)
    if way == 0:
        _replaced(h5, old, data, chunks=True)
    elif way == 1:
        _replaced(h5, old, data, compression=_one(["gzip", "lzf"], random), shuffle=True)
    elif way == 2:
        _replaced(h5, old, shape=data.shape, dtype=data.dtype, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)])
    elif way == 3:
        layout = h5py.VirtualLayout(shape=data.shape, dtype=data.dtype)
        layout[...] = h5py.VirtualSource("/tmp/other.h5", "x", shape=data.shape)
        name, unit = old.name, old.attrs["unit"]
        del h5[name]
        h5.create_virtual_dataset(name, layout, fillvalue=1)
        h5[name].attrs["unit"] = unit
    elif way == 4:
        _replaced(h5, old, data, maxshape=(None,) * data.ndim)
    else:
        _replaced(h5, old, data, fletcher32=True)


def linked(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """Names that lead elsewhere: in circles, to other files, to what there is already, to nothing."""
    name = _one(objects, random).name
    target = _one(objects, random).name
    way = random.integers(5)
    to = (
        h5py.SoftLink(target),
        h5py.SoftLink(name),
        h5py.ExternalLink("/proc/self/mem", "/"),
        h5py.ExternalLink(str(DATA / "rom-1.2.h5"), name),
        h5[target],
    )[way]
    if random.random() < 0.6:
        del h5[name]
    else:
        name = f"{name.rpartition('/')[0]}/{random.choice(['more', '0', 'wind', 'é', '..', 'tip'])}"
    h5[name] = to


def told_otherwise(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """Texts and other attributes that are wrong, long, empty, no text, or a scene that does not belong there."""
    where = h5 if random.random() < 0.8 else _one(objects, random)
    name = _one(list(where.attrs) or ["unit"], random)
    old = where.attrs.get(name)
    text = old if isinstance(old, bytes) else b""
    at = int(random.integers(len(text) + 1))
    new = (
        *(b"x", b"\xff\xfe", b"\n", b"energy", b"oblique", b"modal", b"mass", b"run", b"rom", b"1.9", b"2"),
        *(np.bytes_(60_000 * b"x"), 1.0, np.arange(5), "text", ["a", "b"], h5py.Empty("S1"), h5py.Empty("f8")),
        *(h5.ref, np.bytes_(text[:at] + text[at + 1 :]), np.bytes_(text[:at] + b"9" + text[at:]), np.bytes_(text * 2)),
    )
    where.attrs[name] = new[random.integers(len(new))]


def regrouped(h5: h5py.File, objects: list[h5py.HLObject], random: Random) -> None:
    """More groups: empty ones, many, deep, or copies of contact modes and of anything else."""
    groups = [one for one in objects if isinstance(one, h5py.Group)]
    group = _one(groups, random)
    way = random.integers(4)
    if way == 0:
        group.create_group(_one(["more", "0", "gravity", "contact", "tip", "99", "\N{SNOWMAN}"], random))
    elif way == 1:
        for k in range(int(random.choice([3, 300]))):
            group.create_group(f"g{k}")
    elif way == 2:
        for _ in range(100):
            group = group.create_group("deeper")
    else:
        one = _one(objects, random)
        h5.copy(one, group, name=f"copy{random.integers(3)}" if random.random() < 0.5 else one.name.split("/")[-1])


CHANGES: tuple[Callable[[h5py.File, list[h5py.HLObject], Random], None], ...] = (
    *(values, values, values, scaled, stiffened, swapped, removed, reshaped, another_kind, announced),
    *(stored_otherwise, linked, told_otherwise, regrouped),
)
KINDS = (unsealed, rewritten)
SHARES = (0.2, 0.8)
