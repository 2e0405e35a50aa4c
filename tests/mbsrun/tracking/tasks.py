"""Problems of a puck on a rail, which lies beside them."""

TASK = """
model: puck.yaml
constants: {t0: 0}
horizon: 1
intervals: 20
scheme: radau
degree: 2
start: {pose: {}}
"""
TO_REST = TASK + "cost: {inputs: 1}\nend: {pose: {x: 1}, velocity: zero}\n"
FOLLOW = TASK + "cost: {inputs: 1e-4, running: [{expression: (q_x - sin(t0 + t))**2, weight: 100}]}\n"
