"""Small motions about a pose at rest: equilibria, linear equations, modes, transfer functions, pictures."""

from mbsrun.linearisation.equations import (
    BalanceError,
    Equilibrium,
    Excitation,
    Linearisation,
    Mode,
    balance,
    find_pose,
    linearise,
    settle,
)
from mbsrun.linearisation.rolling import Rolling, roll

__all__ = [
    "BalanceError",
    "Equilibrium",
    "Excitation",
    "Linearisation",
    "Mode",
    "Rolling",
    "balance",
    "find_pose",
    "linearise",
    "roll",
    "settle",
]
