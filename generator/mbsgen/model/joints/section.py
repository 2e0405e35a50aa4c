"""A joint type: its fields in a model file, its elementary joints, and its description for a writer.

An elementary joint has one coordinate and a constant unit twist as its motion subspace: (e, 0) turns about e, (0, e)
slides along e (Featherstone, Rigid Body Dynamics Algorithms, 2008, table 4.1). Other joints consist of these:

- in a row, through massless frames: the motion subspace belongs to the product of the elementary motions;
- coupled: one follows another at a constant ratio, so that both have one twist, as (e, p e) of a screw;
- floating: three or six joints at 0 in the frame that a quaternion turns (see `quaternions`).

Coordinates are the elementary joints': rad for turns, m for slides.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import get_args

from mbsgen.documents import Finding, Place
from mbsgen.expressions import Expression
from mbsgen.model.model import Carrier, Joint, Placement, Triple
from mbsgen.model.sections import PlacementSection


@dataclass(frozen=True)
class Description:
    """The mapping in a model file that makes the joints of a body."""

    type: str
    fields: Mapping[str, str | Expression | Triple]  # of the type alone; a triple is a direction
    placement: Placement
    setting: Joint | None = None  # the elementary joint whose settings stand beside the fields
    axes: Mapping[str, Joint] = field(default_factory=dict)  # sections with settings under labels
    actuated: bool = True  # whether these take inputs where the file does not say


class JointSection(PlacementSection, ABC):
    """The fields of a joint type in a model file; each type adds its own, and `type: Literal[NAME]`."""

    @classmethod
    def list_names(cls) -> tuple[str, ...]:
        """List the names of the type, the words that a file may give for `type`."""
        return get_args(cls.model_fields["type"].annotation)

    @abstractmethod
    def make(self, body: str) -> Carrier:
        """Make the elementary joints that carry a body of this name."""

    @classmethod
    @abstractmethod
    def describe(cls, body: str, carrier: Carrier) -> Description | None:
        """Describe what carries a body of this name, if it is of this type."""

    def locate(self, k: int, key: Place) -> Place:
        """Find in this section the field that gives `key` of the k-th elementary joint."""
        return key

    def find_faults(self) -> Iterator[Finding]:
        """Find faults of the fields that their shape does not show; places are within this section."""
        yield from ()
