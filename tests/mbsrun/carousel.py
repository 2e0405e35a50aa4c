"""A driven table with an arm that is free to turn on it: a joint that is driven, and no loop."""

CAROUSEL = """\
name: carousel
gravity: [0, 0, -9.81]
bodies:
  - {name: table, joint: {name: q1, type: revolute, axis: z, actuated: false}, mass: 2, inertia: [0.2, 0, 0.2]}
  - {name: arm, parent: table, joint: {name: q2, type: revolute, axis: y, position: [0.3, 0, 0]}, mass: 1,
     com: [0.2, 0, 0]}
driven: [q1]
"""
