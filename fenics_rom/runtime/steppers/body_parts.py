"""What a body is made of beside its frame; none of these parts knows another."""

from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom

if TYPE_CHECKING:
    from fenics_rom.mechanics.actuator_forces import ActuatorForces
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches, PronySeries
    from fenics_rom.runtime.steppers.acts.following import FollowingLoads
    from fenics_rom.runtime.steppers.acts.found_forces import FoundForces
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.elastic.law import ElasticLaw
    from fenics_rom.runtime.steppers.training_watch import TrainingWatch


class BodyParts(NamedTuple):
    """What a body is made of beside its frame; without them it is plain.

    Attributes:
        elastic: what resists the shape; None: small strains of a material that does not relax, or an equilibrium.
        following: loads that turn with what they act on; None: there are none.
        found: forces of actuators that are found in steps; None: there are none.
        extent: tells how far a body that deforms largely goes; None: its strains are small.
    """

    elastic: "ElasticLaw | None" = None
    following: "FollowingLoads | None" = None
    found: "FoundForces | None" = None
    extent: "TrainingWatch | None" = None


PLAIN = BodyParts()


def parts_of(
    rom: Rom,
    contact: str,
    model: ContactModel,
    law: str,
    actuators: "ActuatorForces | None",
    series: "PronySeries | None",
    interface: "ContactInterface | None",
) -> BodyParts:
    """What a body is made of in a contact mode; only the modules of what there is are imported."""
    found, elastic = None, cast("ElasticLaw | None", None)
    if actuators is not None:
        from fenics_rom.runtime.steppers.acts.found_forces import FoundForces

        found = FoundForces(rom.deformation, model, actuators)
    if rom.deformation is None:
        if series is not None:
            from fenics_rom.runtime.steppers.elastic.linear import RelaxingLinear

            branches = maxwell_branches(series, 1, model.order)
            assert branches is not None
            elastic = RelaxingLinear(model, branches)
        return BodyParts(elastic, found=found)
    from fenics_rom.runtime.steppers.acts.following import FollowingLoads
    from fenics_rom.runtime.steppers.training_watch import TrainingWatch

    body, extent = rom.deformation, TrainingWatch(rom, interface)
    if law == "newton":
        from fenics_rom.runtime.steppers.elastic.sampled import SampledPoints

        elastic = SampledPoints(body, maxwell_branches(series, 2, 6 * len(body.weights)))
    elif law == "linearly-implicit":
        from fenics_rom.runtime.steppers.elastic.carried_strains import StrainsCarried

        stiffest = float(np.sqrt(model.eigenvalues[-1]))
        elastic = StrainsCarried(body, stiffest, maxwell_branches(series, 2, StrainsCarried.strain_count(body)))
    width = model.inputs.shape[1]
    extent.enter(contact, width)
    following = FollowingLoads.of(rom, width, () if actuators is None else FoundForces.loads(rom, actuators))
    return BodyParts(elastic, following, found, extent)


def maxwell_branches(
    series: "PronySeries | None", rows: int, size: int, share: Array | None = None
) -> "MaxwellBranches | None":
    """The branches of a body whose material relaxes; only then they are imported."""
    if series is None:
        return None
    from fenics_rom.mechanics.viscoelasticity import MaxwellBranches

    return MaxwellBranches(series, rows, size, share=share)
