"""Matrices that Abaqus has written, with the input file they are of, reduced on the command line.

    python demos/own_matrices/abaqus_rotor.py

The rotor is that of Exudyn's test `compareAbaqusAnsysRotorEigenfrequencies` (J. Gerstmayr and S. Holzinger): 115 nodes,
48 bricks C3D8, free. Abaqus is not at hand, so its files are written here: the mesh anew from its dimensions, matrices
of the element that Abaqus' manual describes, lumped masses and the mean dilatation of each brick. The first frequency
is the one which that test states for the matrices that Abaqus wrote.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from checks import energy_gap, round_off, transfer_error

import fenics_rom as fr

FREQUENCY = 104.6370132606291  # Hz, as stated there; of 2.1e9 Pa
Array = np.ndarray
CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
NATURAL = np.vstack([np.column_stack([CORNERS, np.full(4, ζ)]) for ζ in (-1, 1)])  # of C3D8


def rotor_mesh():
    """Points (115, 3), m, and bricks (48, 8): a square shaft, and a disc around it."""
    shaft = 0.05 * np.array([-1.0, 0.0, 1.0])
    squares = [(shaft[i], shaft[j], shaft[i + 1], shaft[j + 1]) for i in (0, 1) for j in (0, 1)]
    bricks = [
        [(x, y, z) for z in (0.05 * k, 0.05 * k + 0.05) for x, y in ((a, b), (c, b), (c, d), (a, d))]
        for k in range(10)
        for a, b, c, d in squares
    ]
    turns = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)])
    rim = turns * np.where(turns.all(axis=1), 0.138581932, 0.195984438)[:, None]
    for k in range(8):
        section = [0.05 * turns[k], rim[k], rim[(k + 1) % 8], 0.05 * turns[(k + 1) % 8]]
        bricks.append([(x, y, z) for z in (0.1, 0.15) for x, y in section])
    corners = np.array(bricks).reshape(-1, 3)
    points, cells = np.unique(np.round(corners, 9), axis=0, return_inverse=True)
    return points.astype(np.float32).astype(float), cells.reshape(-1, 8)


def brick_matrices(points, cells, young=2.1e9, poisson=0.3, density=7850.0):
    """M, lumped by the sums of its rows, and K, with the mean dilatation of each brick."""
    size = 3 * len(points)
    M, K = np.zeros((size, size)), np.zeros((size, size))
    λ, μ = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
    C = np.diag([2 * μ, 2 * μ, 2 * μ, μ, μ, μ])
    C[:3, :3] += λ
    for cell in cells:
        gauss = []
        for place in NATURAL / np.sqrt(3):
            factors = 1 + NATURAL * place
            slopes = np.stack([NATURAL[:, i] * np.delete(factors, i, 1).prod(axis=1) for i in range(3)], axis=1) / 8
            J = slopes.T @ points[cell]
            gauss.append((factors.prod(axis=1) / 8, slopes @ np.linalg.inv(J).T, np.linalg.det(J)))
        volume = sum(weight for *_, weight in gauss)
        mean = sum(weight * gradient for _, gradient, weight in gauss) / volume
        at = (3 * cell[:, None] + np.arange(3)).ravel()
        for shape, (gx, gy, gz), weight, gradient in ((s, g.T, w, g) for s, g, w in gauss):
            o = 0 * gx
            rows = [(gx, o, o), (o, gy, o), (o, o, gz), (gy, gx, o), (gz, o, gx), (o, gz, gy)]
            B = np.array([np.stack(row, axis=1).ravel() for row in rows])
            B[:3] += ((mean - gradient) / 3).ravel()
            K[np.ix_(at, at)] += weight * B.T @ C @ B
            M[at, at] += density * weight * np.repeat(shape, 3)
    return M, K


def write_inp(file, points, cells, kind="C3D8"):
    """As Abaqus/CAE does, with nine digits."""
    nodes = "\n".join(f"{n}, {x:.9g}, {y:.9g}, {z:.9g}" for n, (x, y, z) in enumerate(points, 1))
    bricks = "\n".join(f"{e}, {', '.join(str(n + 1) for n in cell)}" for e, cell in enumerate(cells, 1))
    ends = [n for n, z in enumerate(points[:, 2], 1) if z == points[:, 2].max()]
    sets = f"*Nset, nset=End, instance=rotor-1\n {', '.join(map(str, ends))}\n*Nset, nset=Middle\n 58,"
    file.write_text(f"*Heading\n*Node\n{nodes}\n*Element, type={kind}\n{bricks}\n{sets}\n")


def write_matrix(file, A, style):
    """One half in MATRIX INPUT, both or one in COORDINATE."""
    rows, columns = np.nonzero(A)
    kept = rows >= columns if style != "both" else rows >= 0
    with file.open("w") as stream:
        for i, j in zip(rows[kept], columns[kept], strict=True):
            of_row, of_column = (
                (f"{i // 3 + 1},{i % 3 + 1}", f" {j // 3 + 1},{j % 3 + 1}, ")
                if style == "labels"
                else (f"{i + 1}", f" {j + 1} ")
            )
            stream.write(f"{of_row}{',' if style == 'labels' else ''}{of_column}{A[i, j]: .15e}\n")


COMMAND = """
fenics-rom reduce --mass rotor_MASS1.mtx --stiffness rotor_STIF1.mtx --rayleigh 0 1e-6
    --nodes rotor.inp --contact end=End --observe middle=Middle --order 24 -o rotor.h5
"""


def main() -> None:
    """Writes the files, reduces, and checks."""
    points, cells = rotor_mesh()
    M, K = brick_matrices(points, cells)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_inp(folder / "rotor.inp", points, cells)
        files = {"mass": folder / "rotor_MASS1.mtx", "stiffness": folder / "rotor_STIF1.mtx"}
        for file, matrix in zip(files.values(), (M, K), strict=True):
            write_matrix(file, matrix, "labels")
        print(COMMAND)
        arguments = COMMAND.split()[1:]
        subprocess.run([sys.executable, "-m", "fenics_rom", *arguments], cwd=folder, check=True)
        rom = fr.read_rom(folder / "rotor.h5")
        nodes = folder / "rotor.inp"
        system = fr.read_system(**files, rayleigh=(0.0, 1e-6), nodes=nodes, contacts={"end": "End"})

    body = fr.Simulator(rom, dt=1e-4)
    for _ in range(1000):
        body.step([100.0, 0.0, 0.0])  # N, on one end
    first = np.sqrt(rom.contact_models["end"].eigenvalues[6]) / (2 * np.pi)
    error = transfer_error(system, rom, "end", [600.0, 650.0, 700.0])
    print(f"first frequency {first:.6f} Hz, stated are {FREQUENCY:.6f} Hz; {len(rom.triangles)} triangles are drawn")
    print(f"energy account closes to {energy_gap(body):.1e}, transfer functions to {error:.1e}")
    assert abs(first / FREQUENCY - 1) <= 1e-6
    assert energy_gap(body) <= round_off(body)
    assert error <= 1e-2


if __name__ == "__main__":
    main()
