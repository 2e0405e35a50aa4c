"""mbsrun: compile, load and call generated kernels; solve optimal control problems with them."""

from mbsrun.controllers.loading import Controller, controller
from mbsrun.external import Mechanism, load

__all__ = ["Controller", "Mechanism", "controller", "load"]
