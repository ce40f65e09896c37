"""The Young's modulus that each measured number asks for, of an elastic beam, on the number's time scale."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array
from predictions import Prediction, elastic, sag_at_rest
from recordings import AT_REST, MARKERS, WINDOWS, Recording, Ringing
from relaxation import Law

import fenics_rom as fr
from fenics_rom.io.markdown import markdown

INSTANTS = (0.3, 1.0)  # s, at which the middle of the ringing is looked at
TRIED = (0.8, 0.95, 1.1)  # moduli between which sags are interpolated, as shares of the elastic one


@dataclass(frozen=True)
class Asked:
    """The modulus that one number asks for, Pa."""

    case: str
    number: str
    time: float  # s: since the release, or 1/ω of a vibration
    held_level: float  # if the tip was held where the straight beam has it
    held_below: float  # if it was held below that
    law: float  # what the law that relaxes has


def moduli_asked(
    recorded: dict[str, Recording], alone: fr.Scene, loaded: fr.Scene, foretold: Prediction, law: Law, level: float
) -> list[Asked]:
    """Of all recordings.

    Args:
        recorded: the recordings, by name.
        alone: the elastic beam without a weight.
        loaded: the scene with 52 g.
        foretold: what the elastic law says of that.
        law: the one that relaxes.
        level: by which the tip was held below level, m.
    """
    young = alone.materials["material"].young
    run = fr.simulate(fr.reduce(fr.assemble(alone), order=8))
    height = np.mean([run.outputs[name][:, 0, 2] for name in MARKERS], axis=0)
    shares = np.array(TRIED)
    loaded_sags = np.array([sag_at_rest(elastic(loaded, young * share, 0.0)) for share in shares])
    frequency = Ringing.of(run.times, height, *WINDOWS["alone"]).frequency
    return [
        *_asked(
            "alone", [recorded["alone_a"], recorded["alone_b"]], young, frequency, -height[-1] / shares, law, level
        ),
        *_asked(
            "52 g",
            [recorded["weight52_a"], recorded["weight52_b"]],
            young,
            foretold.ringing.frequency,
            loaded_sags,
            law,
            level,
        ),
    ]


def _asked(
    case: str, both: list[Recording], young: float, frequency: float, sags: Array, law: Law, level: float
) -> list[Asked]:
    """Of two recordings, where the elastic beam rings at a frequency, and sags so much at the moduli that are tried."""
    seen = float(np.mean([one.ringing.frequency for one in both]))
    vibrating = young * (seen / frequency) ** 2
    asked = [Asked(case, f"rings at {seen:.2f} Hz", 1 / (2 * np.pi * seen), vibrating, vibrating, law.vibrating(seen))]
    numbers = {time: -float(np.mean([one.ringing.middle_at(time) for one in both])) for time in INSTANTS}
    end = float(np.mean([one.times[-1] for one in both])) - AT_REST / 2
    numbers[end] = -float(np.mean([one.at_rest[:, 2] for one in both]))
    curve = np.polyfit(np.log(sags), np.log(young * np.array(TRIED)), 2)
    for time, sag in numbers.items():
        needed = (float(np.exp(np.polyval(curve, np.log(sag + below)))) for below in (0.0, level))
        asked.append(Asked(case, f"sags by {1e3 * sag:.2f} mm after {time:.1f} s", time, *needed, law.after(time)))
    return asked


def moduli_table(moduli: list[Asked], level: float) -> str:
    """All of them, in kPa."""
    below = f"E if held {1e3 * level:.2f} mm below"
    rows = [
        (
            one.case,
            one.number,
            f"{one.time:.2g}",
            *(f"{v / 1e3:.0f}" for v in (one.held_level, one.held_below, one.law)),
        )
        for one in moduli
    ]
    return markdown(("", "measured", "time (s)", "E if held level (kPa)", below, "the law's"), rows)
