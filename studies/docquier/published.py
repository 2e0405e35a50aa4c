"""Numbers that Docquier, Brüls and Fisette print in their tables 1, 3 and 4."""

from __future__ import annotations

COMPLEXITY = {"IMPL": "N", "SEMI": "N²", "EXP1": "N² + N³", "EXP2": "N"}  # Table 1
SIZES = {  # Table 3: variables, constraints, nonzeros of Jacobian and Hessian
    "IMPL": (8812, 8427, 72435, 39021),
    "SEMI": (8812, 8427, 72435, 39021),
    "EXP1-O": (6412, 6027, 62519, 35286),
    "EXP1-A": (8812, 8427, 69635, 35021),
    "EXP2-O": (6412, 6027, 62519, 35286),
    "EXP2-A": (8812, 8427, 69635, 35021),
}
EFFORTS = {"IMPL": (460, 114), "SEMI": (830, 264), "EXP1": (991, 328), "EXP2": (1784, 395)}  # Table 4
