"""A model behind bioptim's model protocol: functions of CasADi by the generated kernels.

    forward_dynamics    qddot = nu(q, qdot, tau)        kernel exp2, with exact first and second derivatives
    inverse_dynamics    tau = Phi(q, qdot, qddot, 0)    kernel impl, the same
    marker, markers     positions of sensors            kernel sensors, the same
    marker_velocity     velocities of sensors           kernel motion, the same
    mass_matrix, non_linear_effects, center_of_mass, lagrangian: equations of the model, which CasADi differentiates

Signatures follow `bioptim.models.protocols.biomodel` (bioptim 3.4): each method returns a function of q, qdot, ... and
`parameters`, which are none. bioptim gives every joint a torque, so every joint must be actuated; a mapping of tau
leaves joints passive.

    class Arm(BioptimModel, TorqueDynamics): ...        # of bioptim
    model = Arm("planar_arm.yaml")
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import casadi as ca
import numpy as np

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.optimal.quantities import Quantities
from mbsrun.peers.peer import PeerError, check_states
from mbsrun.quantities import list_quantities


@dataclass(frozen=True)
class Limits:
    """The range of a coordinate or velocity, as bioptim reads it."""

    lower: float
    upper: float

    def min(self) -> float:
        """Return the lower limit."""
        return self.lower

    def max(self) -> float:
        """Return the upper limit."""
        return self.upper


class BioptimModel:
    """A model of this project for bioptim; it refuses functions of contacts, muscles and ligaments by PeerError."""

    contact_names: tuple[str, ...] = ()
    soft_contact_names: tuple[str, ...] = ()
    muscle_names: tuple[str, ...] = ()
    contact_types: tuple[Any, ...] = ()
    nb_quaternions = nb_root = nb_soft_contacts = nb_rigid_contacts = nb_contacts = nb_muscles = 0
    friction_coefficients = None
    external_force_set = None

    def __init__(self, model: str | Path, *args: Any, **settings: Any) -> None:
        """Load a model file or a generated folder. Raises PeerError for a model that bioptim cannot take."""
        super().__init__(*args, **settings)
        self.path = str(model)
        self._plant: Plant = load_on_demand(Path(model))
        manifest = self._plant.manifest
        check_states(manifest, "bioptim")
        if passive := [c.name for c in manifest.coordinates if not c.actuated]:
            finding = f"{manifest.model} has passive joints, {', '.join(passive)}, and bioptim gives each a torque"
            raise PeerError(f"{finding}; actuate them, and map their tau to None")
        n = len(manifest.coordinates)
        self.q, self.qdot, self.qddot, self.tau = (ca.MX.sym(name, n) for name in ("q", "qdot", "qddot", "tau"))
        self.parameters, self.external_forces = ca.MX.sym("parameters", 0, 1), ca.MX.sym("external_forces", 0, 1)

    def copy(self) -> BioptimModel:
        """Load the same model again."""
        return type(self)(self.path)

    def serialize(self) -> tuple[Callable[..., Any], dict[str, Any]]:
        """Return the class, and the arguments that make the same model."""
        return type(self), {"model": self.path}

    # --- names and sizes ---

    @property
    def name(self) -> str:
        """Return the model's name."""
        return self._plant.manifest.model

    @property
    def name_dof(self) -> tuple[str, ...]:
        """Return the names of the coordinates."""
        return self._plant.manifest.positions

    @property
    def nb_q(self) -> int:
        """Count the coordinates; velocities, accelerations and torques are as many."""
        return len(self.name_dof)

    nb_qdot = nb_qddot = nb_dof = nb_tau = nb_q

    @property
    def segments(self) -> tuple[str, ...]:
        """Return the names of the joint frames, one for each moving body."""
        return tuple(frame.name for frame in self._plant.manifest.frames if not frame.sensor)

    @property
    def nb_segments(self) -> int:
        """Count the joint frames."""
        return len(self.segments)

    def segment_index(self, name: str) -> int:
        """Return the index of a joint frame. Raises ValueError."""
        return self.segments.index(name)

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Return the names of the sensors."""
        return tuple(frame.name for frame in self._plant.manifest.frames if frame.sensor)

    @property
    def nb_markers(self) -> int:
        """Count the sensors."""
        return len(self.marker_names)

    def marker_index(self, name: str) -> int:
        """Return the index of a sensor. Raises ValueError."""
        return self.marker_names.index(name)

    # --- dynamics ---

    def forward_dynamics(self, with_contact: bool = False) -> ca.Function:
        """Return qddot of q, qdot, tau."""
        if with_contact:
            self._refuse("contacts")
        value = self._plant.casadi("exp2")(self.q, self.qdot, self.tau)
        return self._make("forward_dynamics", {"qdot": self.qdot, "tau": self.tau} | self._forces, value, "qddot")

    def inverse_dynamics(self, with_contact: bool = False) -> ca.Function:
        """Return tau of q, qdot, qddot."""
        if with_contact:
            self._refuse("contacts")
        value = self._plant.casadi("impl")(self.q, self.qdot, self.qddot, np.zeros(self.nb_q))
        return self._make("inverse_dynamics", {"qdot": self.qdot, "qddot": self.qddot} | self._forces, value, "tau")

    def mass_matrix(self) -> ca.Function:
        """Return M of q."""
        return self._make("mass_matrix", {}, self._trace("semi", "M", self.q), "Mass matrix")

    def non_linear_effects(self) -> ca.Function:
        """Return c of q, qdot, with gravity and the forces of joints."""
        return self._make(
            "non_linear_effects", {"qdot": self.qdot}, self._trace("semi", "c", self.q, self.qdot), "Non linear effects"
        )

    def reshape_qdot(self, k_stab: float = 1.0) -> ca.Function:  # noqa: ARG002  # of quaternions
        """Return the rates of q: qdot."""
        return self._make("reshape_qdot", {"qdot": self.qdot}, self.qdot, "Reshaped qdot")

    def lagrangian(self) -> ca.Function:
        """Return the kinetic energy minus the potential energy, of q and qdot."""
        value = self._trace("energy", "kinetic", self.q, self.qdot) - self._trace("energy", "potential", self.q)
        return ca.Function("lagrangian", [self.q, self.qdot], [value], ["q", "qdot"], ["lagrangian"])

    def torque(self) -> ca.Function:
        """Return the torques of activations, which they are."""
        given = [self.tau, self.q, self.qdot, self.parameters]
        return ca.Function("torque", given, [self.tau], ["tau", "q", "qdot", "parameters"], ["Torque"])

    # --- geometry ---

    def center_of_mass(self) -> ca.Function:
        """Return the centre of mass of q."""
        return self._make("center_of_mass", {}, self._trace("energy", "com", self.q), "Center of mass")

    def center_of_mass_velocity(self) -> ca.Function:
        """Return the velocity of the centre of mass of q, qdot."""
        value = ca.jtimes(self._trace("energy", "com", self.q), self.q, self.qdot)
        return self._make("center_of_mass_velocity", {"qdot": self.qdot}, value, "Center of mass velocity")

    def markers(self) -> ca.Function:
        """Return the positions of all sensors, (3, sensors), of q."""
        return self._make("markers", {}, self._read("sensors", "position", self.q), "markers")

    def marker(self, index: int, reference_segment_index: int | None = None) -> ca.Function:
        """Return the position of a sensor in the base frame, of q."""
        if reference_segment_index is not None:
            self._refuse("markers in the frame of a segment")
        return self._make("marker", {}, self._read("sensors", "position", self.q)[:, index], "marker")

    def markers_velocities(self, reference_index: int | None = None) -> ca.Function:
        """Return the velocities of all sensors, (3, sensors), of q, qdot."""
        if reference_index is not None:
            self._refuse("velocities in the frame of a segment")
        value = self._read("motion", "v", self.q, self.qdot)
        return self._make("markers_velocities", {"qdot": self.qdot}, value, "markers_velocities")

    def marker_velocity(self, marker_index: int) -> ca.Function:
        """Return the velocity of a sensor in the base frame, of q, qdot."""
        value = self._read("motion", "v", self.q, self.qdot)[:, marker_index]
        return self._make("marker_velocity", {"qdot": self.qdot}, value, "marker_velocity")

    def normalize_state_quaternions(self) -> ca.Function:
        """Return q: there are no quaternions."""
        return ca.Function("normalize_state_quaternions", [self.q], [self.q], ["q"], ["q_normalized"])

    # --- limits ---

    def tau_max(self) -> ca.Function:
        """Return the largest and the least torques of q, qdot; infinite where the model has none."""
        most = np.array([np.inf if c.max_force is None else c.max_force for c in self._plant.manifest.coordinates])
        given, names = [self.q, self.qdot, self.parameters], ["q", "qdot", "parameters"]
        return ca.Function("tau_max", given, [ca.MX(most), ca.MX(-most)], names, ["tau_max", "tau_min"])

    def ranges_from_model(self, variable: str) -> list[Limits]:
        """Return the limits of q, qdot or qddot. Raises ValueError for another variable."""
        coordinates = self._plant.manifest.coordinates
        if variable in ("q", "q_joints"):
            return [
                Limits(-np.inf if c.lower is None else c.lower, np.inf if c.upper is None else c.upper)
                for c in coordinates
            ]
        if variable in ("qdot", "qdot_joints"):
            speeds = [np.inf if c.max_speed is None else c.max_speed for c in coordinates]
            return [Limits(-speed, speed) for speed in speeds]
        if variable in ("qddot", "qddot_joints"):
            return [Limits(-np.inf, np.inf) for _ in coordinates]
        raise ValueError(f"found {variable}; give q, qdot or qddot")

    def bounds_from_ranges(self, variables: str | Sequence[str], mapping: Any = None) -> Any:
        """Return bioptim's bounds of the model's limits."""
        return importlib.import_module("bioptim.models.utils").bounds_from_ranges(self, variables, mapping)

    # --- functions ---

    @property
    def _forces(self) -> dict[str, ca.MX]:
        return {"external_forces": self.external_forces}

    def _make(self, name: str, given: Mapping[str, ca.MX], value: ca.MX, result: str) -> ca.Function:
        """Make a function of q, some more arguments, and no parameters."""
        every = {"q": self.q, **given, "parameters": self.parameters}
        return ca.Function(name, [*every.values()], [value], [*every], [result])

    def _read(self, kernel: str, result: str, *given: ca.MX) -> ca.MX:
        """Return a result of a kernel, (3, sensors)."""
        function = self._plant.casadi(kernel)
        return function(*given)[function.name_out().index(result)] if function.n_out() > 1 else function(*given)

    def _trace(self, function: str, result: str, *given: ca.MX) -> ca.MX:
        """Return a result of the model's equations, of q or of q and qdot."""
        s, value = self._quantities, self._quantities.function(function)[result]
        return ca.Function("traced", [s.q, s.qd][: len(given)], [ca.densify(value)])(*given)

    @cached_property
    def _quantities(self) -> Quantities:
        manifest = self._plant.manifest
        return Quantities(manifest, list_quantities(manifest), (), Path(self.path), {}, ca.SX)

    def _refuse(self, what: str) -> NoReturn:
        raise PeerError(f"bioptim asks for {what}, which these models do not have; leave it out of the program")

    def __getattr__(self, name: str) -> Any:
        """Refuse the methods of the protocol that a model of rigid bodies without contacts has no function for."""
        if name.startswith(
            ("muscle", "ligament", "passive", "rigid_contact", "soft_contact", "contact_forces", "qdot_")
        ):
            self._refuse(name)
        raise AttributeError(f"{type(self).__name__} has no attribute {name}")
