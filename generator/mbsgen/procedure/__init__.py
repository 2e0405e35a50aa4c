"""Procedures: functions as sequences of stages; how a stage is interpreted, counted and differentiated."""
