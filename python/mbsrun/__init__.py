"""mbsrun: compile, load and call generated kernels; solve optimal control problems with them."""

from mbsrun.external import Mechanism, load

__all__ = ["Mechanism", "load"]
