"""A link swings against a hand, bare and with foam on its tip: how hard, over ranges of speeds, masses and places.

    python demos/impact/impact.py                  # some minutes
    python demos/impact/impact.py --quick          # a part of it
    python demos/impact/impact.py --random 2000    # beside it, random runs at full order; goes on where it was left

Everything is written to demos/impact/out/. The checks at the end fail if a claim does not hold.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import fenics_rom as fr
from fenics_rom.certification.certify import Strikes
from fenics_rom.certification.models import models_of
from fenics_rom.certification.report import HEADING, coverage_lines, finding_rows, write_report
from fenics_rom.io.markdown import markdown
from fenics_rom.io.progress import silent

HERE = Path(__file__).parent
LINKS = ("bare", "soft")
QUICK = ("bare",)
QUICK_TOLERANCE = 0.5


def main() -> None:
    """Runs the demo; exits with 1 where a claim fails."""
    parser = argparse.ArgumentParser(description="A bare link and a soft one swing against a hand.")
    parser.add_argument("--quick", action="store_true", help="the bare link, with a wider tolerance")
    parser.add_argument("--random", type=int, metavar="N", help="random runs of each link at full order", default=0)
    choice = parser.parse_args()
    out = HERE / "out" / "quick" if choice.quick else HERE / "out"
    out.mkdir(parents=True, exist_ok=True)
    count = 3 if choice.quick else max(choice.random, 10)
    certificates, strikes, points = {}, {}, {}
    links = QUICK if choice.quick else LINKS
    for name in links:
        scene = fr.read_world(HERE / f"{name}.toml")
        if choice.quick:
            table = replace(scene.file.certificate, tolerance=QUICK_TOLERANCE)
            scene.raw["certificate"]["tolerance"] = QUICK_TOLERANCE
            scene = replace(scene, file=replace(scene.file, certificate=table))
        certificate = fr.certify(scene, runs_file=out / f"{name}.runs")
        fr.write_certificate(out / f"{name}.json", certificate, force=True)
        write_report(out / f"{name}.pdf", certificate)
        certificates[name] = fr.check_certificate(out / f"{name}.json", samples=1)
        print(f"{name} link\n\n{markdown(HEADING, finding_rows(certificate))}")
        print(*coverage_lines(certificate), *certificate.warnings, "", sep="\n")
        full = Strikes(scene, models_of(scene, silent)[1], scene.file.run.dt, out / f"{name}.full.runs")
        points[name] = np.random.default_rng(0).random((count, len(certificate.parameters)))
        strikes[name] = np.array([full(point) for point in points[name]])
    draw(certificates, strikes, points, out / "impact.png")

    claims = []
    for name, certificate in certificates.items():
        certified = np.array([each.certified for each in certificate.findings.values()])
        shares = strikes[name] / certified
        print(f"{name}: {count} random runs at full order; share of the certified force, pressure and energy")
        for told, part in (("half of them at most", 0.5), ("95 % at most", 0.95), ("all at most", 1.0)):
            print(f"  {told} {np.quantile(shares, part, axis=0).round(3).tolist()}")
        claims.append((f"{name} link: no random run is above its certificate", bool((shares < 1).all())))
        claims.append((f"{name} link: limits of hands and fingers are kept", certificate.is_kept is True))
    force = [certificate.findings["force"].certified for certificate in certificates.values()]
    if len(force) > 1:
        claims.append(("foam takes a third of the force, or more", force[1] < 2 / 3 * force[0]))
    for claim, holds in claims:
        print(f"  {'holds' if holds else 'FAILS'}: {claim}")
    sys.exit(0 if all(holds for _, holds in claims) else 1)


def draw(certificates: dict, strikes: dict, points: dict, file: Path) -> None:
    """Forces of random runs at full order over the speed, with what is certified."""
    figure, panels = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained", sharey=True)
    for axes, (name, certificate) in zip(panels, certificates.items(), strict=False):
        spin, found = certificate.parameters[0], certificate.findings["force"]
        searched = [spin.at(share) for share in certificate.cover.middles[:, 0]]
        axes.plot([spin.at(share) for share in points[name][:, 0]], strikes[name][:, 0], ".", color="0.6", markersize=3)
        axes.plot(searched, certificate.cover.values[:, 0], "x", color="tab:blue", label="runs of the search, reduced")
        axes.plot([], [], ".", color="0.6", label="random runs, full order")
        axes.axhline(found.certified, color="tab:red", label=f"certified: {found.certified:.1f} N")
        axes.set(xlabel="speed of the link (rad/s)", title=f"{name} link", ylim=(0, None))
        axes.legend(loc="lower right", fontsize=8)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("largest force on the hand (N)")
    figure.savefig(file, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main()
