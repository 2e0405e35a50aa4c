"""Segments of young adults: masses, centres of mass, radii of gyration and lengths, by sex.

Source: P. de Leva, "Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters", Journal of Biomechanics 29,
1996, table 4. Lengths are between the segment's ends; the shank ends at the ankle's joint centre.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

STATURES: Mapping[str, float] = MappingProxyType({"female": 1.735, "male": 1.741})  # of the samples [m]


@dataclass(frozen=True)
class Figures:
    """A segment of the table."""

    length: float  # [m], of a subject of the sample's stature
    mass: float  # part of the subject's
    centre: float  # from the proximal end, or the cranial one, over the length
    sagittal: float  # radii of gyration about the axes forward, to the side, and along, over the length
    transverse: float
    longitudinal: float


def _read(text: str) -> Mapping[str, Figures]:
    rows = [line.split() for line in text.strip().splitlines()]
    return MappingProxyType(
        {name: Figures(float(x) / 1000, *(float(y) / 100 for y in rest)) for name, x, *rest in rows}
    )


# names; lengths in mm; masses, centres and radii in per cent
TABLES: Mapping[str, Mapping[str, Figures]] = MappingProxyType(
    {
        "female": _read("""
            head 200.2 6.68 58.94 33.0 35.9 31.8
            trunk 529.3 42.57 41.51 35.7 33.9 17.1
            upper_trunk 142.5 15.45 20.77 74.6 50.2 71.8
            middle_trunk 205.3 14.65 45.12 43.3 35.4 41.5
            lower_trunk 181.5 12.47 49.20 43.3 40.2 44.4
            upper_arm 275.1 2.55 57.54 27.8 26.0 14.8
            forearm 264.3 1.38 45.59 26.1 25.7 9.4
            hand 78.0 0.56 74.74 53.1 45.4 33.5
            thigh 368.5 14.78 36.12 36.9 36.4 16.2
            shank 438.6 4.81 43.52 26.7 26.3 9.2
            foot 228.3 1.29 40.14 29.9 27.9 13.9
        """),
        "male": _read("""
            head 203.3 6.94 59.76 36.2 37.6 31.2
            trunk 531.9 43.46 44.86 37.2 34.7 19.1
            upper_trunk 170.7 15.96 29.99 71.6 45.4 65.9
            middle_trunk 215.5 16.33 45.02 48.2 38.3 46.8
            lower_trunk 145.7 11.17 61.15 61.5 55.1 58.7
            upper_arm 281.7 2.71 57.72 28.5 26.9 15.8
            forearm 268.9 1.62 45.74 27.6 26.5 12.1
            hand 86.2 0.61 79.00 62.8 51.3 40.1
            thigh 422.2 14.16 40.95 32.9 32.9 14.9
            shank 440.3 4.33 43.95 25.1 24.6 10.2
            foot 258.1 1.37 44.15 25.7 24.5 12.4
        """),
    }
)
NAMES = tuple(TABLES["male"])
