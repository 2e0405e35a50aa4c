"""Recursions with the fewest operations: shared frames, regrouped inertia, factored directions.

`segments` aligns the bodies' frames, `regrouping` moves mass that a joint cannot feel, `motion` and the recursions
beside it write vectors in the frames that a `plan` chooses. The textbook recursions are one folder up.
"""
