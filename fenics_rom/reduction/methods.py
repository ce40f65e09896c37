"""The reduction methods by name. Any function of a problem is one, too."""

from fenics_rom.reduction.balanced import balanced
from fenics_rom.reduction.modal import modal, modal_static
from fenics_rom.reduction.pod import pod
from fenics_rom.reduction.problem import Method
from fenics_rom.reduction.static import static

BY_NAME: dict[str, Method] = {
    "balanced": balanced,
    "modal": modal,
    "modal+static": modal_static,
    "pod": pod,
    "static": static,
}
