"""Functional mock-up units (FMI 3.0) of mechanisms: their numbers, their description, their package."""

from mbsrun.fmu.package import write_fmu

__all__ = ["write_fmu"]
