"""Slips of tyres as states: contacts with relaxation lengths -> joints whose speeds these are.

A wheel's contact that relaxes gets a massless body on the base for each direction, which slides with an armature of 1
kg. The joint's speed is the deflection of the tyre in m, its force the rate of that; see `mbsgen.model.tyres`. So every
use of a model has these states, as it has the speeds of other joints. The joint's coordinate is their integral, which
nothing reads.
"""

from __future__ import annotations

from collections.abc import Sequence

from mbsgen.model.model import ONE, UNITS, Body, Contact, Joint
from mbsgen.model.tree import Motion
from mbsgen.model.tyres import LONGITUDINAL


def list_slips(contacts: Sequence[Contact]) -> tuple[Body, ...]:
    """Make the bodies whose speeds are slips, for all contacts that relax."""
    return tuple(
        Body(
            name_slip(contact.name, way),
            Joint(Motion.PRISMATIC, UNITS["x" if way == LONGITUDINAL else "y"], actuated=False, armature=ONE),
            slips_at=contact.name,
        )
        for contact in contacts
        if contact.tyre is not None
        for way in contact.tyre.relaxed
    )


def name_slip(contact: str, way: str) -> str:
    """Name the joint of a slip, and its body."""
    return f"{contact}.{way}"


def keep_slips(bodies: Sequence[Body], contacts: Sequence[Contact]) -> tuple[Body, ...]:
    """Leave out the bodies of slips whose contacts are not there."""
    names = {contact.name for contact in contacts}
    return tuple(body for body in bodies if not body.slips_at or body.slips_at in names)
