"""The reduction methods by name. Any function of a problem is one, too."""

from fenics_rom.reduction.methods.balanced import balanced
from fenics_rom.reduction.methods.modal import modal, modal_static
from fenics_rom.reduction.methods.pod import pod
from fenics_rom.reduction.methods.static import static
from fenics_rom.reduction.problem import Method

SELECTION = "eigenvector-selection"  # of what the balanced directions name, see EigenvectorSelection

BY_NAME: dict[str, Method] = {
    "balanced": balanced,
    SELECTION: balanced,
    "modal": modal,
    "modal+static": modal_static,
    "pod": pod,
    "static": static,
}
