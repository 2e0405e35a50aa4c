"""A leg on a trunk that slides freely, and a squat while its foot stands."""

LEG = """
name: leg
gravity: [0, 0, -9.81]
bodies:
  - {name: rail, joint: {name: x, type: prismatic, axis: x, actuated: false}, mass: 0}
  - {name: trunk, parent: rail, joint: {name: z, type: prismatic, axis: z, actuated: false}, mass: 5}
  - name: thigh
    parent: trunk
    joint: {name: hip, type: revolute, axis: y}
    mass: 1
    com: [0, 0, -0.2]
    inertia: [0.02, 0.02, 0.001]
  - name: shank
    parent: thigh
    joint: {name: knee, type: revolute, axis: y, position: [0, 0, -0.4]}
    mass: 0.5
    com: [0, 0, -0.2]
    inertia: [0.01, 0.01, 0.001]
frames:
  - {name: sole, body: shank, position: [0, 0, -0.4]}
wrenches:
  - {name: sole, body: shank, position: [0, 0, -0.4], force: input}
"""
SQUAT = """
model: leg.yaml
horizon: 0.6
intervals: 6
scheme: radau
degree: 3
start: {pose: {hip: 0.5, knee: -1.0}}
end: {pose: {hip: 0.8, knee: -1.6}, velocity: zero}
contacts: [{sensor: sole, axes: xz}]
cost: {inputs: 1}
"""
